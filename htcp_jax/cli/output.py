"""Options and output of several commands: only a table on stdout or, with --json, only JSON.

Progress and warnings go to stderr; if that is not a terminal, progress is a line every ten seconds. NO_COLOR disables
colours.
"""

import contextlib
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import rich.table
import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from htcp_jax.report import Table

WIDEST = 100_000  # characters; wider than any table, as tables are folded before
LINE_S = 10.0  # between lines of progress
GAP, LEAST_TEXT = 2, 30  # between columns; minimum width of a last column of text
TIED = "of", "at", "scenario:"  # heads of columns that are not separated from the one before

Device = Annotated[
    str | None, typer.Option(metavar="cpu|gpu[:N]", help="Device to plan on; by default a GPU if there is one.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of the table.")]

# Options of the commands that plan.
SweepFile = Annotated[Path, typer.Argument(metavar="SWEEP.yaml", help="Sweep file or example.")]
Limit = Annotated[int | None, typer.Option(metavar="N", help="Plan only the first N scenarios.")]
Config = Annotated[Path | None, typer.Option(metavar="CONFIG.yaml", help="Job file to use instead of the sweep's own.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the job; may be repeated.")
]
Seed = Annotated[int | None, typer.Option(metavar="S", help="Random seed.")]


def claim_device(device: str | None) -> None:
    """Refuse a device that this host lacks.

    For the CPU, keep JAX off the GPUs, of whose memory it would take most: the process is the command's own.

    Raises:
        InputError: For such a device.
    """
    import jax  # here, as it takes a second

    from htcp_jax.device import devices

    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    devices.choose(device)


def stdout() -> Console:
    """Return a console for tables, of unlimited width and without automatic highlighting."""
    return Console(highlight=False, soft_wrap=True)


def print_json(record: Any) -> None:
    """Print `record` to stdout; NaN and infinities become null."""
    from htcp_jax.runs import plan_folder

    print(plan_folder.json_text(record))


def print_facts(title: str, facts: Mapping[str, str]) -> None:
    """Print one line per fact under a title, names and values aligned."""
    console = stdout()
    width = max(20, *(len(name) + 2 for name in facts))
    console.print(Text(title, style="bold"))
    for name, value in facts.items():
        console.print(Text.assemble((f"{name:<{width}}", "cyan"), value))


@contextmanager
def progress_bars(*columns: ProgressColumn, line_s: float | None = None, **how: Any) -> Iterator[Progress]:
    """Show progress bars on a terminal until the block ends; elsewhere print one of them as a line now and then.

    Args:
        *columns: Columns of a bar; by default description, counts and elapsed time.
        line_s: Time between lines [s]; by default LINE_S.
        **how: Further arguments of `rich.progress.Progress`.
    """
    columns = columns or (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    console, ended = Console(stderr=True), threading.Event()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal, **how) as bars:
        if not console.is_terminal:
            threading.Thread(target=_print_lines, args=(bars, ended, line_s or LINE_S), daemon=True).start()
        try:
            yield bars
        finally:
            ended.set()


def _print_lines(bars: Progress, ended: threading.Event, line_s: float) -> None:
    while not ended.wait(line_s):
        for task in [each for each in bars.tasks if not each.finished][:1] or bars.tasks[-1:]:
            cells = [column(task) for column in bars.columns if not isinstance(column, BarColumn)]
            with contextlib.suppress(OSError, ValueError):  # stderr is closed
                print(f"htcp: {' '.join(f'{cell}'.strip() for cell in cells)}", file=sys.stderr, flush=True)


@contextmanager
def progress_bar(
    what: str, *, time_left: bool = False, line_s: float | None = None
) -> Iterator[Callable[[int, int], None]]:
    """Show one progress bar, and yield a function to be called with the number of finished steps and of all.

    Args:
        what: Name of the steps, in the plural.
        time_left: True to show the remaining instead of the elapsed time.
        line_s: See `progress_bars`.
    """
    time = TimeRemainingColumn() if time_left else TimeElapsedColumn()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), time
    with progress_bars(*columns, line_s=line_s) as bars:
        task = bars.add_task(what, total=None)
        yield lambda done, count: bars.update(task, completed=done, total=count)


def width() -> int:
    """Width of the terminal, or COLUMNS, in characters; 80 if there is neither."""
    return shutil.get_terminal_size((80, 24)).columns


def print_table(console: Console, table: Table) -> None:
    """Print heads, units and rows in columns, numbers to the right.

    Columns beyond the terminal's width continue below, with the first column repeated.
    """
    for number, part in enumerate(_folded(table, width())):
        if number:
            console.print()
        lines = console.render_lines(_laid_out(part), console.options.update(max_width=WIDEST), pad=False)
        for segments in lines:
            line = Text.assemble(*((segment.text, segment.style or "") for segment in segments))
            line.rstrip()
            console.print(line)


def _laid_out(table: Table) -> rich.table.Table:
    """Return the table in rich's layout; a last column of text is wrapped."""
    laid_out = rich.table.Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0), header_style="cyan")
    *before, last = range(len(table.columns))
    room = max(LEAST_TEXT, width() - sum(_needed(table, k) + GAP for k in before))
    for k, column in enumerate(table.columns):
        units = ["\n", (column.unit, "dim")] if any(each.unit for each in table.columns) else []
        style, wraps = "dim" if column.quiet else "", before and k == last and not column.form
        laid_out.add_column(
            Text.assemble(column.head, *units),
            justify="right" if column.form else "left",
            style=style,
            header_style=style,
            no_wrap=not wraps,
            max_width=room if wraps else None,
        )
    for row in table.rows:
        laid_out.add_row(*(Text(column.text(cell)) for column, cell in zip(table.columns, row, strict=True)))
    return laid_out


def _folded(table: Table, most: int) -> Iterator[Table]:
    """Split the table between columns into tables that fit, each with the first column.

    A last column of text needs at most LEAST_TEXT, as it is wrapped. Columns in TIED stay with the one before them.
    """
    taken, used = [0], _needed(table, 0)
    for group in _groups(table):
        wide = sum(GAP + _needed(table, k) for k in group)
        if taken[1:] and used + wide > most:
            yield _columns_part(table, taken)
            taken, used = [0], _needed(table, 0)
        taken, used = taken + group, used + wide
    yield _columns_part(table, taken)


def _groups(table: Table) -> list[list[int]]:
    groups: list[list[int]] = []
    for k in range(1, len(table.columns)):
        tied = table.columns[k].head in TIED or table.columns[k].quiet
        groups[-1:] = [groups[-1] + [k]] if tied and groups else [*groups[-1:], [k]]
    return groups


def _columns_part(table: Table, chosen: list[int]) -> Table:
    rows = tuple(tuple(row[k] for k in chosen) for row in table.rows)
    return table._replace(columns=tuple(table.columns[k] for k in chosen), rows=rows)


def _needed(table: Table, k: int) -> int:
    column = table.columns[k]
    text = max((len(column.text(row[k])) for row in table.rows), default=0)
    if k and k == len(table.columns) - 1 and not column.form:
        text = min(text, LEAST_TEXT)
    return max(text, len(column.head), len(column.unit))
