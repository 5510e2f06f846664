"""Regression gate: an unchanged run passes; a worse, missing or unreadable one fails; planning time never counts."""

import json
import shutil

import pytest
import yaml
from small_run import LONGER, TOY_TARGETS, edit_manifest, end_early, rewrite, spoil, toy_run

from htcp_jax.cli import main
from htcp_jax.planning import registry
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.provenance import provenance
from htcp_jax.runs.reachability_file import REACHABILITY
from htcp_jax.status import Status
from htcp_jax.validation import Baseline, read_baseline

PASSED, REGRESSION, BAD_INPUT = 0, 1, 2
TARGETS = TOY_TARGETS  # per scenario, in all four scenarios


def write_reachability(run, prefix, resolution_rad=0.1):
    record = {"prefix": prefix, "most": [TARGETS] * 4, "resolution_rad": resolution_rad, "seed": 0}
    (run / REACHABILITY).write_text(json.dumps(record))


@pytest.fixture(scope="module")
def updated(tmp_path_factory):
    """Folder with the toy's run, its reachability, and its baseline."""
    place = tmp_path_factory.mktemp("updated")
    run = shutil.copytree(toy_run() / "run", place / "run")
    write_reachability(run, [TARGETS] * 4)
    assert main(["gate", str(run), "--baseline", str(place / "baseline.yaml"), "--update"]) == PASSED
    return place


@pytest.fixture
def run(updated, tmp_path):
    """Copy of the run that a test may damage."""
    return shutil.copytree(updated / "run", tmp_path / "run")


@pytest.fixture
def baseline(updated, tmp_path):
    """Copy of the baseline that a test may edit."""
    return shutil.copy(updated / "baseline.yaml", tmp_path / "baseline.yaml")


def gate(run, baseline, *options) -> int:
    return main(["gate", str(run), "--baseline", str(baseline), *options])


def outcome(run, baseline, capsys) -> dict:
    """Verdict as JSON; checked against the exit code."""
    code = gate(run, baseline, "--json")
    verdict = json.loads(capsys.readouterr().out)
    assert code == (PASSED if verdict["passed"] else REGRESSION)
    return verdict


def edit(file, change) -> None:
    raw = yaml.safe_load(file.read_text())
    change(raw)
    file.write_text(yaml.safe_dump(raw))


def test_a_run_passes_its_own_baseline_and_the_table_lines_up(run, baseline, capsys):
    assert gate(run, baseline) == PASSED
    output = capsys.readouterr()
    origins, counts, *figures, passed = output.out.split("\n\n")
    title, *origins = origins.splitlines()
    named = [line.split()[:2] for line in origins if not line.startswith(" ")]
    assert named == [["baseline", "commit"], ["run", "commit"]]
    head, units, *rows = counts.splitlines()
    assert (title, passed, output.err) == ("grid", "passed\n", "")
    assert [row.split()[0] for row in rows] == ["baseline", "cspace-sample", "reachability"]
    assert all(row.index("ok") == head.index("verdict") for row in rows) and len(units) <= len(head)
    assert [[row.split()[0] for row in part.splitlines()[2:]] for part in (counts, *figures)] == 3 * [
        ["baseline", "cspace-sample", "reachability"]
    ]


def test_the_baseline_says_what_was_planned_and_one_line_a_scenario(baseline):
    lines = baseline.read_text().splitlines()
    assert lines.count(f"      3: {TARGETS} complete") == 2 and len(lines) < 160
    known = read_baseline(baseline)
    here = provenance()
    assert (known.sweep, known.seed, known.dtype, known.device) == ("grid", 0, "float64", here["device"])
    assert known.versions == here["versions"] and known.planned["margin_m"] == 0.0005 and known.commit is not None
    assert known.methods["baseline"].tracked == 4 * TARGETS
    assert 0 < known.methods["baseline"].clearance_min_mm and known.methods["baseline"].tcp_error_max_mm <= 1
    assert not any("run_s" in line or "compile_s" in line for line in lines)


def test_time_never_gates(run, baseline):
    def slower(manifest):
        for shard in manifest["shards"]:
            shard["run_s"] = 1e6 * shard["run_s"] + 1e6
        manifest["seconds"] = {method: {"run_s": 1e9, "compile_s": 1e9} for method in manifest["methods"]}

    edit_manifest(run, slower)
    assert gate(run, baseline) == PASSED


def test_a_scenario_that_ends_earlier_fails_and_is_named_with_target_and_reason(run, baseline, capsys):
    end_early(run, 2, 4, Status.QP_INFEASIBLE)
    assert gate(run, baseline) == REGRESSION
    reported = capsys.readouterr().out
    label = f"rotation y 0 rad, tool extension {LONGER} m"
    counts = f"{TARGETS} tracked in the baseline, 4 now"
    line = f"baseline, scenario 2 ({label}): the first difference is at target 4; {counts}; the run ended there"
    assert f"{line}: {Status.QP_INFEASIBLE.message}" in reported.splitlines() and reported.endswith("FAILED\n")
    assert "failed  baseline: 4 targets fewer tracked, 28 of 32; allowed decrease: 0" in reported
    assert "failed  baseline: 1 scenario ended earlier; allowed: 0" in reported
    assert "failed  baseline: 87.50 % of the reachable targets are tracked, 100.00 % in the baseline" in reported


def test_as_much_as_the_baseline_allows_may_be_lost(run, baseline, capsys):
    end_early(run, 2, 6, Status.ITERATION_LIMIT)
    edit(baseline, lambda raw: raw["allow"]["here"].update(targets=2, scenarios=1))
    assert outcome(run, baseline, capsys)["changed"][0]["target"] == 6
    edit(baseline, lambda raw: raw["allow"]["here"].update(targets=1))
    assert outcome(run, baseline, capsys)["passed"] is False


def test_on_another_device_or_with_other_versions_another_allowance_holds(run, baseline, capsys):
    end_early(run, 2, 6, Status.ITERATION_LIMIT)
    edit(baseline, lambda raw: raw["allow"]["elsewhere"].update(targets=2, scenarios=1))
    assert outcome(run, baseline, capsys)["passed"] is False
    edit_manifest(run, lambda manifest: manifest["planned_by"][0].update(device="cpu: another"))
    verdict = outcome(run, baseline, capsys)
    assert verdict["passed"] and verdict["elsewhere"]
    edit_manifest(run, lambda manifest: manifest["planned_by"][0].update(device=provenance()["device"]))
    edit_manifest(run, lambda manifest: manifest["planned_by"][0]["versions"].update(jaxlib="9"))
    assert outcome(run, baseline, capsys)["elsewhere"]


def test_gains_elsewhere_do_not_hide_a_scenario_that_ends_earlier(run, tmp_path, capsys):
    worse = shutil.copytree(run, tmp_path / "worse")
    end_early(worse, 0, 5, Status.ITERATION_LIMIT)
    assert gate(worse, tmp_path / "was.yaml", "--update") == PASSED
    end_early(run, 1, 6, Status.RECOVERY_EXHAUSTED)
    capsys.readouterr()
    verdict = outcome(run, tmp_path / "was.yaml", capsys)
    (row, *_) = verdict["rows"]
    assert (row["was_tracked"], row["tracked"], row["worse"], row["better"]) == (29, 30, 1, 1)
    assert not verdict["passed"] and [one["scenario"] for one in verdict["changed"]] == [1, 0]


def test_an_improvement_passes_and_is_listed(run, tmp_path, capsys):
    worse = shutil.copytree(run, tmp_path / "worse")
    end_early(worse, 0, 5, Status.ITERATION_LIMIT)
    assert gate(worse, tmp_path / "was.yaml", "--update") == PASSED
    capsys.readouterr()
    assert gate(run, tmp_path / "was.yaml") == PASSED
    reported = capsys.readouterr().out
    assert (
        "better  baseline tracks 3 targets more" in reported
        and "scenario 0 (rotation y 0 rad, tool extension 0 m): the first" in reported
    )
    assert Status.ITERATION_LIMIT.message in reported


def test_more_targets_fail_where_the_baseline_bounds_them(run, tmp_path, capsys):
    worse, was = shutil.copytree(run, tmp_path / "worse"), tmp_path / "was.yaml"
    end_early(worse, 0, 5, Status.ITERATION_LIMIT)
    assert gate(worse, was, "--update") == PASSED
    for most, verdict in ((3, PASSED), (2, REGRESSION)):
        edit(was, lambda raw, most=most: raw["allow"]["here"].update(more_targets=most))
        assert gate(run, was) == verdict
    assert "failed  baseline: 3 targets more tracked, 32 of 32; allowed increase: 2" in capsys.readouterr().out


def test_another_reason_at_the_same_target_is_reported_and_passes(run, tmp_path, capsys):
    was = shutil.copytree(run, tmp_path / "was")
    end_early(was, 0, 5, Status.ITERATION_LIMIT)
    gate(was, tmp_path / "was.yaml", "--update")
    end_early(run, 0, 5, Status.QP_INFEASIBLE)
    capsys.readouterr()
    verdict = outcome(run, tmp_path / "was.yaml", capsys)
    assert verdict["passed"] and verdict["changed"][0]["reason"] == Status.QP_INFEASIBLE.message


def test_a_missing_method_fails(run, baseline, capsys):
    def without(manifest):
        manifest["methods"] = ["baseline"]
        manifest["shards"] = [shard for shard in manifest["shards"] if shard["method"] == "baseline"]

    edit_manifest(run, without)
    verdict = outcome(run, baseline, capsys)
    assert not verdict["passed"] and "cspace-sample: missing" in verdict["failures"]


def test_a_method_that_the_baseline_lacks_is_reported_and_passes(run, baseline, capsys):
    edit(baseline, lambda raw: raw["methods"].pop("cspace-sample"))
    verdict = outcome(run, baseline, capsys)
    assert verdict["passed"] and verdict["improvements"] == ["cspace-sample is not in the baseline"]


def test_missing_scenarios_fail(run, baseline, capsys):
    edit_manifest(run, lambda manifest: manifest["shards"].pop(1))
    verdict = outcome(run, baseline, capsys)
    assert "baseline: 2 of 4 scenarios missing, the first is 2" in verdict["failures"]


def test_a_sweep_that_died_before_its_first_shard_fails(run, baseline, capsys):
    edit_manifest(run, lambda manifest: manifest.update(shards=[]))
    verdict = outcome(run, baseline, capsys)
    assert not verdict["passed"] and any("no finished shard" in failure for failure in verdict["failures"])


@pytest.mark.parametrize("column", ["clearance_m", "status", "j3_rad"])
def test_a_missing_column_fails(run, baseline, capsys, column):
    for scenario in (0, 2):
        rewrite(run, "baseline", scenario, lambda rows: rows.drop_columns([column]))
    verdict = outcome(run, baseline, capsys)
    assert not verdict["passed"] and "baseline: missing" in verdict["failures"]
    assert any("baseline-000000-000001.parquet" in failure for failure in verdict["failures"])


def test_a_missing_figure_of_a_tracked_target_fails(run, baseline, capsys):
    spoil(run, 0, 5, clearance_m=None)
    assert not outcome(run, baseline, capsys)["passed"]


def test_a_missing_reachability_and_one_of_another_search_fail(run, baseline, capsys):
    file = run / REACHABILITY
    write_reachability(run, [TARGETS] * 4, resolution_rad=0.2)
    line = "searched with a resolution of 0.2 rad and seed 0, the baseline with a resolution of 0.1 rad and seed 0"
    assert any(line in failure for failure in outcome(run, baseline, capsys)["failures"])
    file.unlink()
    assert any("reachability: missing" in failure for failure in outcome(run, baseline, capsys)["failures"])


def test_a_lower_reachability_fails(run, baseline, capsys):
    write_reachability(run, [TARGETS, TARGETS, TARGETS, 4])
    verdict = outcome(run, baseline, capsys)
    assert verdict["failures"] == ["reachability: 4 targets fewer reachable; allowed decrease: 0"]


def test_what_mujoco_refutes_fails_though_every_count_is_as_it_was(run, baseline, capsys):
    spoil(run, 1, 7, j2_rad=-1.5)
    verdict = outcome(run, baseline, capsys)
    assert not verdict["passed"] and verdict["changed"] == []
    line = "baseline: 1 tracked target refuted by MuJoCo, the first in scenario 1 at target 7: the TCP is"
    assert any(failure.startswith(line) for failure in verdict["failures"])


def test_bounds_that_are_worse_than_before_fail(run, baseline, capsys):
    def better(raw):
        raw["methods"]["baseline"].update(clearance_min_mm=50.0, tcp_error_max_mm=0.1)

    edit(baseline, better)
    failures = outcome(run, baseline, capsys)["failures"]
    assert any(failure.startswith("baseline: the minimum clearance is") for failure in failures)
    assert any(failure.startswith("baseline: the largest TCP error is") for failure in failures)
    edit(baseline, lambda raw: raw["allow"]["here"].update(clearance_mm=100.0, tcp_error_mm=10.0))
    assert outcome(run, baseline, capsys)["passed"]


@pytest.mark.parametrize("damage", [b"", b"PAR1"])
def test_a_damaged_file_fails_and_is_named(run, baseline, capsys, damage):
    (run / "targets" / "cspace-sample-000002-000003.parquet").write_bytes(damage)
    verdict = outcome(run, baseline, capsys)
    assert not verdict["passed"] and "cspace-sample: missing" in verdict["failures"]
    assert any("cspace-sample-000002-000003.parquet" in failure for failure in verdict["failures"])
    assert "baseline: missing" not in verdict["failures"]


def test_a_damaged_manifest_fails(run, baseline, capsys):
    whole = (run / MANIFEST).read_text()
    (run / MANIFEST).write_text(whole[: len(whole) // 2])
    assert gate(run, baseline) == REGRESSION
    assert "manifest.json is damaged" in capsys.readouterr().out


def test_a_run_of_another_configuration_is_bad_input(updated, run, baseline, capsys):
    def other(manifest):
        manifest["config"]["margin_m"] = 0.001
        same = identity(*(manifest[key] for key in ("config", "grid", "dtype", "files")))
        manifest["config_hash"] = config_hash(same)

    edit_manifest(run, other)
    assert gate(run, baseline) == BAD_INPUT
    assert "margin_m was 0.0005, now 0.001" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (lambda raw: raw["methods"]["baseline"]["scenarios"].pop(3), "tracked is 32, which does not match the sum"),
        (lambda raw: raw["methods"]["baseline"].update(tracked=0), "tracked is 0, which does not match the sum"),
        (lambda raw: raw["methods"]["baseline"]["scenarios"].update({3: "8 FINE"}), "is not the result of a scenario"),
        (lambda raw: raw["methods"]["baseline"].pop("tcp_error_max_mm"), "tcp_error_max_mm"),
        (lambda raw: raw["planned"].update(margin_m=0.1), "config_hash does not match"),
        (lambda raw: raw.update(methods={}), "methods"),
        (lambda raw: raw.update(time_s=3), "unknown key time_s"),
    ],
)
def test_a_damaged_baseline_is_one_line_and_exit_2(run, baseline, capsys, change, line):
    edit(baseline, change)
    assert gate(run, baseline) == BAD_INPUT
    output = capsys.readouterr()
    assert line in output.err and output.err.count("\n") == 1 and output.out == ""


def test_a_folder_without_a_run_and_a_missing_baseline_are_exit_2(run, baseline, tmp_path, capsys):
    assert gate(tmp_path, baseline) == BAD_INPUT
    assert gate(run, tmp_path / "nowhere.yaml") == BAD_INPUT
    assert gate(tmp_path, tmp_path / "b.yaml", "--update") == BAD_INPUT and not (tmp_path / "b.yaml").exists()
    assert capsys.readouterr().err.count("\n") == 3


def limited(manifest):
    manifest.update(count=2, limit=2, shards=[shard for shard in manifest["shards"] if shard["first"] == 0])


@pytest.mark.parametrize(
    ("change", "line"),
    [
        (limited, "it is limited to 2 of 4 scenarios"),
        (lambda manifest: manifest["shards"].pop(), "it is not complete, cspace-sample lacks 2 scenarios"),
        (lambda manifest: manifest["planned_by"].append({"device": "cpu: other"}), "planned by several commits"),
        (lambda manifest: manifest.update(name="another"), "the existing baseline is for the sweep grid"),
        (
            lambda manifest: manifest.update(methods=["baseline"], shards=manifest["shards"][:2]),
            "the existing baseline also has cspace-sample",
        ),
    ],
)
def test_what_may_not_be_a_baseline_leaves_the_baseline_as_it_was(run, baseline, capsys, change, line):
    before = baseline.read_bytes()
    edit_manifest(run, change)
    assert gate(run, baseline, "--update") == BAD_INPUT
    assert line in capsys.readouterr().err and baseline.read_bytes() == before


def test_a_refuted_run_and_a_damaged_one_are_not_taken_as_the_baseline(run, tmp_path, capsys):
    spoil(run, 1, 7, j2_rad=-1.5)
    assert gate(run, tmp_path / "b.yaml", "--update") == BAD_INPUT
    assert "1 tracked target refuted" in capsys.readouterr().err
    (run / "targets" / "baseline-000000-000001.parquet").write_bytes(b"")
    assert gate(run, tmp_path / "b.yaml", "--update") == BAD_INPUT and not (tmp_path / "b.yaml").exists()


def test_updating_never_overwrites_what_is_no_baseline(run, tmp_path, capsys):
    (tmp_path / "job.yaml").write_text("margin_m: 0.1\n")
    assert gate(run, tmp_path / "job.yaml", "--update") == BAD_INPUT
    assert (tmp_path / "job.yaml").read_text() == "margin_m: 0.1\n"


def test_updating_again_keeps_what_is_allowed(run, baseline):
    edit(baseline, lambda raw: raw["allow"]["elsewhere"].update(targets=21))
    assert gate(run, baseline, "--update") == PASSED
    assert read_baseline(baseline).allow.elsewhere.targets == 21


def test_a_baseline_reads_back_as_it_was_written(baseline):
    known = read_baseline(baseline)
    assert Baseline(**known.model_dump()) == known


def test_shares_are_allowed_as_numbers_and_printed_by_update(run, tmp_path, capsys):
    assert gate(run, tmp_path / "b.yaml", "--update") == PASSED
    line = "each method may lose 1 of 32 targets (0.5 %), and 1 of 4 scenarios (4 %) may end earlier"
    assert line in capsys.readouterr().out
    found = read_baseline(tmp_path / "b.yaml").allow.elsewhere.in_numbers(5145, 50)
    assert (found.targets, found.scenarios, found.more_targets) == (25, 2, None)


def test_methods_gates_a_part_of_the_methods(run, baseline, capsys):
    end_early(run, 2, 4, Status.QP_INFEASIBLE)
    assert gate(run, baseline, "--methods", "cspace-sample") == PASSED
    assert gate(run, baseline, "--methods", "cspace-sample,baseline") == REGRESSION
    assert gate(run, baseline, "--methods", "beam") == BAD_INPUT
    assert "the baseline has no method 'beam'; valid: baseline, cspace-sample" in capsys.readouterr().err


def test_other_flags_and_packages_of_extensions_are_stated(run, baseline, capsys):
    edit_manifest(run, lambda manifest: manifest["planned_by"][0].update(xla_flags="--other"))
    edit_manifest(run, lambda manifest: manifest.update(plugins={"method baseline": "mine 1.1"}))
    verdict = outcome(run, baseline, capsys)
    assert verdict["passed"] and verdict["elsewhere"] and "now '--other'" in verdict["notes"][0]
    assert verdict["notes"][1] == "the method baseline came from an unknown package in the baseline, now from mine 1.1"


@pytest.mark.parametrize("package", ["mine 1.0", None])
def test_other_code_of_a_method_is_stated_unless_the_baseline_has_no_hash(run, tmp_path, capsys, package):
    plugins = {"method baseline": package} if package else {}
    edit_manifest(run, lambda manifest: manifest.update(code={"method baseline": "1"}, plugins=plugins))
    assert gate(run, tmp_path / "b.yaml", "--update") == PASSED
    capsys.readouterr()
    assert outcome(run, tmp_path / "b.yaml", capsys)["notes"] == []
    edit_manifest(run, lambda manifest: manifest.update(code={"method baseline": "2"}))
    (note,) = outcome(run, tmp_path / "b.yaml", capsys)["notes"]
    version = f", {package} in both" * bool(package)
    assert note == f"the code of the method baseline differs from the baseline's{version}"
    edit(tmp_path / "b.yaml", lambda raw: raw.pop("code"))  # as written by an older version
    assert outcome(run, tmp_path / "b.yaml", capsys)["notes"] == []


def test_packages_of_methods_that_are_not_compared_are_not_stated(run, baseline, tmp_path, capsys):
    edit_manifest(run, lambda manifest: manifest.update(plugins={"method baseline": "mine 1.1"}))
    junit = tmp_path / "junit.xml"
    assert gate(run, baseline, "--methods", "cspace-sample", "--junit", str(junit)) == PASSED
    assert "mine 1.1" not in capsys.readouterr().out + junit.read_text()


def test_the_junit_file_names_the_package_of_a_compared_method(run, baseline, tmp_path):
    edit_manifest(run, lambda manifest: manifest.update(plugins={"method baseline": "mine 1.1"}))
    gate(run, baseline, "--junit", str(tmp_path / "junit.xml"))
    assert '<property name="run.method baseline" value="mine 1.1" />' in (tmp_path / "junit.xml").read_text()


@pytest.mark.parametrize("added", ["method cspace-sample", "kind of obstacle ball", "kind of task row spin"])
def test_what_a_missing_package_has_planned_is_not_judged(run, baseline, tmp_path, capsys, monkeypatch, added):
    edit_manifest(run, lambda manifest: manifest.update(plugins={added: "theirs 1.1"}))
    monkeypatch.setattr(registry.METHODS, "_built_in", ("baseline",))  # as if the second method were of a package
    junit = tmp_path / "junit.xml"
    for options in (("--junit", str(junit)), ("--update",)):
        assert gate(run, baseline, *options) == BAD_INPUT
        output = capsys.readouterr()
        line = f"htcp: the {added} came from the package theirs 1.1, which is not installed here: install it\n"
        assert (output.out, output.err) == ("", line) and not junit.exists()
    is_judged = not added.startswith("method")
    assert gate(run, baseline, "--methods", "baseline") == (BAD_INPUT if is_judged else PASSED)


def test_complete_scenarios_that_are_gained_and_lost_have_the_probability_of_mcnemar(run, tmp_path, capsys):
    was = shutil.copytree(run, tmp_path / "was")
    for scenario in (0, 1, 2):
        end_early(was, scenario, 5, Status.ITERATION_LIMIT)
    assert gate(was, tmp_path / "was.yaml", "--update") == PASSED
    end_early(run, 3, 5, Status.ITERATION_LIMIT)
    capsys.readouterr()
    first, second, *_ = outcome(run, tmp_path / "was.yaml", capsys)["rows"]
    assert (first["gained"], first["lost"]) == (3, 1) and first["p"] == pytest.approx(2 * (1 + 4) / 2**4)
    assert (second["gained"], second["lost"], second["p"]) == (0, 0, None)
    gate(run, tmp_path / "was.yaml", "--markdown", str(tmp_path / "page.md"))
    line = "baseline: 3 complete scenarios gained, 1 lost; probability of such a split by chance 0.62"
    assert f"complete  {line}\n" in capsys.readouterr().out and f"- {line}\n" in (tmp_path / "page.md").read_text()
