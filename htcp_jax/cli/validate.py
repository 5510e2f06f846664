"""`htcp validate`: the results of a sweep or of one plan, validated by MuJoCo alone."""

import sys
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax.cli.output import Json, print_json, print_table, progress_bar, stdout
from htcp_jax.report.validation import notes, scenarios_named, validation_tables
from htcp_jax.runs.labels import named
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.open import run_folder
from htcp_jax.runs.plan_folder import VALIDATION
from htcp_jax.runs.run_folder import open_run
from htcp_jax.validation.result import Validation
from htcp_jax.validation.validate import record, write_validation
from htcp_jax.validation.validate import validate as check

VALIDATED, REFUTED = 0, 1
WORTH_SAYING_S = 60  # longer checks are announced
LISTED = 10  # refuted configurations on the terminal

Run = Annotated[Path, typer.Argument(metavar="RUN", help="The folder that htcp sweep or htcp plan wrote.")]
Between = Annotated[int, typer.Option(metavar="N", help="Least steps of each joint path; 0 skips them.")]
Feed = Annotated[float, typer.Option(metavar="MM/S", help="Feed rate that joint speeds are told for.")]


def validate(run: Run, between: Between = 20, feed_mm_s: Feed = 10.0, as_json: Json = False) -> int:
    """Check results by MuJoCo's own kinematics and distances, on the robot's model file, without the planner's code.

    At the targets: is every tracked configuration clear, on its target, within the joint limits and as recorded? Along
    the joint paths between them: how many touch, how far the TCP leaves the straight line, how fast joints must move.
    Writes validation.json into the folder, which htcp report reads; one of the same results that looked closer at the
    joint paths stays. Exits with 0 when no target is refuted, with 1 when one is, with 2 on bad input.

    \b
    htcp plan
    htcp validate out/plan --feed-mm-s 50       one plan, ground at 50 mm/s
    htcp sweep sweeps/workpiece --methods baseline,nspace-sqp
    htcp validate out/workpiece                 every method of a sweep
    htcp validate out/workpiece --between 0 --json  the targets alone, for another program
    """
    run = run_folder(run)
    began = time.perf_counter()
    with progress_bar("plans", time_left=True) as progress:

        def show(done: int, count: int) -> None:
            if done == 1 and (seconds := (time.perf_counter() - began) * count) > WORTH_SAYING_S:
                print(f"about {seconds:,.0f} s for {count:,} plans, as the first one took", file=sys.stderr, flush=True)
            progress(done, count)

        found = check(run, between=between, feed_mm_s=feed_mm_s, progress=show)
    write_validation(run, found)
    if as_json:
        print_json(record(found))
    else:
        _print(run, found)
    return VALIDATED if found.validated else REFUTED


def _print(run: Path, found: Validation) -> None:
    console = stdout()
    recorded = record(found)
    for table in validation_tables(recorded):
        print_table(console, table)
        console.print()
    labels = open_run(run).labels() if (run / MANIFEST).exists() else {}
    for line in (*scenarios_named(recorded, labels), *notes(recorded)):
        console.print(Text(line, style="dim"))
    for one in found.refuted[:LISTED]:
        where = f"{one.method}, scenario {named(one.scenario, labels)}, target {one.target}: "
        console.print(Text.assemble((where, "red"), one.reason))
    if len(found.refuted) > LISTED:
        console.print(f"and {len(found.refuted) - LISTED:,} more")
    verdict = ("validated", "bold green") if found.validated else (f"refuted: {len(found.refuted):,}", "bold red")
    checked = sum(one.checked for one in found.methods.values())
    console.print(Text.assemble(verdict, f"  {checked:,} tracked targets in {found.seconds:.1f} s"))
    console.print(Text.assemble(("files  ", "cyan"), str(run / VALIDATION)))
