"""`htcp report`: finished or unfinished runs as tables on the terminal, and as a report to read and to pass on."""

import json
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.text import Text

from htcp_jax import report_tables
from htcp_jax.document import Column, Table
from htcp_jax.report import make_report, record, write_report
from htcp_jax.report_chapter import facts
from htcp_jax.results import written_whole

Runs = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders that htcp sweep wrote.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")]
Json = Annotated[bool, typer.Option("--json", help="Print the tables as JSON.")]


def report(runs: Runs, out: Out = Path("out/report"), as_json: Json = False) -> int:
    """Tell what runs came to: the paper's tables beside its own figures, what stopped each method, and charts.

    Writes report.html, one file with everything in it, report.md with its pictures, and a CSV file a table:
    results, stops, joint-steps, times, scenarios. Exits with 2 on a folder that is no run and on a damaged file.

    \b
    htcp report out/workpiece                       one run
    htcp report out/robot out/robot-paper           several, beside each other
    htcp report out/workpiece --json                its tables for another program
    """
    made = make_report(runs)
    with written_whole(out) as folder:
        write_report(made, folder)
    if as_json:
        print(json.dumps(record(made), indent=2, allow_nan=False))
        return 0
    console = Console(highlight=False, soft_wrap=True)
    for part in made.parts:
        console.print(Text(part.name, style="bold"))
        for line in facts(part):
            console.print(Text(line, style="dim"))
        print_table(console, report_tables.results(part))
        if part.ceiling is not None:
            print_table(console, report_tables.ceiling(part))
        console.print()
    console.print(Text.assemble(("report  ", "cyan"), str(out / "report.html")))
    return 0


def print_table(console: Console, table: Table) -> None:
    """Heads, units and rows in columns, numbers to the right."""
    heads = [column.head for column in table.columns]
    units = [column.unit for column in table.columns]
    rows = [[c.text(value) for c, value in zip(table.columns, row, strict=True)] for row in table.rows]
    widths = [max(map(len, cells)) for cells in zip(heads, units, *rows, strict=True)]
    for cells, style in ((heads, "cyan"), (units, "dim cyan"), *((row, "") for row in rows)):
        console.print(_line(cells, table.columns, widths, style))


def _line(cells: list[str], columns: tuple[Column, ...], widths: list[int], style: str) -> Text:
    line = Text(style=style)
    for cell, column, width in zip(cells, columns, widths, strict=True):
        padded = cell.rjust(width) if column.form else cell.ljust(width)
        line.append(padded + "  ", style="dim" if column.quiet else "")
    line.rstrip()
    return line
