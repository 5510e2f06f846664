"""`htcp report`: print tables of runs, and write a report of runs or of one plan."""

from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from htcp_jax.cli.feed import Feed
from htcp_jax.cli.output import Json, print_json, print_table, progress_text, stdout
from htcp_jax.errors import InputError
from htcp_jax.report import make_report, part_facts, report_of_plan, report_record, write_report
from htcp_jax.runs import manifest, plan_folder
from htcp_jax.spec import feed as feed_rates
from htcp_jax.system import files, output_files

Runs = Annotated[
    list[Path], typer.Argument(metavar="RUN...", help="Output folders of htcp sweep, or one folder of htcp plan.")
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")]


def report(runs: Runs, out: Out = Path("out/report"), feed: Feed = None, as_json: Json = False) -> int:
    """Summarise runs in tables and charts: targets tracked, scenarios complete, clearance, times, causes of failures.

    Of one plan, the report shows the arm from two sides, clearance, angles and speed along the path, the cycle time by
    phase, what was assumed, what is not checked, and the formats of its program; --feed is an option of a plan.

    Writes report.html (one self-contained file), report.md with pictures, and a CSV file for each table.

    Exit codes: 0, 2 if a folder is neither a run nor a plan, or a file is damaged.

    \b
    Examples:
      htcp sweep sweeps/workpiece --methods baseline,nspace-sqp
      htcp report out/workpiece                       one run
      htcp report out/workpiece --json                print the tables as JSON
      htcp sweep sweeps/workpiece --methods nspace-sqp --config paper
      htcp report out/workpiece out/workpiece-paper   several runs
      htcp plan
      htcp report out/plan --feed 20mm/s --out out/plan-report   one plan
    """
    for folder in runs:
        _check_kind(folder)
    if any(map(_is_plan, runs)):
        return _report_plan(runs, out, feed, as_json)
    if feed is not None:
        raise InputError("--feed is an option of one plan; time a run by htcp program --all --feed")
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


def _check_kind(folder: Path) -> None:
    if folder.is_dir() and not any((folder / name).exists() for name in (plan_folder.SUMMARY, manifest.MANIFEST)):
        raise InputError(f"{folder} contains neither a run ({manifest.MANIFEST}) nor a plan ({plan_folder.SUMMARY})")


def _is_plan(folder: Path) -> bool:
    return (folder / plan_folder.SUMMARY).exists() and not (folder / manifest.MANIFEST).exists()


def _report_plan(folders: list[Path], out: Path, feed: str | None, as_json: bool) -> int:
    if len(folders) > 1:
        plan = next(filter(_is_plan, folders))
        raise InputError(f"{plan} contains a plan; a report of a plan contains nothing else: omit the other folders")
    if feed is not None:
        feed_rates.feed_of(feed)  # check it before files are opened
    from htcp_jax import api  # imported here, as it imports the planner

    plan, made_by = api.open_plan(folders[0]), files.read_json(folders[0] / plan_folder.SUMMARY, folders[0])
    with progress_text("drawing and timing"):
        made = report_of_plan(plan, folders[0], made_by, feed)
        with output_files.written_whole(out) as folder:
            write_report(made, folder)
    if as_json:
        print_json({table.name: table.records() for table in made.tables})
        return 0
    print_table(stdout(), made.tables[0])
    stdout().print(Text.assemble(("report  ", "cyan"), str(out / "report.html")))
    return 0
