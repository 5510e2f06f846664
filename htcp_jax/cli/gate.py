"""`htcp gate`: does a run still reach what a baseline says it reached?"""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax.cli.output import Json, print_json, print_table, progress_bar, stdout
from htcp_jax.errors import InputError
from htcp_jax.report.document import Column, Table
from htcp_jax.runs.labels import named
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.run_folder import Run, open_run
from htcp_jax.validation.baseline import bless as write_baseline
from htcp_jax.validation.baseline import read_baseline
from htcp_jax.validation.gate import ChangedOutcome, Verdict, judge

PASSED, REGRESSION = 0, 1
LISTED = 20  # scenarios on the terminal

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="The folder that htcp sweep wrote.")]
File = Annotated[Path, typer.Option(metavar="FILE", help="The baseline.")]
Bless = Annotated[bool, typer.Option("--bless", help="Write RUN into FILE as the new baseline.")]

COUNTS = (
    Column("method", "method"),
    Column("verdict", "verdict"),
    Column("was_tracked", "tracked", "before", ",d"),
    Column("tracked", "tracked", "now", ",d"),
    Column("targets", "of", "", ",d"),
    Column("worse", "scenarios", "earlier", "d"),
    Column("better", "scenarios", "further", "d"),
)
FIGURES = (
    Column("method", "method"),
    Column("was_share", "reachable", "before %", ".2f"),
    Column("share", "reachable", "now %", ".2f"),
    Column("was_tcp_error_max_mm", "TCP error", "before mm", ".3f"),
    Column("tcp_error_max_mm", "TCP error", "now mm", ".3f"),
    Column("was_clearance_min_mm", "clearance", "before mm", ".3g"),
    Column("clearance_min_mm", "clearance", "now mm", ".3g"),
)
TIMES = (
    Column("method", "method"),
    Column("was_held", "feed held", "before", ",d"),
    Column("held", "feed held", "now", ",d"),
    Column("was_cycle_mean_s", "cycle time", "before s", ".3f"),
    Column("cycle_mean_s", "cycle time", "now s", ".3f"),
)


def gate(run: RunFolder, baseline: File, bless: Bless = False, as_json: Json = False) -> int:
    """Hold a run against a baseline: targets tracked, scenarios that flipped, the share of what is reachable, and, by
    MuJoCo alone, the TCP and the clearance of every tracked target; where the baseline has them, cycle times and feeds.

    A method, a scenario or a figure that is missing is a failure, and so is a run that cannot be read. How long
    planning takes never counts. Exits with 0 when the run passes, with 1 when it does not, with 2 on bad input.

    \b
    htcp sweep sweeps/seams-part --methods baseline,nspace-sqp
    htcp gate out/seams-part --baseline mine.yaml --bless    the run is the new baseline
    htcp gate out/seams-part --baseline mine.yaml            later runs are held to it
    """
    if bless:
        with progress_bar("plans", time_left=True) as progress:
            write_baseline(open_run(run), baseline, progress)
        print_json({"baseline": str(baseline)}) if as_json else print(f"{run} is the baseline now: {baseline}")
        return PASSED
    known = read_baseline(baseline)
    try:
        there = open_run(run)
    except InputError as error:
        if not (run / MANIFEST).exists():
            raise
        _print_unreadable(str(error), as_json)
        return REGRESSION
    with progress_bar("plans", time_left=True) as progress:
        verdict = judge(there, known, progress)
    if as_json:
        print_json(_record(verdict))
    else:
        _print(there, verdict)
    return PASSED if verdict.passed else REGRESSION


def _print_unreadable(reason: str, as_json: bool) -> None:
    if as_json:
        print_json({"passed": False, "failures": [reason]})
    else:
        stdout().print(Text.assemble(("failed  ", "bold red"), reason))


def _record(verdict: Verdict) -> dict:
    changed = [one._asdict() | {"target": one.target, "reason": one.reason} for one in verdict.changed]
    changed = [one | {"was": one["was"]._asdict(), "now": one["now"]._asdict()} for one in changed]
    rows = [row._asdict() for row in verdict.rows]
    before = {"flips": changed, "news": verdict.improvements}  # what two keys were called; for one version more
    return verdict._asdict() | {"allow": verdict.allow.model_dump(), "rows": rows, "changed": changed} | before


def _print(run: Run, verdict: Verdict) -> None:
    console = stdout()
    labels = run.labels() if verdict.changed else {}
    console.print(Text(run.manifest.name, style="bold"))
    for columns in (COUNTS, FIGURES, TIMES):
        known = [c for c in columns if any(getattr(row, c.key) is not None for row in verdict.rows)]
        if known[1:]:
            rows = tuple(tuple(getattr(row, column.key) for column in known) for row in verdict.rows)
            print_table(console, Table("gate", tuple(known), rows))
            console.print()
    for changed in verdict.changed[:LISTED]:
        console.print(_describe(changed, labels))
    if len(verdict.changed) > LISTED:
        console.print(f"and {len(verdict.changed) - LISTED:,} more scenarios that flipped")
    if verdict.elsewhere:
        console.print(Text("On another device or with other versions than the baseline: see allow.elsewhere.", "dim"))
    for line in verdict.improvements:
        console.print(Text.assemble(("better  ", "green"), line))
    for line in verdict.failures[:LISTED]:
        console.print(Text.assemble(("failed  ", "bold red"), line))
    if len(verdict.failures) > LISTED:
        console.print(f"and {len(verdict.failures) - LISTED:,} more failures")
    console.print(Text("passed", "bold green") if verdict.passed else Text("FAILED", "bold red"))


def _describe(changed: ChangedOutcome, labels: dict[int, str]) -> Text:
    style = "red" if changed.worse else "green" if changed.better else "dim"
    where = f"{changed.method}, scenario {named(changed.scenario, labels)}: first at target {changed.target}, "
    return Text.assemble(
        (where, style), f"{changed.was.tracked} tracked before, {changed.now.tracked} now; {changed.reason}"
    )
