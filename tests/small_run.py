"""Small runs of four scenarios by two methods, real and of the toy arm, and functions that damage a copy of them."""

import hashlib
import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import toy

from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model import duct
from htcp_jax.motion import Problem
from htcp_jax.planning import batch
from htcp_jax.runs import open_run, tables
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.sweep import keep_plans, sweep
from htcp_jax.status import Status

METHODS = ("baseline", "cspace-sample")
LONGER = 0.01  # [m]
SWEEP = f"""
config: job.yaml
grid:
  - robot.tool_extension_m: [0.0, {LONGER}]
  - workpiece.rotation_y_rad: [0.4, 0.5]
"""
TOY_TARGETS = 8  # per scenario of the toy run
TOY_SWEEP = SWEEP.replace("[0.4, 0.5]", "[0.0, 0.1]")


def plan_small_run(place: Path) -> Path:
    """Plan two tools and two poses on every twelfth point of the generated weld; `place` gets files and the run."""
    np.savetxt(place / "weld.csv", duct.weld()[::12], delimiter=",")
    (place / "job.yaml").write_text("workpiece: {path: weld.csv}\nmethod: baseline\nsettings: {path_check: none}\n")
    (place / "grid.yaml").write_text(SWEEP)
    sweep(place / "grid.yaml", METHODS, place / "run", shard_scenarios=2)
    return place


@cache
def _toy_folder(points: int) -> TemporaryDirectory:
    folder = TemporaryDirectory()
    place = Path(folder.name)
    changes = {"cell": {"self_collision": False}, "program": {"velocity": [2.0] * 4}}
    toy.write_job(place, points, shift_m=(0.4, 0.02, -0.03), **changes)
    (place / "grid.yaml").write_text(TOY_SWEEP)
    spec = load_sweep(place / "grid.yaml")
    scene = spec.batch()
    plans = batch.plan(Problem.of(scene.robot, scene.workpiece, scene.scenarios, spec.config.settings), METHODS[0])
    keep_plans(spec, dict.fromkeys(METHODS, plans), place / "run", shard_scenarios=2)
    return folder


def toy_run(points: int = 3) -> Path:
    """Folder with a run of the toy arm, read and validated in a fifth of a second; read-only.

    Two tools and two poses of the shelf, all targets tracked; the plans of the second method are those of the first.
    The targets are these points of the path and five before it.
    """
    return Path(_toy_folder(points).name)


def spoil(folder: Path, scenario: int, target: int, method: str = METHODS[0], **values) -> None:
    """Put other values into one row of the results."""

    def put(rows: pa.Table) -> pa.Table:
        reported = rows.to_pylist()
        (row,) = (row for row in reported if (row["scenario"], row["target"]) == (scenario, target))
        row |= values
        return pa.Table.from_pylist(reported, rows.schema)

    rewrite(folder, method, scenario, put)


def end_early(folder: Path, scenario: int, target: int, status: Status, method: str = METHODS[0]) -> None:
    """Change the rows of a scenario as if it had failed at this target."""
    lost = {"tracked": False, "clearance_m": None, "residual_m": None, "joint_step_rad": None, "path_clear": None}
    run = open_run(folder)
    joints = dict.fromkeys(run.manifest.joints) | {f"tcp_{axis}_m": None for axis in "xyz"}

    def cut(rows: pa.Table) -> pa.Table:
        reported = rows.to_pylist()
        for row in reported:
            if row["scenario"] == scenario and row["target"] >= target:
                name = (status if row["target"] == target else Status.NOT_ATTEMPTED).name
                row |= {"status": name, **lost, **joints}
        return pa.Table.from_pylist(reported, rows.schema)

    rewrite(folder, method, scenario, cut)
    recount(folder, method)


def recount(folder: Path, method: str = METHODS[0]) -> None:
    """Make the table of scenarios and the manifest's counts follow from a method's changed table of targets."""
    run = open_run(folder)
    joints = run.manifest.joints
    expected = tables.scenario_table(method, run.points(), run.plans(method), joints, run.varied)
    for shard in run.manifest.shards:
        if shard.method == method:
            rows = expected.slice(shard.first, shard.last - shard.first + 1)
            rewrite(folder, method, shard.first, lambda _, rows=rows: rows, "scenarios")
            edit_manifest(folder, partial(_count, shard.first, method, sum(rows["tracked"].to_pylist())))


def _count(first: int, method: str, tracked: int, manifest: dict) -> None:
    (shard,) = (s for s in manifest["shards"] if (s["method"], s["first"]) == (method, first))
    shard["tracked"] = tracked


def edit_manifest(folder: Path, change: Callable[[dict], object]) -> None:
    """Change the manifest of a run."""
    manifest = json.loads((folder / MANIFEST).read_text())
    change(manifest)
    (folder / MANIFEST).write_text(json.dumps(manifest))


def rewrite(
    folder: Path, method: str, scenario: int, change: Callable[[pa.Table], pa.Table], table: str = "targets"
) -> None:
    """Change the shard with a scenario in one of the tables, and make the manifest agree with the file."""
    manifest = json.loads((folder / MANIFEST).read_text())
    (shard,) = (s for s in manifest["shards"] if s["method"] == method and s["first"] <= scenario <= s["last"])
    file = folder / table / f"{method}-{shard['first']:06d}-{shard['last']:06d}.parquet"
    rows = change(pq.read_table(file))
    pq.write_table(rows, file)
    data = file.read_bytes()
    shard[table] |= {"rows": len(rows), "bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    shard["tracked"] = min(shard["tracked"], shard["targets"]["rows"])
    (folder / MANIFEST).write_text(json.dumps(manifest))
