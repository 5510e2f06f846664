"""`htcp validate`: the results of a sweep or of one plan, checked by MuJoCo alone."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from htcp_jax.cli_output import Json, print_table
from htcp_jax.document import Column, Table
from htcp_jax.validate import VALIDATION, Validation, write_validation
from htcp_jax.validate import validate as check

VALIDATED, REFUTED = 0, 1
LISTED = 10  # refuted configurations on the terminal

Run = Annotated[Path, typer.Argument(metavar="RUN", help="The folder that htcp sweep or htcp plan wrote.")]
Between = Annotated[int, typer.Option(metavar="N", help="Steps of each joint path between targets; 0 skips them.")]
Feed = Annotated[float, typer.Option(metavar="MM/S", help="Feed rate that joint speeds are told for.")]

COLUMNS = (
    Column("method", "method"),
    Column("checked", "targets", "checked", ",d"),
    Column("refuted", "refuted", "", ",d"),
    Column("tcp_error_max_mm", "TCP error", "max mm", ".3f"),
    Column("clearance_min_mm", "clearance", "min mm", ".4f"),
    Column("clearance_off_max_mm", "off record", "max mm", ".1e"),
    Column("paths", "paths", "", ",d"),
    Column("paths_touching", "touch", "", ",d"),
    Column("clearance_between_min_mm", "clearance", "on them mm", ".4f"),
    Column("line_deviation_max_mm", "off the line", "max mm", ".2f"),
    Column("speed_ratio_max", "joint speed", "of limit", ".2f"),
    Column("speed_joint", "of"),
    Column("in_place_max_rad", "in place", "max rad", ".2f"),
)


def validate(run: Run, between: Between = 20, feed_mm_s: Feed = 10.0, as_json: Json = False) -> int:
    """Check results by MuJoCo's own kinematics and distances, on the robot's model file, without the planner's code.

    At the targets: is every tracked configuration clear, on its target, within the joint limits and as recorded? Along
    the joint paths between them: how many touch, how far the TCP leaves the straight line, how fast joints must move.
    Writes validation.json into the folder, which htcp report reads. Exits with 0 when no target is refuted, with 1
    when one is, with 2 on bad input.

    \b
    htcp validate out/workpiece                 every method of a sweep
    htcp validate out/plan --feed-mm-s 50       one plan, ground at 50 mm/s
    htcp validate out/robot --between 0 --json  the targets alone, for another program
    """
    with _bar() as tell:
        found = check(run, between=between, feed_mm_s=feed_mm_s, progress=tell)
    write_validation(run, found)
    if as_json:
        print((run / VALIDATION).read_text(encoding="utf-8"), end="")
    else:
        _print(run, found)
    return VALIDATED if found.validated else REFUTED


@contextmanager
def _bar() -> Iterator[Callable[[int, int], None]]:
    """A bar of plans on a terminal and nothing elsewhere."""
    console = Console(stderr=True)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("plans", total=None)
        yield lambda done, count: bar.update(task, completed=done, total=count)


def _print(run: Path, found: Validation) -> None:
    console = Console(highlight=False, soft_wrap=True)
    rows = tuple((name, *(getattr(one, column.key) for column in COLUMNS[1:])) for name, one in found.methods.items())
    print_table(console, Table("validation", COLUMNS, rows))
    for line in _notes(found):
        console.print(Text(line, style="dim"))
    for one in found.refuted[:LISTED]:
        where = f"{one.method}, scenario {one.scenario}, target {one.target}: "
        console.print(Text.assemble((where, "red"), one.reason))
    if len(found.refuted) > LISTED:
        console.print(f"and {len(found.refuted) - LISTED:,} more")
    verdict = ("validated", "bold green") if found.validated else (f"refuted: {len(found.refuted):,}", "bold red")
    checked = sum(one.checked for one in found.methods.values())
    console.print(Text.assemble(verdict, f"  {checked:,} tracked targets in {found.seconds:.1f} s"))
    console.print(Text.assemble(("files  ", "cyan"), str(run / VALIDATION)))


def _notes(found: Validation) -> list[str]:
    """What the table's columns mean, as far as they are filled."""
    notes = []
    if found.between:
        notes.append(f"Paths are the straight joint paths between tracked targets, in {found.between} steps.")
    if any(one.speed_ratio_max is not None for one in found.methods.values()):
        notes.append(
            f"Joint speeds are for a feed rate of {found.feed_mm_s:g} mm/s, and in proportion to it. In place: between "
            "targets closer to each other than the tolerance, and from the start to the first."
        )
    return notes
