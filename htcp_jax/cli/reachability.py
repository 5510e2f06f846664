"""`htcp reachability`: bounds on the number of reachable targets of every scenario, compared with a run's plans."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn
from rich.text import Text

from htcp_jax.cli.output import (
    Config,
    ElapsedColumn,
    Json,
    Limit,
    Overrides,
    Seed,
    TimeLeftColumn,
    print_facts,
    print_json,
    print_table,
    progress_bars,
    stdout,
)
from htcp_jax.device import tables
from htcp_jax.errors import InputError
from htcp_jax.jobs import Batch, load_sweep_or_job, seeded
from htcp_jax.model import Scenario
from htcp_jax.reachability import PROOF_CELLS, RESOLUTION_RAD, Reachability
from htcp_jax.report import reach_study
from htcp_jax.runs import Run, checkpoint, manifest, open_run, reachability_file
from htcp_jax.system import output_files

File = Annotated[Path, typer.Argument(metavar="FILE.yaml", help="Sweep file, job file, or example.")]
Each = Annotated[bool, typer.Option("--each", help="Also test every target of the path independently of the others.")]
Resolution = Annotated[
    float,
    typer.Option(metavar="RAD", min=0.01, help="Angular resolution of the tool orientations searched."),
]
ProofCells = Annotated[
    int,
    typer.Option(
        metavar="CELLS", min=0, help="Maximum number of cells in a proof that a target is unreachable; 0: no proofs."
    ),
]
Out = Annotated[
    Path | None,
    typer.Option(metavar="DIR", help="Output folder; if it contains a run, its methods are compared with the bounds."),
]


def reachability(
    file: File,
    each: Each = False,
    resolution: Resolution = RESOLUTION_RAD,
    proof_cells: ProofCells = PROOF_CELLS,
    out: Out = None,
    limit: Limit = None,
    config: Config = None,
    overrides: Overrides = None,
    seed: Seed = None,
    as_json: Json = False,
) -> int:
    """Compute bounds on the number of consecutive targets that any method can reach, for each scenario.

    Lower bound: number of consecutive targets with a collision-free configuration, from the first target on. Upper
    bound: number of targets before the first one that is proven unreachable. With --each, every target is also tested
    independently of the others: it is reachable, excluded with the reason, or undecided.

    Writes reachability.json into the output folder, for htcp report. If the folder contains a run, the table lists the
    scenarios in which a method tracked more targets than the lower bound. With --each, also writes reach.csv, a row for
    each target, and reach.png, a picture of the part with its targets. Repeat the command to resume an interrupted
    search; you may add --each and change --limit.

    Exit codes: 0, 2 on bad input, 130 or 143 after a signal; finished work is kept.

    \b
    Examples:
      htcp reachability sweeps/workpiece                     into out/workpiece, the sweep's folder
      htcp reachability sweeps/workpiece --resolution 0.06
      htcp reachability job.yaml --each                      one job; a table and a picture in out/job
    """
    if out is None:
        out = Path("out", file.stem if config is None else f"{file.stem}-{config.stem}")
    batch = (spec := load_sweep_or_job(file, config, seeded(overrides or (), seed))).batch(limit)
    run = open_run(out) if (out / manifest.MANIFEST).exists() else None
    search = checkpoint.search_identity(spec, resolution_rad=resolution, proof_cells=proof_cells)
    with checkpoint.checkpoint(out, search, batch.scenarios.count) as kept, output_files.written_whole(out) as folder:
        found = _search(batch, resolution, proof_cells, each, kept)
        seed = spec.config.settings.seed
        record = reach_study.record_of(batch, found, resolution, proof_cells, seed)
        record |= {"beaten_by": {} if run is None else _beaten_scenarios(run, batch, found)}
        study = reach_study.ReachStudy(spec.name, batch, found, resolution, proof_cells, seed)
        if each:
            study.write(folder)
        output_files.write_json(folder / reachability_file.REACHABILITY, record)
    if as_json:
        print_json(record)
    else:
        _print_bounds(spec.name, batch, found, record, out)
        if each:
            stdout().print()
            print_table(stdout(), study.summary())
            if (reasons := study.unreached()).rows:
                stdout().print()
                print_table(stdout(), reasons)
    return 0


def _search(
    batch: Batch, resolution_rad: float, proof_cells: int, each: bool, kept: checkpoint.Checkpoint
) -> Reachability:
    """Return the reachability bounds of a batch. Show one progress bar for each of its `cells`, the distinct inputs.

    The time left is that of the current step.
    """
    what = f"targets ({kept.summary} kept)" if kept.summary else "targets"
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), ElapsedColumn(), TimeLeftColumn()
    with progress_bars(*columns, speed_estimate_period=600) as bars:
        started: dict[int, tuple[TaskID, str]] = {}

        def progress(number: int, done: int, count: int, step: str = "") -> None:
            if number not in started:
                started[number] = bars.add_task(what, total=count), step
            task, before = started[number]
            if step != before:
                bars.reset(task)
                started[number] = task, step
            text = f", each by itself: {step}" if step else ""
            text = "; proofs of which others are unreachable" if done == count and not step else text
            bars.update(task, description=f"{what}{text}", completed=done, total=count)

        progress(0, 0, batch.scenarios.targets.shape[1])
        return reach_study.search_batch(batch, resolution_rad, proof_cells, each, progress, kept)


def _beaten_scenarios(run: Run, batch: Batch, found: Reachability) -> dict[str, list[int]]:
    """Return, by method, the scenarios in which the method tracked more targets than the lower bound.

    Raises:
        InputError: If the targets of the run differ from those of the batch.
    """
    beaten = {}
    for method in run.methods:
        plans = run.plans(method)
        both = min(len(plans.target), len(found.prefix))
        here, there = tables.gather(batch.scenarios, slice(both)), plans.target[:both]
        if here.targets.shape != there.shape or np.nanmax(_away(here, there), initial=0.0) > 1e-9:
            raise InputError(
                f"{run.folder} contains a run with other targets; delete the folder, or choose another --out"
            )
        further = np.flatnonzero(plans.outcomes.tracked[:both] > found.prefix[:both])
        if len(further):
            beaten[method] = further.tolist()
    return beaten


def _away(scenarios: Scenario, targets: np.ndarray) -> np.ndarray:
    """Return the absolute differences between a run's targets and the scenarios' targets, per coordinate [m].

    They are set to 0 for an approach that deviates from its straight lines. All targets of such an approach are saved
    as the path's first point.
    """
    before = np.arange(targets.shape[1]) < scenarios.on_path[:, None]
    first = np.take_along_axis(scenarios.targets, scenarios.on_path[:, None, None], axis=1)
    left = before & (np.abs(targets - first) <= 1e-9).all(axis=2)
    return np.where(left[..., None], 0.0, np.abs(targets - scenarios.targets))


def _print_bounds(name: str, batch: Batch, found: Reachability, record: dict, out: Path) -> None:
    targets, counts = record["targets"], [int(each.sum()) for each in (found.prefix, found.most)]
    complete = int((found.prefix == batch.scenarios.count).sum())
    reachable, most = (f"{count:,} of {targets:,} targets ({100 * count / targets:.2f} %)" for count in counts)
    rows = {
        "lower bound": f"{reachable} are reachable: those before the first one, in each scenario, at which no "
        "configuration was found",
        "upper bound": f"{most} at most: those before the first one that is proven to be unreachable",
        "complete": f"{complete:,} of {len(found.prefix):,} scenarios: a configuration was found at every target",
        "resolution": "none: the task does not fix the TCP, so configurations spread over the joint limits were tried"
        if (resolution := record["resolution_rad"]) is None
        else f"tool orientations every {resolution:.3g} rad",
        "files": str(out if found.each is not None else out / "reachability.json"),
    }
    if "seams" in record:
        reached = {seam: [0, 0] for seam in record["seams"]}
        for seam, prefix, count in zip(record["seams"], record["prefix"], batch.scenarios.count.tolist(), strict=True):
            reached[seam] = [reached[seam][0] + prefix, reached[seam][1] + count]
        rows["by seam"] = ", ".join(f"{seam}: {count:,} of {of:,}" for seam, (count, of) in reached.items())
    print_facts(name, rows)
    for method, scenarios in record["beaten_by"].items():
        text = f"{method} tracked more targets than the lower bound in scenarios "
        stdout().print(Text.assemble((text, "yellow"), ", ".join(map(str, scenarios))))
