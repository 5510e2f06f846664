"""`htcp place`: search for mountings of the workpiece or the arm, and rank those that complete the path."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import BarColumn, TextColumn
from rich.text import Text

from htcp_jax import report
from htcp_jax.cli.heartbeat import HEARTBEAT
from htcp_jax.cli.output import (
    Device,
    ElapsedColumn,
    Json,
    claim_device,
    print_facts,
    print_json,
    print_table,
    progress_bars,
    progress_text,
    stdout,
)
from htcp_jax.errors import InputError, mm_text
from htcp_jax.placement import PlacementResult, PlaceProgress, mounting, tolerance
from htcp_jax.placement import place as search_places
from htcp_jax.report import Table
from htcp_jax.runs import Column, columns
from htcp_jax.runs import sweep as sweeps

NONE_FOUND = 3
WORDS = {  # purpose of each stage, as in: 200 to search
    "search": "search", "confirm": "confirm", "perturb": "perturb the best", "tolerance": "determine the tolerance",
}  # fmt: skip
File = Annotated[Path, typer.Argument(metavar="PLACE.yaml", help="Placement file: search ranges, seams, objective.")]
Out = Annotated[Path | None, typer.Option(metavar="DIR", help="Output folder; by default out/<name of the file>.")]
JobFile = Annotated[
    Path | None, typer.Option(metavar="CONFIG.yaml", help="Job file that replaces the job of PLACE.yaml.")
]
Seed = Annotated[int | None, typer.Option(metavar="S", help="Random seed of the search.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the job; may be repeated.")
]
WithinN = Annotated[
    int | None,
    typer.Option(
        "--scenarios", metavar="N", help="Scenarios to evaluate, one per mounting and seam; overrides within."
    ),
]
WithinS = Annotated[
    float | None,
    typer.Option(
        "--seconds",
        metavar="S",
        help="Time limit of the command, without compilation [s]; overrides within.",
    ),
]
On = Annotated[str, typer.Option(metavar="here|ray[:ADDRESS]", help="Plan on this machine (here) or by Ray.")]


def place(
    file: File,
    out: Out = None,
    scenarios: WithinN = None,
    seconds: WithinS = None,
    seed: Seed = None,
    config: JobFile = None,
    overrides: Overrides = None,
    on: On = "here",
    device: Device = None,
    as_json: Json = False,
) -> int:
    """Search for mountings of the workpiece or the arm with which the arm completes one or several paths.

    Quick plans evaluate mountings, first spread over the search ranges, then near the best ones. For the best
    mountings, proven motions are planned with the largest possible margin. Then these mountings are perturbed, planned
    again and ranked. Writes ranked.json, a job file for each ranked mounting, all evaluated mountings, pictures, and a
    run folder with the motions for view, render, validate and program. A first ranking is written before mountings are
    perturbed. Repeat the command to resume an interrupted search.

    Exit codes: 0 if a mounting is found, 3 if none is, 2 on bad input, 130 or 143 after a signal; finished work
    is kept.

    \b
    Examples:
      htcp place place/duct                                  search for mountings for the weld in the duct
      htcp place place/duct --scenarios 500 --out out/try
      htcp plan out/duct/best-1.yaml                         plan the job of the best mounting
      htcp view out/duct                                     show the ranked mountings in the browser
    """
    claim_device(sweeps.device_of(on, device))  # before files are read
    changes: dict[str, Any] = {} if seed is None else {"seed": seed}
    if scenarios is not None and seconds is not None:
        raise InputError("--scenarios and --seconds exclude each other; omit one")
    if scenarios is not None or seconds is not None:
        changes["within"] = {"scenarios": scenarios} if seconds is None else {"seconds": seconds}
    with _bar(announced=as_json) as progress:
        found = search_places(
            file,
            Path("out", file.stem) if out is None else out,
            config=config,
            overrides=overrides or (),
            changes=changes,
            on=on,
            device=device,
            progress=progress,
            began_s=HEARTBEAT.began_s,
        )
    with progress_text("drawing pictures"):
        report.draw_search(found.folder)
    if as_json:
        print_json(found.record())
    else:
        _print_mountings(found, time.monotonic() - HEARTBEAT.began_s)
    return 0 if found.mountings else NONE_FOUND


@contextmanager
def _bar(announced: bool) -> Iterator[Callable[[PlaceProgress], None]]:
    """Show one progress bar per stage on a terminal, with the numbers of scenarios and of complete mountings.

    Before the first bar, the maximum number of plans is printed, unless `announced` is True.
    """
    columns = TextColumn("{task.description:<10}"), BarColumn(), TextColumn("{task.fields[text]}"), ElapsedColumn()
    with progress_bars(*columns) as bars:
        tasks: dict[str, Any] = {}

        def show(now: PlaceProgress) -> None:
            if not (announced or tasks):
                print(_stage_maxima(now.most) + (f"; {now.kept:,} are kept" if now.kept else ""), flush=True)
            for line in now.news:
                bars.console.print(Text(f"htcp: {line}"), soft_wrap=True)
            if now.stage not in tasks:
                for task in bars.tasks:
                    bars.update(task.id, total=task.completed)  # shows the earlier stage as finished
                tasks[now.stage] = bars.add_task(now.stage, total=now.of, text="")
            text = f"{now.scenarios:,} {'plans' if now.of is None else f'of up to {now.of:,} plans'}"
            if now.stage == "search":
                text += f", {now.complete:,} complete mountings"
            bars.update(tasks[now.stage], completed=now.scenarios, text=text)

        yield show


def _stage_maxima(most: dict[str, int | None]) -> str:
    """Return a line with the maximum number of plans, in total and by stage."""
    searched, *others = most.values()
    if searched is None:
        return "as many plans as the time limit allows in all; time for compilation is added to it"
    parts = ", ".join(f"{count:,} to {WORDS[stage]}" for stage, count in most.items() if count)
    return f"up to {searched + sum(others):,} plans: {parts}"


def _print_mountings(found: PlacementResult, seconds: float) -> None:
    search, console = found.search, stdout()
    perturbation = search.file.perturbation
    facts = {
        "evaluated": f"{sum(len(each.values) for each in found.scores):,} mountings by {search.file.screen}",
        "complete": f"{found.complete:,} of them",
        **_seams(found),
        "confirmed": f"{len(found.mountings)} as proven motions by {search.file.confirm}"
        if found.is_final
        else "none within the time limit" + "; the mountings are ranked by their quick plans" * bool(found.mountings),
        "time": f"{seconds:.0f} s, {found.compile_s:.0f} s of them for compilation",
    }
    print_facts(search.name, facts)
    console.print()
    if found.mountings:
        print_table(console, _mountings_table(found))
        console.print()
        text = (
            f"Margin: the required clearance in the mounting's plan and job file ({found.jobs[0][0]} and following). "
            f"Perturbed: the worst value if each parameter changes by up to {perturbation.mm:g} mm and "
            f"{perturbation.deg:g}°. Tolerates: the largest perturbation at which all tested motions complete with a "
            f"margin of {1e3 * search.job.margin_m:g} mm."
        )
        if any(one.inside.solid for one in found.mountings):
            text += " Part inside: the solid of the cell in which the part is deeper than in the job as given."
        console.print(Text(text, style="dim"))
        console.print(Text.assemble(("plan   ", "cyan"), f"htcp plan {found.folder / found.jobs[0][0]}"))
    console.print(Text.assemble(("map    ", "cyan"), str(found.folder / "map.png")))
    console.print(Text.assemble(("files  ", "cyan"), str(found.folder)))


def _seams(found: PlacementResult) -> dict[str, str]:
    """Return text by label: how many mountings complete each seam, and the seams that the best mounting fails."""
    seams = found.seams()
    if len(seams) == 1:
        ((_, best),) = seams.values()
        return {} if found.complete or found.mountings else {"best": f"{100 * best:.1f} % of the targets"}
    facts = {"each seam alone": ", ".join(f"{name}: {count:,}" for name, (count, _) in seams.items())}
    if not found.complete and not found.mountings:
        lost = [f"{name} ({100 * share:.1f} % of it)" for name, (_, share) in seams.items() if share < 1]
        facts["best"] = f"{len(seams) - len(lost)} of {len(seams)} seams; prevented by {', '.join(lost)}"
    return facts


def _mountings_table(found: PlacementResult) -> Table:
    axes, aims = found.search.ranges.axes, found.search.file.objective
    parameters = [axis.shown for axis in axes]
    shown: list[str | Column] = ["rank", *(Column(one.column, one.name, one.unit, ".4g") for one in parameters)]
    for name in aims:
        worst = Column(f"{name} off", "perturbed", mounting.UNITS[name][0], ".3g")
        shown += [worst._replace(key=name, heading=name), worst]
    shown += ["margin_mm", "part_inside", "tolerates"]
    rows = [
        (
            number,
            *(value * each.scale for each, value in zip(parameters, one.values.tolist(), strict=True)),
            *(_shown_value(name, v) for name, a, b in zip(aims, one.objective, one.worst, strict=True) for v in (a, b)),
            1e3 * one.margin_m,
            f"{one.inside.solid}, {mm_text(one.inside.depth_m)}" if one.inside.solid else None,
            _tolerated(found, one),
        )
        for number, one in enumerate(found.mountings, 1)
    ]
    return Table("place", columns.of(*shown), tuple(rows)).without_empty()


def _shown_value(objective_name: str, value: float) -> float:
    return mounting.UNITS[objective_name][1] * float(value) if math.isfinite(value) else math.nan


def _tolerated(found: PlacementResult, one) -> str:
    if one.tolerance is None:
        return f"{100 * one.success_rate:.0f} % of the perturbed mountings are complete" if one.success_rate < 1 else ""
    perturbation = found.search.file.perturbation
    if not one.tolerance.together:
        return f"less than {tolerance.LEVELS[0] * perturbation.mm:g} mm and {tolerance.LEVELS[0] * perturbation.deg:g}°"
    return f"{one.tolerance.together * perturbation.mm:g} mm and {one.tolerance.together * perturbation.deg:g}°"
