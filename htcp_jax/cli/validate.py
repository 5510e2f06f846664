"""`htcp validate`: check the results of a sweep or of one plan with MuJoCo, without the planner's code."""

import sys
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax.cli.output import Json, print_facts, print_json, print_table, progress_bar, stdout
from htcp_jax.report import validation
from htcp_jax.runs import labels as run_labels
from htcp_jax.runs import manifest, open_run, plan_folder
from htcp_jax.runs import open as plan_sets
from htcp_jax.spec import feed as feed_rates
from htcp_jax.validation import Validation, validation_record, write_validation
from htcp_jax.validation import validate_results as check

VALIDATED, REFUTED = 0, 1
ANNOUNCED_S, SURE_S = 60, 2  # the estimated duration is printed if it is longer than this, after this time [s]
LISTED = 10  # maximum number of refuted configurations on the terminal

Run = Annotated[Path, typer.Argument(metavar="RUN", help="Output folder of htcp plan or htcp sweep.")]
BetweenTargets = Annotated[
    int, typer.Option(metavar="N", help="Minimum number of samples of each segment; 0 skips segments.")
]
FeedMmS = Annotated[float | None, typer.Option(metavar="MM/S", hidden=True)]
Feed = Annotated[
    str | None,
    typer.Option(
        metavar="SPEED",
        help="Feed rate at which joint speeds are computed; by default the seam's or the job's, else 10mm/s.",
    ),
]

Verbose = Annotated[
    bool, typer.Option("--verbose", help="Also print the tables by method, and what their columns mean.")
]


def validate(
    run: Run,
    between: BetweenTargets = 20,
    feed: Feed = None,
    feed_mm_s: FeedMmS = None,
    verbose: Verbose = False,
    as_json: Json = False,
) -> int:
    """Check plans with MuJoCo's kinematics and distances on the robot's model file, without the planner's code.

    Checked at every tracked target: clearance, TCP error, joint limits, and agreement with the saved values. Checked
    between targets: collisions at samples, path deviation, joint speeds. Writes validation.json into the folder, for
    htcp report. If the folder contains a check of the same results with more samples, it is not overwritten.

    Exit codes: 0 if no target is refuted, 1 if one is, 2 on bad input. A target or seam that the plan lacks is not
    refuted: it is named, and the exit code of htcp plan is 3.

    \b
    Examples:
      htcp plan
      htcp validate out/plan --feed 50mm/s        one plan, executed at 50 mm/s
      htcp sweep sweeps/workpiece --methods baseline,nspace-sqp
      htcp validate out/workpiece                 every method of a sweep
      htcp validate out/workpiece --between 0 --json  check only the targets, print JSON
    """
    feed_mm_s = feed_mm_s if feed is None else 1e3 * feed_rates.feed_of(feed)
    run = plan_sets.run_folder(run)
    began = time.perf_counter()
    with progress_bar("plans", time_left=True) as progress:
        announced = False

        def show(done: float | int, count: int) -> None:
            nonlocal announced
            spent = time.perf_counter() - began
            if done and not announced and (spent > SURE_S or done >= 1):
                announced = True
                if (seconds := spent * count / done) > ANNOUNCED_S:
                    text = f"about {seconds:,.0f} s for {run_labels.counted(count, 'plan')}"
                    print(f"{text}, estimated after {spent:.0f} s", file=sys.stderr, flush=True)
            progress(done, count)

        found = check(run, between=between, feed_mm_s=feed_mm_s, progress=show)
    write_validation(run, found)
    if as_json:
        print_json(validation_record(found))
    else:
        _print_validation(run, found, verbose)
    return VALIDATED if found.validated else REFUTED


def _print_validation(run: Path, found: Validation, verbose: bool) -> None:
    console = stdout()
    recorded = validation_record(found)
    is_sweep = (run / manifest.MANIFEST).exists()
    labels = open_run(run).labels() if is_sweep else {}
    lines = found.unchecked
    if verbose:
        for table in validation.validation_tables(recorded):
            print_table(console, table)
            console.print()
        lines = (*validation.scenarios_named(recorded, labels), *validation.notes(recorded))
    else:
        print_facts(run.resolve().name, validation.plain_lines(recorded, is_sweep))
    for line in lines:
        console.print(Text(line, style="dim"))
    for one in found.refuted[:LISTED]:
        where = f"{one.method}, scenario {run_labels.named_scenario(one.scenario, labels)}, target {one.target}: "
        console.print(Text.assemble((where, "red"), one.reason))
    if len(found.refuted) > LISTED:
        console.print(f"and {len(found.refuted) - LISTED:,} more")
    verdict = ("validated", "bold green") if found.validated else (f"refuted: {len(found.refuted):,}", "bold red")
    checked = sum(one.checked for one in found.methods.values())
    console.print(Text.assemble(verdict, f"  {checked:,} tracked targets in {found.seconds:.1f} s"))
    console.print(Text.assemble(("files  ", "cyan"), str(run / plan_folder.VALIDATION)))
