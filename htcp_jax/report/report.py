"""Report of one or several runs: chapters, common sections, and files.

Every part of a run (see `groups`) has a chapter, all with the same sections. A picture's name is its content, preceded
by the part's name if there are several parts. A CSV file contains one table for all parts.
"""

import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import pyarrow as pa
from PIL.Image import Image

from htcp_jax.errors import InputError, did_you_mean
from htcp_jax.planning import registry
from htcp_jax.report.chapter import DEFAULT, chapter, choice, fits_presets, presets, tables_of
from htcp_jax.report.document import Block, Heading, Picture, Table, html, literal, markdown, png, write_csv
from htcp_jax.report.groups import Part, read_parts
from htcp_jax.report.part_charts import MAP, SUCCESS, charts_of, success_of_parts
from htcp_jax.report.tables import between_runs, configuration_table, with_qp_of
from htcp_jax.report.validation import validated
from htcp_jax.runs import Run, columns, labels, open_run
from htcp_jax.runs import manifest as manifests
from htcp_jax.runs import tables as run_tables
from htcp_jax.spec import PlanConfig
from htcp_jax.system import files

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

BETWEEN = (
    "The same scenarios of a grid, planned in two runs by one method. More: scenarios in which the first run has more "
    "executable targets (sign test), or in which only the first run succeeds (McNemar's exact test)."
)


class Report(NamedTuple):
    """Report of one or several runs, in memory."""

    parts: tuple[Part, ...]
    part_tables: tuple[dict[str, Table], ...]  # tables by name, for each part
    blocks: tuple[Block, ...]
    tables: tuple[Table, ...]  # of all parts, for CSV; the first column is the part

    @property
    def figures(self) -> "dict[str, Figure]":
        """Charts of the report, by the stems of their file names."""
        pictures = [block for block in self.blocks if isinstance(block, Picture)]
        return {each.name: each.figure for each in pictures if not isinstance(each.figure, Image)}

    def frame(self, table: str = "results") -> "pandas.DataFrame":
        """Return one of the report's tables as a pandas frame, with the column names of its CSV file.

        Raises:
            InputError: If the report has no table of that name.
        """
        names = [each.name for each in self.tables]
        if table not in names:
            raise InputError(f"the report has no table {table!r}; valid: {', '.join(names)}")
        return run_tables.table_frame(pa.Table.from_pylist(self.tables[names.index(table)].records()))

    def __repr__(self) -> str:
        parts, tables = (", ".join(each.name for each in group) for group in (self.parts, self.tables))
        return f"Report({parts}; tables: {tables}; figures: {', '.join(self.figures)})"


def make_report(runs: Run | str | Path | Sequence[Run | str | Path]) -> Report:
    """Make a report of runs.

    Args:
        runs: One or several runs, or their folders.

    Raises:
        InputError: If a folder contains no run, or if a file is missing or damaged.
    """
    names, parts = _read(runs)
    made = tuple(tables_of(part) for part in parts)
    between = between_runs(parts)
    blocks: list[Block] = [Heading(1, f"Sweep report: {', '.join(names)}")]
    if len(parts) > 1:
        results = {part.name: tables["results"] for part, tables in zip(parts, made, strict=True)}
        blocks += [*_other_code(parts), "Executable targets in percent of all, by method and run.", overview(results)]
        blocks += [success_of_parts(parts).picture(SUCCESS), *_between_runs(between)]
        for part, tables in zip(parts, made, strict=True):
            blocks += [Heading(2, part.name), *chapter(part, tables, _prefix(part, parts), 3)]
    else:
        blocks += chapter(parts[0], made[0], "", 2)
    blocks += _appendix(parts)
    return Report(
        tuple(parts), made, tuple(blocks), tuple(_concatenated_tables(parts, made)) + (between,) * bool(between.rows)
    )


def chart(
    runs: Run | str | Path | Sequence[Run | str | Path], name: str = SUCCESS, *, over: str | None = None
) -> "Figure":
    """Draw one chart of the report of runs, without the rest of the report.

    Args:
        runs: One or several runs, or their folders.
        name: Name of the chart, as in `Report.figures`: "success" (of several runs: all of them in one chart), "map",
            "survival", "stops", "clearance", "joint-motion" and others.
        over: Parameter over which "map" is drawn, any that the grid varies: the name of its column, its key in the
            sweep file, or the end of this key, such as "rotation_y_rad", "start_rad.5" or "shift_m.x". None: as in the
            report.

    Raises:
        InputError: If the report has no chart, or the grid no parameter, with this name; otherwise see `make_report`.
    """
    _, parts = _read(runs)
    known = {f"{_prefix(part, parts)}{key}": part for part in parts for key in charts_of(part)}
    if len(parts) > 1 and name == SUCCESS:
        return success_of_parts(parts).draw()
    if name not in known:
        valid = [SUCCESS] * (len(parts) > 1) + [*known]
        raise InputError(f"the report has no chart {name!r}; {did_you_mean(name, valid)}valid: {', '.join(valid)}")
    own = name.removeprefix(_prefix(known[name], parts))
    if over is not None and own != MAP:
        raise InputError(f"over is an argument of the chart {MAP!r}, not of {name!r}")
    return charts_of(known[name], over)[own].draw()


def _read(runs: Run | str | Path | Sequence[Run | str | Path]) -> tuple[list[str], list[Part]]:
    """Return the names of runs, and all of their parts."""
    listed = [runs] if isinstance(runs, Run | str | Path) else list(runs)
    opened = [run if isinstance(run, Run) else open_run(run) for run in listed]
    names = _numbered([_run_name(given) for given in listed])
    return names, [part for run, name in zip(opened, names, strict=True) for part in read_parts(run, name)]


def _prefix(part: Part, parts: Sequence[Part]) -> str:
    """Return the prefix of the names of a part's pictures; "" if there is only one part."""
    return f"{slug(part.name)}-" if len(parts) > 1 else ""


def write_report(report: Report, folder: Path) -> None:
    """Write report.md and its pictures, a self-contained report.html, and a CSV file per table."""
    pictures = {block.name: png(block.figure) for block in report.blocks if isinstance(block, Picture)}
    for name, data in pictures.items():
        files.write_atomically(folder, f"{name}.png", data)
    files.write_atomically(folder, "report.md", markdown(list(map(literal, report.blocks))).encode())
    files.write_atomically(folder, "report.html", html(report.blocks, pictures).encode())
    for table in report.tables:
        write_csv(folder / f"{table.name}.csv", table)


def report_record(report: Report) -> dict:
    """Return the report as a mapping for JSON: the runs, and all tables except `scenarios`."""
    return {
        "runs": [
            {
                "run": part.name,
                "configuration": choice(part),
                "validated": validated(part.validation),
                **{name.replace("-", "_"): table.records() for name, table in made.items() if name != "scenarios"},
            }
            for part, made in zip(report.parts, report.part_tables, strict=True)
        ]
    }


def overview(results: Mapping[str, Table]) -> Table:
    """Return the table of executable targets in percent, by method and part.

    Args:
        results: Each part's table "results", by the part's name.
    """
    found = {name: {row["method"]: row for row in table.records()} for name, table in results.items()}
    methods = dict.fromkeys(method for rows in found.values() for method in rows)
    shown = [columns.column("executable_percent")._replace(key=name, heading=name) for name in found]
    rows = [(m, *(rows[m]["executable_percent"] if m in rows else None for rows in found.values())) for m in methods]
    return Table("overview", columns.of("method", *shown), tuple(rows))


def slug(name: str) -> str:
    """Convert a name for use in file names."""
    return re.sub(r"[^A-Za-z0-9.]+", "-", name).strip("-.") or "run"


def _other_code(parts: Sequence[Part]) -> list[str]:
    """Return a sentence for each method or kind of another package whose code differs between two runs."""
    of_runs = {part.run_name: part.run.manifest for part in parts}
    found = []
    for (name, one), (other_name, other) in itertools.combinations(of_runs.items(), 2):
        for added in manifests.other_code(one.code, other.code):
            package, theirs = one.plugins.get(added, "no package"), other.plugins.get(added, "no package")
            versions = f"{package} in both" if package == theirs else f"{package} and {theirs}"
            found.append(f"The code of the {added} differs between {name} and {other_name}: {versions}.")
    return found


def _between_runs(table: Table) -> list[Block]:
    return [table, BETWEEN] if table.rows else []


def _appendix(parts: Sequence[Part]) -> list[Block]:
    ran = {part.run_name: part.run.config for part in parts}
    methods = dict.fromkeys(method for part in parts for method in part.plans)
    known = registry.descriptions()
    rows = ((name, *known[name]) for name in methods if name in known)
    about = Table("methods", columns.of("method", "title", "description"), tuple(rows))
    shipped = _to_compare(parts)
    others = f" and {', '.join(shipped)}" if shipped else ""
    differing = configuration_table(ran, shipped)
    compared = f"Keys of the configuration that differ between the runs{others}.", differing
    return [
        Heading(2, "What was run"),
        *(compared if differing.rows and (shipped or len(ran) > 1) else ()),
        about,
        *(f"{name}: {_provenance(run)}" for name, run in {part.run_name: part.run for part in parts}.items()),
    ]


def _to_compare(parts: Sequence[Part]) -> dict[str, PlanConfig]:
    """Return the shipped configurations to compare with, by name: for the paper's tables all, else the default job."""
    if not any(fits_presets(part) for part in parts):
        return {}
    if any(part.paper_table is not None for part in parts):
        return presets()
    return {DEFAULT: with_qp_of(parts[0].run.config, presets()[DEFAULT])}


def _concatenated_tables(parts: Sequence[Part], made: Sequence[dict[str, Table]]) -> list[Table]:
    """Concatenate the tables of all parts, with the part in the first column."""
    merged = []
    for name in made[0]:
        tables = [each[name] for each in made]
        shown = {column.key: column for table in tables for column in table.columns}
        rows = [{"run": part.name} | row for part, table in zip(parts, tables, strict=True) for row in table.records()]
        if rows:
            merged.append(Table.of(name, ("run", *shown.values()), rows))
    return merged


def _provenance(run: Run) -> str:
    manifest = run.manifest
    facts = [f"configuration {manifest.config_hash[:12]}", manifest.dtype]
    for entry in manifest.planned_by:
        versions = ", ".join(f"{name} {version}" for name, version in (entry.get("versions") or {}).items() if version)
        facts.append(
            f"planned on {entry.get('device', '?')} from commit {str(entry.get('commit'))[:12]} with {versions}"
        )
    facts += [f"{added} from {package}" for added, package in manifest.plugins.items()]
    facts += [axis.text(manifest.seed) for axis in manifest.drawn]
    facts += [f"on {labels.counted(n, 'core')}" for n in sorted({each.cores for each in manifest.shards if each.cores})]
    facts += [f"started {manifest.started}"] if manifest.started else []
    return "; ".join(facts) + "."


def _run_name(run: Run | str | Path) -> str:
    """Return the name of a run: the name of its sweep, or of its folder."""
    return run.manifest.name if isinstance(run, Run) else Path(run).resolve().name


def _numbered(own: Sequence[str]) -> list[str]:
    """Return the names, with a number added to each repeated name."""
    return [name if own.count(name) == 1 else f"{name} ({own[: k + 1].count(name)})" for k, name in enumerate(own)]
