"""Forged runs: whatever is changed in a good run, its counts cannot pass the gate as those of the planned scenarios."""

import json
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from small_run import METHODS, TOY_TARGETS, edit_manifest, recount, rewrite, spoil, toy_run

from htcp_jax.cli import main
from htcp_jax.runs.identity import config_hash, identity
from htcp_jax.runs.manifest import MANIFEST

PASSED, REGRESSION, BAD_INPUT = 0, 1, 2
FIRST = METHODS[0]
Forgery = Callable[[Path], object]


@pytest.fixture(scope="module")
def baseline(tmp_path_factory):
    """Baseline of the toy's run."""
    file = tmp_path_factory.mktemp("forged") / "baseline.yaml"
    assert main(["gate", str(toy_run() / "run"), "--baseline", str(file), "--update"]) == PASSED
    return file


def rows_of(scenario: int, change: Callable[[list[dict]], list[dict]], table: str = "targets") -> Forgery:
    """Return a forgery that changes the rows of the shard with a scenario."""
    return lambda run: rewrite(
        run, FIRST, scenario, lambda rows: pa.Table.from_pylist(change(rows.to_pylist()), rows.schema), table
    )


def put(table: str, scenario: int, target: int | None = None, **values) -> Forgery:
    """Return a forgery that puts other values into the rows of a scenario, or of one of its targets."""
    own = lambda row: row["scenario"] == scenario and target in (None, row.get("target"))  # noqa: E731
    return rows_of(scenario, lambda rows: [row | values if own(row) else row for row in rows], table)


def both(*forgeries: Forgery) -> Forgery:
    return lambda run: [forgery(run) for forgery in forgeries]


def row_of(run: Path, scenario: int, target: int) -> dict:
    found = []
    rewrite(run, FIRST, scenario, lambda rows: found.extend(rows.to_pylist()) or rows)
    return next(row for row in found if (row["scenario"], row["target"]) == (scenario, target))


def configuration(run: Path, scenario: int, target: int) -> list[float]:
    row = row_of(run, scenario, target)
    return [row[name] for name in json.loads((run / MANIFEST).read_text())["joints"]]


def moved(scenario: int, target: int, by: float, joint: int = 1) -> Forgery:
    """Return a forgery that moves a joint at a target, and makes all counts follow."""

    def forge(run: Path) -> None:
        x = configuration(run, scenario, target)
        spoil(run, scenario, target, **{json.loads((run / MANIFEST).read_text())["joints"][joint]: x[joint] + by})
        recount(run)

    return forge


def via(scenario: int, target: int, by: list[float], shares: list[float], of: int | None = None, **values) -> Forgery:
    """Return a forgery that adds via points to the target's segment, and makes all counts follow.

    They are `by` away from the configuration of the target, or of target `of`.
    """

    def forge(run: Path) -> None:
        x = np.add(configuration(run, scenario, target if of is None else of), by)
        points = np.tile(x, len(shares)).tolist()
        spoil(run, scenario, target, via_points=points, via_shares=shares, **values)
        recount(run)

    return forge


def swapped(rows: list[dict], a: int = 0, b: int = 1) -> list[dict]:
    """Return the rows with two scenarios' results under each other's number."""
    other = {a: b, b: a}
    renamed = [row | {"scenario": other.get(row["scenario"], row["scenario"])} for row in rows]
    return sorted(renamed, key=lambda row: (row["scenario"], row.get("target", 0)))


def copied(rows: list[dict], a: int = 0, b: int = 1) -> list[dict]:
    """Return the rows with the results of scenario a also in place of those of scenario b."""
    kept = [row for row in rows if row["scenario"] != b]
    return kept + [row | {"scenario": b} for row in kept if row["scenario"] == a]


def stated(change: Callable[[dict], object], rehash: bool = False) -> Forgery:
    """Return a forgery that changes the manifest, and its hash if `rehash`."""

    def forge(manifest: dict) -> None:
        change(manifest)
        if rehash:
            same = identity(*(manifest[key] for key in ("config", "grid", "dtype", "files")))
            manifest["config_hash"] = config_hash(same)

    return lambda run: edit_manifest(run, forge)


def configured(section: str | None, **values) -> Forgery:
    return stated(lambda raw: (raw["config"][section] if section else raw["config"]).update(values), rehash=True)


def axis(raw: dict, number: int, values: list[float]) -> None:
    ((_, own),) = raw["grid"][0]["axes"][number].items()
    own["values"] = values


def renamed(raw: dict, name: str) -> None:
    raw["methods"] = [name, *raw["methods"][1:]]
    for shard in raw["shards"]:
        shard["method"] = name if shard["method"] == FIRST else shard["method"]


def rename_files(run: Path, name: str) -> None:
    for file in [*run.glob(f"*/{FIRST}-0*.parquet")]:
        file.rename(file.with_name(file.name.replace(FIRST, name, 1)))


def shard(raw: dict, first: int) -> dict:
    return next(own for own in raw["shards"] if (own["method"], own["first"]) == (FIRST, first))


NOWHERE = dict.fromkeys(("clearance_m", "j1_rad", "j2_rad", "j3_rad", "j4_rad"))
FORGED: dict[str, Forgery] = {
    # parameters of rows
    **{
        f"{name} of a row": put("scenarios", 1, **{name: value})
        for name, value in {
            "rotation_x_rad": 0.01, "rotation_y_rad": 0.0, "rotation_z_rad": float("nan"), "shift_x_m": 0.3,
            "tool_extension_m": 0.01, "margin_m": 0.0, "path": "easier.csv", "group": "easy", "start_j1_rad": 0.1,
        }.items()
    },
    "a start within rounding of nothing": put("scenarios", 2, start_j2_rad=None),
    "parameters of two rows swapped": rows_of(0, swapped, "scenarios"),
    # other scenarios under a number of the grid
    "results of two scenarios swapped": rows_of(0, swapped),
    "results and parameters swapped": both(rows_of(0, swapped), rows_of(0, swapped, "scenarios")),
    "an easier scenario's results": both(rows_of(0, copied), recount),
    "an easier scenario's rows in both tables": both(rows_of(0, copied), rows_of(0, copied, "scenarios")),
    "a longer tool's results": both(
        rows_of(2, partial(copied, a=3, b=2)), rows_of(2, lambda rows: rows[8:] + rows[:8])
    ),
    # numbers of rows
    "the last row of a scenario dropped": rows_of(0, lambda rows: rows[:-1]),
    "the last row dropped, and counted": both(rows_of(0, lambda rows: rows[:-1]), recount),
    "the hardest target dropped": rows_of(0, lambda rows: rows[:4] + rows[5:]),
    "a scenario without rows": rows_of(0, lambda rows: rows[:TOY_TARGETS]),
    "a scenario dropped from both tables": both(
        rows_of(0, lambda rows: rows[:TOY_TARGETS]), rows_of(0, lambda rows: rows[:1], "scenarios")
    ),
    "a scenario dropped, and its shard shortened": both(
        rows_of(0, lambda rows: rows[:TOY_TARGETS]),
        rows_of(0, lambda rows: rows[:1], "scenarios"),
        stated(lambda raw: shard(raw, 0).update(last=0, tracked=TOY_TARGETS)),
    ),
    "a row twice": rows_of(0, lambda rows: [*rows[:3], *rows[2:]]),
    "a row in place of another": rows_of(0, lambda rows: [*rows[:3], rows[2], *rows[4:]]),
    "a scenario twice": rows_of(0, lambda rows: [*rows[:TOY_TARGETS], *rows], "targets"),
    "a scenario's row twice": rows_of(0, lambda rows: [rows[0], rows[0]], "scenarios"),
    "a target more": rows_of(0, lambda rows: [*rows, rows[-1] | {"target": TOY_TARGETS}]),
    "rows in another order": rows_of(0, lambda rows: rows[::-1]),
    # the manifest
    "another seed": stated(lambda raw: raw.update(seed=7)),
    "fewer targets": stated(lambda raw: raw.update(targets=24)),
    "a larger grid": stated(lambda raw: raw.update(full=5)),
    "a smaller grid": stated(lambda raw: raw.update(full=3, count=3, shards=[])),
    "a limit": stated(lambda raw: raw.update(limit=3)),
    "fewer scenarios": stated(
        lambda raw: raw.update(count=2, limit=2, shards=[s for s in raw["shards"] if not s["first"]])
    ),
    "a shard that tracks more": stated(lambda raw: shard(raw, 0).update(tracked=15)),
    "a shard less": stated(lambda raw: raw["shards"].pop(0)),
    "a method twice": stated(lambda raw: raw.update(methods=[*raw["methods"], FIRST])),
    "another name of the method": stated(partial(renamed, name="nspace-sqp")),
    "another method's files": both(stated(partial(renamed, name="beam")), partial(rename_files, name="beam")),
    "another method's rows": put("targets", 0, method="beam"),
    "another method's row in scenarios": put("scenarios", 0, method="beam"),
    "another name of the sweep": stated(lambda raw: raw.update(name="easy")),
    "another configuration under the old hash": stated(lambda raw: raw["config"].update(margin_m=0.0)),
    "a smaller margin": configured(None, margin_m=0.0001),
    "another planned seed": configured("settings", seed=1),
    "a wider tolerance": configured("settings", tolerance_m=0.01),
    "another mounting": configured("robot", base_m=[0.1, 0.0, 0.0]),
    "wider limits": configured("robot", limits="simulation"),
    "an easier pose of the part": configured("workpiece", rotation_z_rad=0.1),
    "another grid": stated(lambda raw: axis(raw, 1, [0.0, 0.05]), rehash=True),
    "another grid under the old hash": stated(lambda raw: axis(raw, 1, [0.0, 0.05])),
    "another precision": stated(lambda raw: raw.update(dtype="float32"), rehash=True),
    "another precision of the planner": stated(lambda raw: raw["planned_by"][0].update(dtype="float32")),
    "the digest of an older part": stated(
        lambda raw: raw["files"].update({next(iter(raw["files"])): 64 * "0"}), rehash=True
    ),
    "the digest of an older tree's results": stated(lambda raw: shard(raw, 0)["targets"].update(sha256=64 * "0")),
    # counts in scenarios/
    **{
        f"{name} of scenarios/": put("scenarios", 1, **{name: value})
        for name, value in {
            "targets": 7, "tracked": 9, "executable": 7, "complete": False, "failed_target": 3,
            "failure": "QP_INFEASIBLE", "reason": "fine", "after_recovery": 1, "blocked_paths": 1,
            "clearance_min_m": 0.5, "residual_max_m": 0.0,
            "joint_motion_rad": 0.0, "segment_clearance_min_m": 0.5, "joint_step_max_rad": 0.0,
        }.items()
    },
    # success without a motion
    "tracked without a configuration": put("targets", 1, 5, **NOWHERE),
    "untracked by one column": put("targets", 1, 5, tracked=False),
    "a lost target that is tracked by one column": put("targets", 1, 5, status="QP_INFEASIBLE"),
    "an unknown status": put("targets", 1, 5, status="DONE"),
    "no motion to a target": lambda run: [
        spoil(run, 0, 4, **{f"j{k}_rad": value for k, value in enumerate(configuration(run, 0, 3), 1)}),
        recount(run),
    ],
    # values at targets
    "a joint slightly moved": moved(0, 4, 0.002),
    "a joint moved into contact": moved(0, 4, 0.1),
    "a joint beyond its limits": moved(0, 4, 6.3),
    **{
        f"{name} of a target": both(put("targets", 1, 4, **{name: value}), recount)
        for name, value in {
            "clearance_m": 0.5, "tcp_x_m": 0.0, "target_z_m": 0.0, "residual_m": 0.1, "joint_step_rad": 0.1,
            "segment_clearance_m": 0.5,
        }.items()
    },
    "a clearance below the margin": both(put("targets", 1, 4, clearance_m=0.0001), recount),
    "an infinite clearance": put("targets", 1, 4, clearance_m=float("inf")),
    # motions between targets
    "a via point in the wall": via(1, 6, [0.0, 0.0, -0.1, 0.0], [0.5], of=7),
    "a via point far from the path": via(1, 6, [0.0, 0.8, 0.0, 0.0], [0.5]),
    "a via point in the wall on the approach": via(1, 2, [0.0, 0.0, -0.1, 0.0], [0.5], of=7),
    "a via point off the path": via(1, 6, [0.02, 0.0, 0.0, 0.0], [0.5]),
    "a via point beyond the limits": via(1, 6, [0.0, 0.0, 0.0, 6.3], [0.5]),
    "via points that go back": via(1, 6, [0.0, 0.0, 0.0, 0.0], [0.7, 0.2]),
    "a via point beyond its segment": via(1, 6, [0.0, 0.0, 0.0, 0.0], [1.5]),
    "a via point in the wall on a segment without a check": via(
        1, 6, [0.0, 0.0, -0.1, 0.0], [0.5], of=7, segment_status=None
    ),
    "a segment without a check": both(put("targets", 1, 6, segment_status=None), recount),
    "a segment known to collide": both(put("targets", 1, 6, segment_status="IN_COLLISION"), recount),
    "a start elsewhere": both(put("scenarios", 1, start_j1_rad=2.0), recount),
    "a start in the wall": both(put("scenarios", 1, start_j2_rad=1.5), recount),
}  # fmt: skip


def test_the_good_run_passes(baseline):
    assert main(["gate", str(toy_run() / "run"), "--baseline", str(baseline)]) == PASSED


@pytest.mark.parametrize("forgery", FORGED)
def test_a_forged_run_does_not_pass(baseline, tmp_path, capsys, forgery):
    run = shutil.copytree(toy_run() / "run", tmp_path / "run")
    FORGED[forgery](run)
    code = main(["gate", str(run), "--baseline", str(baseline)])
    output = capsys.readouterr()
    print(output.out[-600:], output.err)
    assert code in (REGRESSION, BAD_INPUT)
    assert "Traceback" not in output.err


@pytest.mark.parametrize("forgery", ["rotation_y_rad of a row", "results of two scenarios swapped"])
def test_a_forged_run_is_not_taken_as_the_baseline(tmp_path, forgery):
    run = shutil.copytree(toy_run() / "run", tmp_path / "run")
    FORGED[forgery](run)
    assert main(["gate", str(run), "--baseline", str(tmp_path / "b.yaml"), "--update"]) == BAD_INPUT
    assert not (tmp_path / "b.yaml").exists()


def test_easier_scenarios_are_named_as_other_scenarios_though_they_track_more(baseline, tmp_path, capsys):
    run = shutil.copytree(toy_run() / "run", tmp_path / "run")
    FORGED["rotation_y_rad of a row"](run)
    assert main(["gate", str(run), "--baseline", str(baseline)]) == REGRESSION
    reported = capsys.readouterr().out
    assert f"{FIRST}: other scenarios: scenarios/ has rotation_y_rad 0.0 in scenario 1, expected 0.1" in reported
