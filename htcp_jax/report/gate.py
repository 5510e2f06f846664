"""Verdict of the regression gate for CI, as JUnit XML, Markdown, and annotations for GitHub Actions."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

from htcp_jax.markup import escaped, printable
from htcp_jax.report.document import Block, Heading, Table, markdown
from htcp_jax.runs import columns, labels
from htcp_jax.validation import gate

LISTED = 100  # maximum number of listed scenarios and failures, as a job summary is limited to 1 MiB
TRACKED = "method", "verdict", *columns.before_and_now("tracked")
COUNTS = *TRACKED, columns.total("targets"), "worse", "better"
FIGURES = "share", "tcp_error_max_mm", "clearance_min_mm"
TIMES = "held", "cycle_mean_s"
DIFFERENCES = "method", "figure", "was", "now", "difference"
CHANGED = "method", "scenario", "was", "now", "difference", "target", "reason"


def junit(verdict: gate.GateVerdict) -> str:
    """Return JUnit XML with a test case per method and check; a check without values to compare counts as skipped."""
    checks = verdict.checks
    failed, skipped = sum(bool(check.failures) for check in checks), sum(not check.compared for check in checks)
    counts = {"tests": len(checks), "failures": failed, "errors": 0, "skipped": skipped}
    root = _xml_element(None, "testsuites", name="htcp gate", **counts)
    suite = _xml_element(root, "testsuite", name=verdict.sweep, **counts)
    properties = _xml_element(suite, "properties")
    for name, value in _properties(verdict):
        _xml_element(properties, "property", name=name, value=value)
    for check in checks:
        case = _xml_element(suite, "testcase", classname=f"{verdict.sweep}.{check.method}", name=check.name)
        if check.failures:
            failure = _xml_element(case, "failure", type="regression", message="; ".join(check.failures))
            failure.text = printable("\n".join((*check.failures, *_scenarios(verdict, check))))
        elif not check.compared:
            _xml_element(case, "skipped", message="the baseline or the run has no values to compare")
    ET.indent(root)
    return ET.tostring(root, "utf-8", xml_declaration=True).decode() + "\n"


def gate_summary(verdict: gate.GateVerdict) -> str:
    """Return Markdown for a job summary: counts by method, changed figures and scenarios, failures and improvements."""
    return markdown([*_blocks(verdict)])


def annotations(verdict: gate.GateVerdict) -> list[str]:
    """Return one error command for GitHub Actions per method that fails."""
    lines: dict[str, list[str]] = {}
    for check in verdict.checks:
        lines.setdefault(check.method, []).extend(check.failures)
    return [
        f"::error title={_escaped(f'htcp gate {verdict.sweep}: {method}', ':,')}::{_escaped(chr(10).join(failures))}"
        for method, failures in lines.items()
        if failures
    ]


def _escaped(text: str, more: str = "") -> str:
    """Escape text for a command of GitHub Actions, for example a newline as %0A.

    Args:
        text: The text.
        more: More characters to escape, such as ":," in a property.
    """
    return re.sub(f"[%\r\n{more}]", lambda found: f"%{ord(found[0]):02X}", printable(text))


def _xml_element(parent: ET.Element | None, tag: str, **attributes: str | int) -> ET.Element:
    texts = {name: printable(str(value)) for name, value in attributes.items()}
    return ET.Element(tag, texts) if parent is None else ET.SubElement(parent, tag, texts)


def _properties(verdict: gate.GateVerdict) -> Iterator[tuple[str, str]]:
    for name, origin in named_origins(verdict):
        yield f"{name}.commit", origin.commit or "unknown"
        yield f"{name}.device", str(origin.device)
        for package, version in origin.versions.items():
            yield f"{name}.{package}", version or "unknown"
        yield f"{name}.XLA_FLAGS", origin.xla_flags or "unknown"
        for added, package in origin.plugins.items():
            yield f"{name}.{added}", package


def named_origins(verdict: gate.GateVerdict) -> list[tuple[str, gate.Origin]]:
    """Return name and origin (commit, device, versions) of the baseline and of each part of the run."""
    parts = [f"run part {number}" for number in range(1, len(verdict.run) + 1)]
    return [("baseline", verdict.baseline), *zip(parts if parts[1:] else ["run"], verdict.run, strict=False)]


def _scenarios(verdict: gate.GateVerdict, check: gate.GateCheck) -> list[str]:
    return [str(one) for one in verdict.changed if check.name == gate.ENDS and one.method == check.method and one.worse]


def _blocks(verdict: gate.GateVerdict) -> Iterator[Block]:
    yield Heading(2, f"htcp gate: {escaped(verdict.sweep)} {'passed' if verdict.passed else 'FAILED'}")
    yield "\n".join(f"- {name}: {escaped(str(origin))}" for name, origin in named_origins(verdict))
    if verdict.elsewhere:
        yield "Device, versions or XLA_FLAGS differ from the baseline's, so the limits in `allow.elsewhere` apply."
    counts = [row._asdict() | {"difference": _difference(row.was_tracked, row.tracked)} for row in verdict.rows]
    yield Table.of("counts", (*TRACKED, "difference", *COUNTS[len(TRACKED) :]), counts, "Tracked targets")
    if complete := [row.complete_scenarios for row in verdict.rows if row.complete_scenarios]:
        yield "\n".join(f"- {escaped(line)}" for line in complete)
    if differing := [each for row in verdict.rows for each in _shown_differences(row)]:
        yield Table.of("figures", DIFFERENCES, differing, "Other figures that changed")
    for title, lines in (("Failures", verdict.failures), ("Better", verdict.improvements), ("Differs", verdict.notes)):
        if lines:
            yield f"**{title}**"
            yield "\n".join(f"- {escaped(line)}" for line in lines[:LISTED])
            yield from _and_more(lines)
    if verdict.changed:
        rows = (
            (one.method, one.label, was := one.was.tracked, now := one.now.tracked, now - was, one.target, one.reason)
            for one in verdict.changed[:LISTED]
        )
        title = f"{labels.counted(len(verdict.changed), 'scenario')} that changed, in tracked targets"
        yield Table("changed", columns.of(*CHANGED), tuple(rows), title)
        yield from _and_more(verdict.changed)


def _and_more(listed: tuple) -> Iterator[str]:
    if len(listed) > LISTED:
        yield f"and {len(listed) - LISTED:,} more"


def verdict_tables(verdict: gate.GateVerdict) -> list[Table]:
    """Return the tables of a comparison by method, without empty columns: counts, figures of the validation, times."""
    figures = "method", *columns.before_and_now(*FIGURES), "clearance_less_cover_min_mm"
    rows = [row._asdict() for row in verdict.rows]
    tables = (
        Table.of("gate", keys, rows).without_empty()
        for keys in (COUNTS, figures, ("method", *columns.before_and_now(*TIMES)))
    )
    return [table for table in tables if len(table.columns) > 1]


def _difference(was: Any, now: Any) -> Any:
    return None if was is None or now is None else now - was


def _shown_differences(row: gate.GateRow) -> Iterator[dict[str, str]]:
    """Yield the rows of the table DIFFERENCES: a method's figures whose displayed values differ."""
    for column in columns.of(*FIGURES, *TIMES):
        was, now = getattr(row, f"was_{column.key}"), getattr(row, column.key)
        if (before := column.text(was)) != (after := column.text(now)):
            difference = column._replace(format=f"+{column.format}").text(_difference(was, now))
            texts = {"was": before, "now": after, "difference": difference}
            yield {"method": row.method, "figure": column.title, **texts}
