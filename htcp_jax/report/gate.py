"""Verdict of the regression gate for CI, as JUnit XML, Markdown, and annotations for GitHub Actions."""

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from htcp_jax.markup import escaped, printable
from htcp_jax.report.document import Block, Column, Heading, Table, markdown
from htcp_jax.runs import labels
from htcp_jax.validation import gate

LISTED = 100  # maximum number of listed scenarios and failures, as a job summary is limited to 1 MiB
FIGURES = (  # field of a GateRow (the baseline's has the prefix "was_"), name, unit and format
    ("share", "reachable targets tracked", "%", ".2f"),
    ("tcp_error_max_mm", "largest TCP error", "mm", ".3f"),
    ("clearance_min_mm", "minimum clearance", "mm", ".3f"),
    ("held", "scenarios with the feed held", "", ",d"),
    ("cycle_mean_s", "mean cycle time", "s", ".3f"),
)
COUNTS = (
    Column("method", "method"),
    Column("verdict", "verdict"),
    Column("was_tracked", "baseline", "", ",d"),
    Column("tracked", "now", "", ",d"),
    Column("difference", "difference", "", "+,d"),
    Column("targets", "of", "", ",d"),
    Column("worse", "scenarios earlier", "", ",d"),
    Column("better", "scenarios further", "", ",d"),
)
DIFFERENCES = tuple(
    Column(name, name, form=form)
    for name, form in (("method", ""), ("figure", ""), ("baseline", ">"), ("now", ">"), ("difference", ">"))
)
CHANGED = (
    Column("method", "method"),
    Column("scenario", "scenario"),
    Column("was", "baseline", "", ",d"),
    Column("now", "now", "", ",d"),
    Column("difference", "difference", "", "+,d"),
    Column("target", "first at target", "", "d"),
    Column("reason", "reason"),
)


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
        yield "The device or the versions differ from the baseline's, so the limits in `allow.elsewhere` apply."
    counts = tuple(tuple(_count(row, column.key) for column in COUNTS) for row in verdict.rows)
    yield Table("counts", COUNTS, counts, "Tracked targets")
    if differing := tuple(line for row in verdict.rows for line in _shown_differences(row)):
        yield Table("figures", DIFFERENCES, differing, "Other figures that changed")
    for title, lines in (("Failures", verdict.failures), ("Better", verdict.improvements)):
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
        yield Table("changed", CHANGED, tuple(rows), title)
        yield from _and_more(verdict.changed)


def _and_more(listed: tuple) -> Iterator[str]:
    if len(listed) > LISTED:
        yield f"and {len(listed) - LISTED:,} more"


def _count(row: gate.GateRow, key: str) -> str | int | None:
    if key == "difference":
        return None if row.tracked is None else row.tracked - row.was_tracked
    return getattr(row, key)


def _shown_differences(row: gate.GateRow) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield the rows of the table DIFFERENCES: a method's figures whose displayed values differ."""
    for key, name, unit, form in FIGURES:
        column = Column(key, name, unit, form)
        was, now = getattr(row, f"was_{key}"), getattr(row, key)
        if (before := column.text(was)) != (after := column.text(now)):
            difference = column._replace(form=f"+{form}").text(None if None in (was, now) else now - was)
            yield row.method, column.title, before, after, difference
