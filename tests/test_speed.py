"""`python -m benchmarks speed`: its runs in two checkouts, its comparison, its records, and the inputs it rejects.

The other checkout is this one, except that its tables are parsed from the printed text, as those of older trees are,
and that its workpiece's sweep has a margin of 4 mm.
"""

import argparse
import shutil
import sys
from pathlib import Path

import pytest

from benchmarks import figures, speed, speed_cases
from benchmarks.clearance import row
from benchmarks.figures import Entry, Figure
from benchmarks.speed_table import Measured, counts_differ, head, rows

ROOT = Path(__file__).parents[1]


@pytest.fixture
def ran(monkeypatch, capsys):
    """Run the command; return its exit code and the lines that it printed, errors last."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["speed", *map(str, words)])
        code = speed.main()
        printed = capsys.readouterr()
        return code, (printed.out + printed.err).splitlines()

    return run


@pytest.fixture
def other(tmp_path):
    """The other checkout."""
    root = tmp_path / "other"
    for folder in ("benchmarks", "sweeps", "configs"):
        shutil.copytree(ROOT / folder, root / folder)
    (root / "htcp_jax").symlink_to(ROOT / "htcp_jax")
    shutil.copy(ROOT / "pyproject.toml", root)
    tables, sweep = root / "benchmarks/tables.py", root / "sweeps/workpiece.yaml"
    tables.write_text(tables.read_text().replace("--json", "--written"))
    tables.write_text(tables.read_text().replace("chosen.json", "None"))
    sweep.write_text(sweep.read_text() + "  - margin_m: [0.004]\n")
    return root


def test_a_count_that_differs_is_named_and_ends_in_1_and_the_figures_are_kept(ran, other, tmp_path):
    kept = tmp_path / "figures.yaml"
    few = "--only", "tables-engines", "--quick", "--methods", "baseline"
    code, lines = ran(*few, "--against", other, "--pairs", "1", "--record", "--figures", kept)
    assert code == 1 and [line for line in lines if "failed" in line] == []
    differ = [line for line in lines if line.endswith(" there") and " here, " in line]
    assert len(differ) == 1 and differ[0].startswith("tables-engines, workpiece baseline: ")  # and not the robot's
    table = {line[:36].strip(): line.split() for line in lines if line.startswith("  ")}
    assert {"robot baseline", "workpiece baseline", "in all"} <= table.keys()
    for name in ("robot baseline", "workpiece baseline"):
        *_, here_s, unit, there_s, _, ratio, low, to, high, count = table[name]
        assert (unit, to) == ("s", "to") and low == ratio == high and int(count) > 0
        assert float(ratio) == pytest.approx(float(here_s) / float(there_s), abs=0.05, rel=0.05)
    (entry,) = figures.committed(kept)
    assert {one.name: str(one.count) for one in entry.figures if one.count} == {
        name: table[name][-1] for name in ("robot baseline", "workpiece baseline")
    }


MACHINE = "2 of 2 cores, a processor"


def entry(count=5, machine=MACHINE, job="generated duct"):
    return Entry("tables", job, machine, "abc", "Python", (Figure("a", 2.0, "s", count), Figure("b", 3.0, "us")))


def test_figures_are_kept_by_case_job_and_machine(tmp_path):
    file = tmp_path / "figures.yaml"
    for new in ([entry(1), entry(2, "another")], [entry(3)], [entry(4, job="own")]):
        figures.record(file, new)
    kept = figures.committed(file)
    assert {one.figures[0].count for one in kept} == {2, 3, 4} and list(tmp_path.iterdir()) == [file]
    assert figures.nearest(kept, "tables", "generated duct", MACHINE) == entry(3)
    assert figures.nearest(kept, "tables", "generated duct", "a third") in kept
    assert figures.nearest(kept, "cross", "generated duct", MACHINE) is None


def test_ratios_are_of_medians_and_of_pairs_and_a_star_marks_another_machine():
    runs = Measured([[Figure("a", s, "s", 5)] for s in (1, 2, 6)], [[Figure("a", s, "s", 5)] for s in (4, 4, 3)])
    (line,) = rows(runs, entry(machine="another"), MACHINE, pairs=True)
    assert line.split() == "a 2.00 s 4.00 s 0.50 0.25 to 2.00 2.00 s 1.00* 5".split()
    (line,) = rows(Measured(runs.here, []), entry(), MACHINE, pairs=False)
    assert line.split() == "a 2.00 s 2.00 s 1.00 5".split()
    assert len(head(pairs=True)) == len(next(iter(rows(runs, entry(), MACHINE, pairs=True))))


def test_a_count_that_changes_from_run_to_run_is_named():
    same, another = [Figure("a", 1.0, "s", 5)], [Figure("a", 1.0, "s", 6)]
    assert counts_differ("x", Measured([same, same], [same])) == []
    assert counts_differ("x", Measured([same, another], [])) == ["x, a: 5 or 6 here"]


def test_printed_clearance_rows_are_read():
    found = speed_cases.of_text("clearance", "AMD\n points\n" + row(50_000, 14.71, 6.5, 45.8, 860.2))
    assert found == [
        Figure("50,000 points, gradient", 14.7, "us"),
        Figure("50,000 points, alone", 6.5, "us"),
        Figure("50,000 points, path of 20", 45.8, "us"),
    ]


def test_a_job_is_reported_by_what_its_files_hold_and_not_by_where_they_are(tmp_path):
    def job(folder, text, angle):
        file = tmp_path / folder / "job.yaml"
        file.parent.mkdir(exist_ok=True)
        (file.parent / "cloud.xyz").write_text(text)
        file.write_text(f"workpiece: {{cloud: cloud.xyz, rotation_y_rad: {angle}}}\n")
        part = speed.part_of(file)
        assert part["cloud"] == str(file.parent / "cloud.xyz")
        requested = argparse.Namespace(quick=True, warm=False, methods=None, changes=["margin_m=0"])
        return speed.job_of(part, requested)

    first = job("a", "0 0 0", 0.4)
    assert first == job("b", "0 0 0", 0.4) and first.endswith(", --quick, margin_m=0")
    assert first not in (job("a", "0 0 1", 0.4), job("a", "0 0 0", 0.5))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "tables,rable"], "--only rable: no case; valid: tables, tables-engines, "),
        (["--methods", "baselin"], "--methods baselin: no method; valid: baseline, "),
        (["--pairs", "0"], "--pairs 0: at least 1"),
        (["--against", ROOT / "docs"], f"--against {ROOT / 'docs'}: no checkout of this project, it has no htcp_jax/"),
        (["--config", ROOT / "configs/none.yaml"], f"cannot read {ROOT / 'configs/none.yaml'}: "),
        (["--set", "margin=0"], "the default configuration: unknown key margin; did you mean margin_m?"),
        (["--config", ROOT / "configs/paper.yaml"], f"{ROOT / 'configs/paper.yaml'}: no section workpiece"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(ran, words, message):
    code, lines = ran(*words)
    assert code == 2 and len(lines) == 1 and lines[0].startswith(message)


def test_what_fails_in_a_checkout_is_reported_by_its_last_line(tmp_path):
    with pytest.raises(speed_cases.Broken, match=r"^no more$"):
        speed_cases.Checkout("here", tmp_path, {}).python("-c", "raise SystemExit('first\\nno more')")


@pytest.mark.slow
def test_programs_peers_and_clearance_run_too(ran, tmp_path):
    code, lines = ran("--quick", "--only", "programs,peers,clearance", "--figures", tmp_path / "none.yaml")
    assert code == 0, lines[-1]
    names = [line[:36].strip() for line in lines if line.startswith("  ")]
    assert {"robot, program", "htcp_jax baseline, CPU a step"} <= set(names)
    assert sum(name.startswith("500,000 points") for name in names) == 3
