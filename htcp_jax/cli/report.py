"""`htcp report`: print tables of finished or unfinished runs, and write a report."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax.cli.output import Json, print_json, print_table, stdout
from htcp_jax.report import make_report, part_facts, report_record, write_report
from htcp_jax.system import output_files

Runs = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Output folders of htcp sweep.")]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")]


def report(runs: Runs, out: Out = Path("out/report"), as_json: Json = False) -> int:
    """Summarise runs in tables and charts: success, clearance, times, reasons for failures, and the paper's results.

    Writes report.html (one self-contained file), report.md with pictures, and a CSV file for each table.

    Exit codes: 0, 2 if a folder is not a run or a file is damaged.

    \b
    Examples:
      htcp sweep sweeps/workpiece --methods baseline,nspace-sqp
      htcp report out/workpiece                       one run
      htcp report out/workpiece --json                print the tables as JSON
      htcp sweep sweeps/workpiece --methods nspace-sqp --config paper
      htcp report out/workpiece out/workpiece-paper   several runs
    """
    made = make_report(runs)
    with output_files.written_whole(out) as folder:
        write_report(made, folder)
    if as_json:
        print_json(report_record(made))
        return 0
    console = stdout()
    for part, tables in zip(made.parts, made.part_tables, strict=True):
        console.print(Text(part.name, style="bold"))
        for line in part_facts(part):
            console.print(Text(line, style="dim"))
        print_table(console, tables["results"])
        for name in ("paper", "reachability", "reach", "timing"):
            if tables[name].rows:
                console.print()
                print_table(console, tables[name])
        console.print()
    console.print(Text.assemble(("report  ", "cyan"), str(out / "report.html")))
    return 0
