"""`htcp sweep`: plan a grid of scenarios by several methods, print a table and write a run folder."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import BarColumn, TextColumn
from rich.text import Text

from htcp_jax.cli.feed import Feed
from htcp_jax.cli.methods import complete_methods
from htcp_jax.cli.output import (
    Config,
    Device,
    ElapsedColumn,
    Json,
    Limit,
    Overrides,
    Seed,
    SweepFile,
    TimeLeftColumn,
    claim_device,
    print_json,
    print_table,
    progress_bars,
    stdout,
)
from htcp_jax.cli.timing import check_feed, print_timing, timed, timing_records
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_sweep, seeded
from htcp_jax.report import Table, result_row
from htcp_jax.runs import Run, RunningSummary, columns, labels, plan_folder, summary
from htcp_jax.runs import sweep as sweeps
from htcp_jax.status import NOT_TRIED

Methods = Annotated[
    str,
    typer.Option(metavar="A,B|all", help="Planning methods; htcp methods lists them.", autocompletion=complete_methods),
]
Out = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR", help="Output folder (run); by default out/<sweep>, with --config out/<sweep>-<config>."
    ),
]
LONGEST = 12  # maximum length of a scenario's number
Scenarios = Annotated[
    str | None,
    typer.Option(metavar="N,N,...", help="Plan only the scenarios with these numbers, as in the tables, from 0."),
]
Sample = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Plan only N scenarios of the grid, which are drawn by the seed."),
]
On = Annotated[str, typer.Option(metavar="here|ray[:ADDRESS]", help="Plan on this machine (here) or by Ray.")]
Shard = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Scenarios per work unit; by default as many as take about a minute."),
]


def sweep(
    file: SweepFile,
    methods: Methods = "all",
    out: Out = None,
    limit: Limit = None,
    scenarios: Scenarios = None,
    sample: Sample = None,
    seed: Seed = None,
    config: Config = None,
    overrides: Overrides = None,
    on: On = "here",
    shard: Shard = None,
    feed: Feed = None,
    device: Device = None,
    as_json: Json = False,
) -> int:
    """Plan every scenario of a parameter grid by several methods.

    Writes a run folder: manifest.json and Parquet files, with one row per method, scenario and target in targets/, and
    one per method and scenario in scenarios/. Repeat the command to resume an interrupted run; you may add methods and
    raise --limit, or plan more scenarios after --scenarios or --sample. Scenarios keep their numbers and their results,
    and a larger sample includes the smaller ones. With --feed, or program.feed in the job, motions to the last target
    are timed, as by htcp program.

    Exit codes: 0 if everything is planned, 1 if the workers of a cluster are lost, 2 on bad input, 130 or 143 after a
    signal; finished work is kept.

    \b
    Examples:
      htcp sweep sweeps/robot                                125 starts by all methods; htcp example lists more
      htcp sweep sweeps/workpiece --methods baseline,nspace-sqp --config paper
      htcp sweep sweeps/robot --limit 3 --set settings.alpha_rad=0.05 --out out/try
      htcp sweep sweeps/cross --sample 200 --seed 1 --methods beam,nspace-sqp
      htcp sweep sweeps/workpiece --scenarios 3,17,24 --methods beam
      htcp sweep sweeps/workpiece --methods beam --feed 20mm/s
      htcp sweep sweeps/cross --methods baseline --on ray    on the cluster that Ray finds, else on all cores
    """
    if out is None:
        out = Path("out", file.stem if config is None else f"{file.stem}-{config.stem}")
    running, chosen = RunningSummary(), sweeps.method_names(methods)
    claim_device(sweeps.device_of(on, device))  # before files are read
    spec = load_sweep(file, config, seeded(overrides or (), seed))
    feed = spec.config.program.feed if feed is None else feed
    if feed is not None:
        check_feed(spec, feed)  # before planning starts
    with _sweep_bars() as progress:
        run = sweeps.sweep(
            spec,
            chosen,
            out,
            limit=limit,
            scenarios=_numbers(scenarios),
            sample=sample,
            progress=progress,
            finished=running.add,
            shard_scenarios=shard,
            on=on,
            device=device,
        )
    if feed is not None:
        timed(run, feed, chosen)
    if as_json:
        print_json(_sweep_record(run, running))
    else:
        _print_table(run, running)
    return 0


def _numbers(text: str | None) -> list[int] | None:
    """Return the numbers in the option --scenarios; None if it is not given.

    Raises:
        InputError: If the text is no list of numbers.
    """
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if wrong := [word for word in words if not (word.isascii() and word.isdigit() and len(word) < LONGEST)]:
        raise InputError(f"--scenarios: {wrong[0]!r} is no number of a scenario; valid: numbers such as 3,17,24")
    return [int(word) for word in words]


def _sweep_record(run: Run, running: RunningSummary) -> dict:
    """Return the record that --json prints: the run folder, and a summary of every finished method."""
    found = {
        method: plan_folder.summary_record(summary.summarise(running.plans(run, method))) for method in _finished(run)
    }
    for method, record in timing_records(run, list(found)).items():
        found[method]["timing"] = record
    known = {"run": str(run.folder), "name": run.manifest.name, "complete": run.complete}
    return {**known, "unfinished": run.unfinished(), "methods": found}


def _finished(run: Run) -> list[str]:
    """Return the methods that have planned all scenarios of the run, in this call or earlier."""
    left = run.unfinished()
    return [method for method in run.methods if method not in left]


def _stage(starts: int | None) -> str:
    """Return what is done before the first target is tracked, as text for a progress bar."""
    return "loading and compiling; " if starts is None else f"{starts:,} starts ready; "


@contextmanager
def _sweep_bars() -> Iterator[Callable[[sweeps.SweepProgress], None]]:
    """Show one progress bar per method: starts that are ready, then finished scenarios, tracked targets, time left."""
    columns = (
        TextColumn("{task.description:<14}"),
        BarColumn(),
        TextColumn("{task.fields[stage]}{task.fields[scenarios]} scenarios, {task.fields[tracked]:,} targets tracked"),
        ElapsedColumn(),
        TimeLeftColumn(elapsed_when_finished=True),
    )
    with progress_bars(*columns, speed_estimate_period=600) as bars:
        tasks, first = {}, {}

        def show(now: sweeps.SweepProgress) -> None:
            # The bar counts decided targets: all targets of a finished scenario, tracked or not.
            decided = max(now.targets_tracked, now.targets * now.scenarios_done // now.scenarios)
            waits = decided == first.setdefault(now.method, decided) < now.targets
            stage = _stage(now.starts) if waits else ""
            if now.is_planning and now.scenarios_done == now.scenarios:
                stage = "verifying and saving; "
            fields = {"scenarios": f"{now.scenarios_done:,}/{now.scenarios:,}", "tracked": now.targets_tracked}
            fields["stage"] = stage
            if now.method not in tasks:
                tasks[now.method] = bars.add_task(now.method, total=now.targets, **fields)
            bars.update(tasks[now.method], completed=decided, **fields)

        yield show


COUNTS = (
    "method", "tracked_percent", "tracked", columns.total("targets"), "executable", "complete",
    columns.total("scenarios"), "blocked",
)  # fmt: skip
FIGURES = (
    "method", "step_ms", "tcp_distance_mean_mm", "orientation_error_mean_deg", "clearance_min_mm", "clearance_mean_mm",
    "run_s",
)  # fmt: skip


def _print_table(run: Run, running: RunningSummary) -> None:
    """Print the tables of a run's results by method, the explanations, and the unfinished methods."""
    console = stdout()
    part = f", {run.manifest.part}" if run.manifest.part else ""
    console.print(Text(f"{run.manifest.name}{part}", style="bold"))
    plans = {method: running.plans(run, method) for method in _finished(run)}
    rows = [result_row(method, summary.summarise(whole)) for method, whole in plans.items()]
    for keys in (COUNTS, FIGURES):
        print_table(console, Table.of("sweep", keys, rows).without_empty())
        console.print()
    print_timing(run, list(plans))
    kind = "sampled" if any(row.sampled for row in run.config.task_rows) else "proven"
    console.print(Text(f"Executable: tracked, and a {kind} motion leads there from the given start.", style="dim"))
    if plans:
        compile_s = sum(whole.compile_s for whole in plans.values())
        console.print(Text(f"Compiling for all methods took {compile_s:.2f} s.", style="dim"))
        requested = _margin_text(running.margins_m(run, *plans))
        text = f"Tracked: reached with the required clearance of {requested} mm or more."
        console.print(Text(text, style="dim"))
    for text in dict.fromkeys(not_tried(whole.status) for whole in plans.values()):
        if text:
            console.print(Text.assemble(("not tried  ", "yellow"), text))
    for method, count in run.unfinished().items():
        text = f"{count:,} of {run.manifest.count:,} scenarios left; run again with --methods {method} to plan them"
        console.print(Text.assemble(("unfinished  ", "yellow"), f"{method}: {text}"))
    console.print(Text.assemble(("files  ", "cyan"), str(run.folder)))


def _margin_text(requested_m: np.ndarray) -> str:
    """Return the required clearance, or the range of the required clearances of all scenarios, as text [mm]."""
    requested = 1e3 * requested_m
    return f"{requested[0]:g}" if len(requested) == 1 else f"{requested[0]:g} to {requested[-1]:g}"


def not_tried(status: np.ndarray) -> str:
    """Return text with the number of scenarios that were not planned, by reason; "" if all were planned."""
    counts = {reason: int((status == reason).sum()) for reason in NOT_TRIED}
    return ", ".join(
        f"{reason.words}: {labels.counted(count, 'scenario')}" for reason, count in counts.items() if count
    )
