"""Options and output that several commands share. stdout contains only tables or, with --json, only JSON.

Progress and warnings go to stderr. If stderr is not a terminal, progress is printed as a line every ten seconds.
NO_COLOR disables colours.
"""

import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
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
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from htcp_jax.cli import heartbeat
from htcp_jax.cli.heartbeat import HEARTBEAT
from htcp_jax.device import COMPILATIONS
from htcp_jax.report import Table

WIDEST = 100_000  # console width [characters], wider than any table: tables are split before they are printed
GAP, LEAST_TEXT = 2, 30  # space between columns, and minimum width of a text column at a table's right end [characters]
TIED = "of", "at", "scenario:"  # headings of columns that must not be separated from the column to their left

Device = Annotated[
    str | None, typer.Option(metavar="cpu|gpu[:N]", help="Device to plan on; by default a GPU if there is one.")
]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of the table.")]

# Options of the commands that plan.
SweepFile = Annotated[Path, typer.Argument(metavar="SWEEP.yaml", help="Sweep file or example.")]
Limit = Annotated[int | None, typer.Option(metavar="N", min=1, help="Plan only the first N scenarios.")]
Config = Annotated[Path | None, typer.Option(metavar="CONFIG.yaml", help="Job file that replaces the sweep's job.")]
Overrides = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one key of the job; may be repeated.")
]
Seed = Annotated[int | None, typer.Option(metavar="S", help="Random seed; overrides settings.seed.")]


def claim_device(device: str | None) -> None:
    """Check that this host has the device. For a CPU, also disable JAX's other platforms in this process.

    Otherwise JAX would reserve most of the memory of every GPU.

    Args:
        device: Name of the device, such as cpu or gpu:1, see `device.devices`; None: a GPU if there is one.

    Raises:
        InputError: If this host does not have the device, or none that JAX_PLATFORMS allows.
    """
    import jax  # imported here, as it takes a second

    from htcp_jax.backend import check_platforms
    from htcp_jax.device import devices

    if device == "cpu":
        jax.config.update("jax_platforms", "cpu")
    check_platforms()
    devices.choose(device)


def stdout() -> Console:
    """Return a console that writes to stdout, with unlimited width and without automatic highlighting."""
    return Console(highlight=False, soft_wrap=True)


def print_json(record: Any) -> None:
    """Print `record` to stdout as JSON; NaN and infinities become null."""
    from htcp_jax.system import output_files

    print(output_files.json_text(record))


def print_facts(title: str, facts: Mapping[str, str]) -> None:
    """Print a title, and below it one line per fact with its name and its value."""
    console = stdout()
    width = max(20, *(len(name) + 2 for name in facts))
    console.print(Text(title, style="bold"))
    for name, value in facts.items():
        console.print(Text.assemble((f"{name:<{width}}", "cyan"), value))


class ElapsedColumn(TimeElapsedColumn):
    """Time since a bar began. It goes on after the last step, while the results are written."""

    def render(self, task: Task) -> Text:
        """Return the time as text."""
        return Text(str(timedelta(seconds=int(task.elapsed or 0))), style="progress.elapsed")


class TimeLeftColumn(TimeRemainingColumn):
    """Time left; for a finished bar the time that it took."""

    def render(self, task: Task) -> Text:
        """Return the time as text."""
        return super().render(task).append(" in all" if task.finished else " left")


@contextmanager
def progress_bars(*columns: ProgressColumn, line_s: float | None = None, **how: Any) -> Iterator[Progress]:
    """Show progress bars until the block ends. If stderr is not a terminal, print one of them as a line at intervals.

    Args:
        *columns: Columns of a bar; by default description, counts and elapsed time.
        line_s: Time between lines [s]; by default `heartbeat.LINE_S`.
        **how: Arguments passed on to `rich.progress.Progress`.
    """
    columns = columns or (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), ElapsedColumn())
    columns = *columns[:-1], CompilingColumn(), columns[-1]
    console, ended = Console(stderr=True), threading.Event()
    drawn = Progress(*columns, console=console, transient=True, disable=not console.is_terminal, **how)
    with HEARTBEAT.bar(lambda: bool(drawn.tasks)), drawn as bars:
        if not console.is_terminal:
            every_s = line_s or heartbeat.LINE_S
            threading.Thread(target=_print_lines, args=(bars, ended, every_s), daemon=True).start()
        try:
            yield bars
        finally:
            ended.set()


class CompilingColumn(ProgressColumn):
    """Column with the programs that are being compiled, see `Compilations.text`; empty if there are none."""

    def render(self, task: Task) -> Text:
        """Return the text."""
        return Text(COMPILATIONS.text)


def _print_lines(bars: Progress, ended: threading.Event, line_s: float) -> None:
    while not ended.wait(HEARTBEAT.wait_s(line_s)):
        for task in [each for each in bars.tasks if not each.finished][:1] or bars.tasks[-1:]:
            cells = [f"{column(task)}".strip() for column in bars.columns if not isinstance(column, BarColumn)]
            HEARTBEAT.print(" ".join(filter(None, cells)))
        if not bars.tasks:
            ended.wait(line_s)


@contextmanager
def progress_bar(
    what: str, *, first: str = "", time_left: bool = False, line_s: float | None = None
) -> Iterator[Callable[..., None]]:
    """Show one progress bar. Yield the function that updates it, with the arguments (finished steps, all steps, text).

    The text, empty by default, is displayed after `what`.

    Args:
        what: Name of the steps, in the plural.
        first: Text that is displayed until the function is first called.
        time_left: True also shows the remaining time.
        line_s: See `progress_bars`.
    """
    times = (ElapsedColumn(), TimeLeftColumn(elapsed_when_finished=True)) if time_left else (ElapsedColumn(),)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *times
    with progress_bars(*columns, line_s=line_s) as bars:
        task = bars.add_task(first or what, total=None)
        yield lambda done, count, text="": bars.update(task, description=f"{what}{text}", completed=done, total=count)


@contextmanager
def progress_text(text: str) -> Iterator[Callable[[str], None]]:
    """Show a text and the elapsed time until the block ends. Yield the function that changes the text."""
    with progress_bars(TextColumn("{task.description}"), ElapsedColumn()) as bars:
        task = bars.add_task(text, total=None)
        yield lambda changed: bars.update(task, description=changed)


def width() -> int:
    """Return the width of the terminal in characters, or the value of COLUMNS; 80 if neither is known."""
    return shutil.get_terminal_size((80, 24)).columns


def print_table(console: Console, table: Table) -> None:
    """Print a table with headings and units; numbers are aligned right.

    A table that is wider than the terminal is printed in several parts, each with the first column.
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
    """Return the table as a table of rich. If its last column is text, that column is wrapped."""
    laid_out = rich.table.Table(box=None, pad_edge=False, padding=(0, GAP, 0, 0), header_style="cyan")
    *before, last = range(len(table.columns))
    room = max(LEAST_TEXT, width() - sum(_needed(table, k) + GAP for k in before))
    for k, column in enumerate(table.columns):
        units = ["\n", (column.unit, "dim")] if any(each.unit for each in table.columns) else []
        style, wraps = "dim" if column.quiet else "", before and k == last and not column.format
        laid_out.add_column(
            Text.assemble(column.heading, *units),
            justify="right" if column.format else "left",
            style=style,
            header_style=style,
            no_wrap=not wraps,
            max_width=room if wraps else None,
        )
    for row in table.rows:
        laid_out.add_row(*(Text(column.text(cell)) for column, cell in zip(table.columns, row, strict=True)))
    return laid_out


def _folded(table: Table, most: int) -> Iterator[Table]:
    """Split the columns of a table into tables of at most `most` characters, each with the first column.

    If the last column is text, it is wrapped and counts at most LEAST_TEXT characters. Columns in TIED, reference
    values, and new values of a comparison stay with the column to their left.
    """
    taken, used = [0], _needed(table, 0)
    for group in _groups(table):
        wide = sum(GAP + _needed(table, k) for k in group)
        if taken[1:] and used + wide > most:
            yield table.part(taken)
            taken, used = [0], _needed(table, 0)
        taken, used = taken + group, used + wide
    yield table.part(taken)


def _groups(table: Table) -> list[list[int]]:
    groups: list[list[int]] = []
    for k in range(1, len(table.columns)):
        before, column = table.columns[k - 1 : k + 1]
        tied = column.heading in TIED or column.quiet or before.key == f"was_{column.key}"
        groups[-1:] = [groups[-1] + [k]] if tied and groups else [*groups[-1:], [k]]
    return groups


def _needed(table: Table, k: int) -> int:
    column = table.columns[k]
    text = max((len(column.text(row[k])) for row in table.rows), default=0)
    if k and k == len(table.columns) - 1 and not column.format:
        text = min(text, LEAST_TEXT)
    return max(text, len(column.heading), len(column.unit))
