"""What commands print: a table for a person on stdout or, with --json, the same for a program, and nothing else.

Progress and warnings go to stderr; the progress is on a terminal alone. NO_COLOR takes the colours away.
"""

from collections.abc import Mapping
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.text import Text

from htcp_jax.document import Column, Table
from htcp_jax.results import json_text

Device = Annotated[str | None, typer.Option(metavar="cpu|gpu[:N]", help="Where to compute; by default GPUs, if any.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, and nothing else, in place of the table.")]


def stdout() -> Console:
    """Where tables go: as wide as they are, no colours but those asked for."""
    return Console(highlight=False, soft_wrap=True)


def print_json(record: Any) -> None:
    """`record` on stdout; NaN and infinities become null."""
    print(json_text(record))


def print_facts(title: str, facts: Mapping[str, str]) -> None:
    """A line a fact under a title, names and values aligned."""
    console = stdout()
    width = max(20, *(len(name) + 2 for name in facts))
    console.print(Text(title, style="bold"))
    for name, value in facts.items():
        console.print(Text.assemble((f"{name:<{width}}", "cyan"), value))


def print_table(console: Console, table: Table) -> None:
    """Heads, units and rows in columns, numbers to the right."""
    heads = [column.head for column in table.columns]
    units = [column.unit for column in table.columns]
    rows = [[c.text(value) for c, value in zip(table.columns, row, strict=True)] for row in table.rows]
    widths = [max(map(len, cells)) for cells in zip(heads, units, *rows, strict=True)]
    top = [(heads, "cyan"), *([(units, "dim cyan")] if any(units) else [])]
    for cells, style in (*top, *((row, "") for row in rows)):
        console.print(_line(cells, table.columns, widths, style))


def _line(cells: list[str], columns: tuple[Column, ...], widths: list[int], style: str) -> Text:
    line = Text(style=style)
    for cell, column, width in zip(cells, columns, widths, strict=True):
        padded = cell.rjust(width) if column.form else cell.ljust(width)
        line.append(padded + "  ", style="dim" if column.quiet else "")
    line.rstrip()
    return line
