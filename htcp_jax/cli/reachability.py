"""`htcp reachability`: bounds on the reachable targets of every scenario, compared with a run's methods."""

import signal
from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Annotated

import jax
import numpy as np
import typer
from rich.text import Text

from htcp_jax.cli.output import (
    Config,
    Json,
    Limit,
    Overrides,
    SweepFile,
    print_facts,
    print_json,
    progress_bars,
    stdout,
)
from htcp_jax.device import tables
from htcp_jax.errors import InputError, Interrupted
from htcp_jax.jobs import grid
from htcp_jax.model import Scenario
from htcp_jax.reachability import (
    PROOF_CELLS,
    RESOLUTION_RAD,
    Reachability,
    SearchStopped,
    initial_reachability,
    reachable_prefixes,
)
from htcp_jax.runs import Run, manifest, open_run, plan_folder, reachability_file

Resolution = Annotated[
    float,
    typer.Option(metavar="RAD", min=0.01, help="Angular resolution of the tool orientations searched."),
]
ProofCells = Annotated[
    int, typer.Option(metavar="CELLS", min=0, help="Size of a proof that a target is unreachable; 0: no proofs.")
]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Output folder, and the run to compare with.")]


def reachability(
    file: SweepFile,
    resolution: Resolution = RESOLUTION_RAD,
    proof_cells: ProofCells = PROOF_CELLS,
    out: Out = None,
    limit: Limit = None,
    config: Config = None,
    overrides: Overrides = None,
    as_json: Json = False,
) -> int:
    """Bound the number of consecutive targets in each scenario that any method can reach.

    Lower bound: a collision-free configuration was found. Upper bound: the next target is proven to be unreachable.
    Writes reachability.json into the run folder, for htcp report, and lists methods of that run that get further. After
    a signal, the targets searched so far are saved and marked as incomplete, unless the file exists.

    Exit codes: 0, 2 on bad input, 130 or 143 after a signal.

    \b
    Examples:
      htcp reachability sweeps/workpiece                     into out/workpiece, where the sweep writes
      htcp reachability sweeps/workpiece --resolution 0.06
    """
    if out is None:
        out = Path("out", file.stem if config is None else f"{file.stem}-{config.stem}")
    batch = (spec := grid.load_sweep(file, config, overrides or ())).batch(limit)
    run = open_run(out) if (out / manifest.MANIFEST).exists() else None

    def record_of(found: Reachability) -> dict:
        return {
            "prefix": found.prefix.tolist(),
            "best_mm": [None if np.isnan(b) else 1e3 * b for b in found.best],
            "most": found.most.tolist(),
            "resolution_rad": _resolution(batch, found, resolution),
            "proof_cells": proof_cells,
            "seed": spec.config.settings.seed,
            "targets": int(batch.scenarios.count.sum()),
            "beaten_by": {} if run is None else _beaten_scenarios(run, batch, found),
        }

    try:
        with plan_folder.written_whole(out) as folder:
            found = _search_parts(batch, resolution, proof_cells)
            record = record_of(found)
            plan_folder.write_json(folder / reachability_file.REACHABILITY, record)
    except SearchStopped as stop:
        if not stop.found.prefix.any() or (out / reachability_file.REACHABILITY).exists():
            raise
        with plan_folder.written_whole(out) as folder:
            plan_folder.write_json(
                folder / reachability_file.REACHABILITY, {"complete": False, **record_of(stop.found)}
            )
        raise Interrupted(
            f"stopped; {out / reachability_file.REACHABILITY} has what was found, and is incomplete", signal.SIGINT
        ) from None
    if as_json:
        print_json(record)
    else:
        _print_bounds(spec.name, batch, found, record, out)
    return 0


def _search_parts(batch: grid.Batch, resolution_rad: float, proof_cells: int) -> Reachability:
    with progress_bars() as bars:
        parts = []
        for number, cell in enumerate(batch.cells):
            task = bars.add_task("targets", total=batch.scenarios.targets.shape[1])
            rows = np.flatnonzero(batch.cell == number)
            try:
                found = reachable_prefixes(
                    cell.robot,
                    cell.workpiece,
                    jax.tree.map(itemgetter(rows), batch.scenarios),
                    cell.settings,
                    task=cell.task,
                    obstacles=cell.obstacles,
                    resolution_rad=resolution_rad,
                    proof_cells=proof_cells,
                    progress=lambda row, rows, task=task: bars.update(task, completed=row, total=rows),
                )
            except SearchStopped as stop:
                left = np.flatnonzero(batch.cell > number)
                later = initial_reachability(jax.tree.map(itemgetter(left), batch.scenarios))
                raise SearchStopped(_in_order([*parts, (rows, stop.found), (left, later)])) from None
            parts.append((rows, found))
    return _in_order(parts)


def _in_order(parts: Sequence[tuple[np.ndarray, Reachability]]) -> Reachability:
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    return tables.gather(tables.concatenate([found for _, found in parts]), order)


def _resolution(batch: grid.Batch, found: Reachability, requested_rad: float) -> float | None:
    """Coarsest angular resolution of the search [rad]; None if a task does not hold the TCP."""
    if not all(cell.task.holds_tcp for cell in batch.cells):
        return None
    return max(requested_rad, float(found.resolution_rad.max()))


def _beaten_scenarios(run: Run, batch: grid.Batch, found: Reachability) -> dict[str, list[int]]:
    """Return the scenarios in which a method of the run got further, by method.

    Raises:
        InputError: For a run with other targets.
    """
    beaten = {}
    for method in run.methods:
        plans = run.plans(method)
        both = min(len(plans.target), len(found.prefix))
        here, there = tables.gather(batch.scenarios, slice(both)), plans.target[:both]
        if here.targets.shape != there.shape or np.nanmax(_away(here, there), initial=0.0) > 1e-9:
            raise InputError(f"{run.folder} holds a run with other targets; name another folder with --out")
        further = np.flatnonzero(plans.outcomes.tracked[:both] > found.prefix[:both])
        if len(further):
            beaten[method] = further.tolist()
    return beaten


def _away(scenarios: Scenario, targets: np.ndarray) -> np.ndarray:
    """Distance of a run's targets from those of the scenarios [m].

    It is 0 for an approach that deviates from its lines, whose targets are the path's first point.
    """
    before = np.arange(targets.shape[1]) < scenarios.on_path[:, None]
    first = np.take_along_axis(scenarios.targets, scenarios.on_path[:, None, None], axis=1)
    left = before & (np.abs(targets - first) <= 1e-9).all(axis=2)
    return np.where(left[..., None], 0.0, np.abs(targets - scenarios.targets))


def _print_bounds(name: str, batch: grid.Batch, found: Reachability, record: dict, out: Path) -> None:
    targets, reachable, most = record["targets"], int(found.prefix.sum()), int(found.most.sum())
    complete = int((found.prefix == batch.scenarios.count).sum())
    rows = {
        "lower bound": f"{reachable:,} of {targets:,} targets, {100 * reachable / targets:.2f} %",
        "complete": f"{complete:,} of {len(found.prefix):,} scenarios",
        "upper bound": f"{most:,} targets, {100 * most / targets:.2f} %; the others are proven to be unreachable",
        "resolution": "none: the task leaves the TCP free, so configurations spread over the joint limits were tried"
        if (resolution := record["resolution_rad"]) is None
        else f"tool orientations every {resolution:.3g} rad",
        "files": str(out / "reachability.json"),
    }
    print_facts(name, rows)
    for method, scenarios in record["beaten_by"].items():
        text = f"{method} gets further in scenarios "
        stdout().print(Text.assemble((text, "yellow"), ", ".join(map(str, scenarios))))
