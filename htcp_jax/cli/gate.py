"""`htcp gate`: regression test of a run against a baseline."""

import os
import sys
import textwrap
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.text import Text

from htcp_jax import report, runs, validation  # modules that import JAX are loaded when they are used
from htcp_jax.cli.output import LEAST_TEXT, Json, print_json, print_table, progress_bar, stdout, width
from htcp_jax.errors import InputError
from htcp_jax.planning import registry
from htcp_jax.spec import TASK_ROWS, obstacle_kind
from htcp_jax.system import output_files

if TYPE_CHECKING:
    from htcp_jax.validation import Baseline
    from htcp_jax.validation import gate as regression

PASSED, REGRESSION = 0, 1
LISTED, INDENT = 20, 12  # on the terminal: maximum number of listed scenarios, and width of the column of names

RunFolder = Annotated[Path, typer.Argument(metavar="RUN", help="Output folder of htcp sweep.")]
File = Annotated[Path, typer.Option(metavar="FILE", help="Baseline file.")]
Update = Annotated[bool, typer.Option("--update", help="Write RUN to FILE as the new baseline, without a comparison.")]
Methods = Annotated[str, typer.Option("--methods", metavar="A,B|all", help="Methods of the baseline to compare.")]
Junit = Annotated[
    Path | None, typer.Option("--junit", metavar="FILE", help="Write JUnit XML, one test case per method and check.")
]
Markdown = Annotated[
    Path | None,
    typer.Option("--markdown", metavar="FILE", help="Append Markdown tables, for example to $GITHUB_STEP_SUMMARY."),
]


def gate(
    run: RunFolder,
    baseline: File,
    update: Update = False,
    methods: Methods = "all",
    junit_file: Junit = None,
    markdown_file: Markdown = None,
    as_json: Json = False,
) -> int:
    """Compare a run with a baseline, and fail if its results are worse.

    Compares what was planned, the number of tracked targets, scenarios that end earlier, the share of reachable targets
    that is tracked, TCP error and clearance as measured by MuJoCo at targets and between them, and cycle times if the
    baseline contains them. Planning time is not compared. Missing results count as failures. On GitHub Actions, each
    failing method is also annotated.

    Exit codes: 0 if the run passes, 1 if not, 2 on bad input.

    \b
    Examples:
      htcp sweep sweeps/seams-part --methods baseline,nspace-sqp
      htcp gate out/seams-part --baseline mine.yaml --update    write the baseline
      htcp gate out/seams-part --baseline mine.yaml            compare a later run
      htcp gate out/seams-part --baseline mine.yaml --junit gate.xml --markdown gate.md    for CI
    """
    files = [file for file in (junit_file, markdown_file) if file]
    if update:
        if files:
            raise InputError(f"--update writes no comparison to {files[0]}; omit --update or that file")
        if methods != "all":
            raise InputError("--update writes all methods of the run; omit --update or --methods")
        planned = runs.open_run(run)
        _refuse_missing(planned.manifest.plugins, planned.methods)
        with progress_bar("plans", time_left=True) as progress:
            written = validation.update_baseline(planned, baseline, progress)
        print_json({"baseline": str(baseline)}) if as_json else _print_update(run, baseline, written)
        return PASSED
    known = validation.read_baseline(baseline)
    if methods != "all":
        known = known.only(tuple(dict.fromkeys(name.strip() for name in methods.split(","))))
    taken = [*map(os.path.realpath, (baseline, *files))]
    if twice := [file for file, place in zip(files, taken[1:], strict=True) if taken.count(place) > 1]:
        raise InputError(f"{twice[-1]} is named twice; --baseline, --junit and --markdown must be different files")
    with ExitStack() as reserved:
        for file in files:
            reserved.enter_context(output_files.writable_file(file))
        verdict = _compare_with(run, known, only_known=methods != "all")
        if junit_file:
            output_files.write_text(junit_file, report.gate.junit(verdict))
        if markdown_file:
            output_files.append_text(markdown_file, report.gate.gate_summary(verdict))
    print_json(_comparison_record(verdict)) if as_json else _print_comparison(verdict)
    if os.environ.get("GITHUB_ACTIONS") == "true":
        for line in report.gate.annotations(verdict):
            print(line, file=sys.stderr if as_json else sys.stdout)
    return PASSED if verdict.passed else REGRESSION


def _print_update(run: Path, file: Path, written: "Baseline") -> None:
    allow, given = written.allowance(elsewhere=True), written.allow.elsewhere
    first = next(iter(written.methods.values()))
    of_all = [
        f"{number:,} of {runs.labels.counted(total, noun)}{f' ({share})' if isinstance(share, str) else ''}"
        for number, total, noun, share in (
            (allow.targets, first.targets, "target", given.targets),
            (allow.scenarios, len(first.scenarios), "scenario", given.scenarios),
        )
    ]
    print(f"{run} is the baseline now: {file}")
    print(
        f"on another device or with other versions, each method may lose {of_all[0]}, and {of_all[1]} may end earlier"
    )


def _compare_with(folder: Path, baseline: "Baseline", only_known: bool) -> "regression.GateVerdict":
    try:
        run = runs.open_run(folder)
        run = run.only(baseline.methods) if only_known else run
    except InputError as error:
        if not (folder / runs.manifest.MANIFEST).exists():
            raise
        return validation.gate.unreadable_run(baseline, str(error))
    _refuse_missing(run.manifest.plugins, baseline.methods)
    with progress_bar("plans", time_left=True) as progress:
        return validation.gate.compare(run, baseline, progress)


def _refuse_missing(plugins: Mapping[str, str], methods: Collection[str]) -> None:
    """Check that the packages of methods and kinds are installed.

    Args:
        plugins: Distribution and version of packages, by noun and name of what they add, as in a manifest.
        methods: Names of the methods to judge; packages of other methods may be missing.

    Raises:
        InputError: If one of them is missing. Its results cannot be planned again here, so they may be old ones.
    """
    registries = {each.noun: each for each in (registry.METHODS, obstacle_kind.OBSTACLES, TASK_ROWS)}
    for added, package in runs.manifest.plugins_for(plugins, methods).items():
        noun, _, name = added.rpartition(" ")
        if noun in registries and name not in registries[noun].names():
            raise InputError(f"the {added} came from the package {package}, which is not installed here: install it")


def _comparison_record(verdict: "regression.GateVerdict") -> dict:
    changed = [one._asdict() | {"target": one.target, "reason": one.reason} for one in verdict.changed]
    changed = [one | {"was": one["was"]._asdict(), "now": one["now"]._asdict()} for one in changed]
    rows = [row._asdict() for row in verdict.rows]
    baseline, *run = (one._asdict() | {"plugins": {**one.plugins}} for one in (verdict.baseline, *verdict.run))
    origins = {"baseline": baseline, "run": run}
    checks = [check._asdict() for check in verdict.checks]
    now = origins | {"allow": verdict.allow.model_dump(), "rows": rows, "checks": checks, "changed": changed}
    return verdict._asdict() | now


def _print_comparison(verdict: "regression.GateVerdict") -> None:
    console = stdout()
    console.print(Text(verdict.sweep, style="bold"))
    for name, origin in report.gate.named_origins(verdict):
        first, *others = textwrap.wrap(str(origin), max(LEAST_TEXT, width() - INDENT))
        console.print(Text.assemble((f"{name:<{INDENT}}", "cyan"), first))
        for line in others:
            console.print(" " * INDENT + line)
    console.print()
    for table in report.gate.verdict_tables(verdict):
        print_table(console, table)
        console.print()
    for row in verdict.rows:
        if row.complete_scenarios:
            console.print(Text.assemble(("complete  ", "cyan"), row.complete_scenarios))
    for changed in verdict.changed[:LISTED]:
        console.print(_describe(changed))
    if (more := len(verdict.changed) - LISTED) > 0:
        console.print(f"and {runs.labels.counted(more, 'scenario')} more that changed")
    if verdict.elsewhere:
        console.print(Text("Device, versions or XLA_FLAGS differ from the baseline's: allow.elsewhere applies.", "dim"))
    for line in verdict.notes:
        console.print(Text.assemble(("differs  ", "yellow"), line))
    for line in verdict.improvements:
        console.print(Text.assemble(("better  ", "green"), line))
    for line in verdict.failures[:LISTED]:
        console.print(Text.assemble(("failed  ", "bold red"), line))
    if (more := len(verdict.failures) - LISTED) > 0:
        console.print(f"and {runs.labels.counted(more, 'failure')} more")
    console.print(Text("passed", "bold green") if verdict.passed else Text("FAILED", "bold red"))


def _describe(changed: "regression.ChangedOutcome") -> Text:
    where, sign, rest = str(changed).partition(": the first")
    return Text.assemble((where, "red" if changed.worse else "green" if changed.better else "dim"), sign + rest)
