"""A file's proof as rows of its segments, groups of unproven segments, text, JSON and files."""

import math
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa

from htcp_jax.errors import mm_text
from htcp_jax.io import arrays
from htcp_jax.proving.file_proof import FileProof
from htcp_jax.proving.motion_limits import LimitUse
from htcp_jax.proving.stated_errors import errors_record, scale_text
from htcp_jax.proving.worst import PAIRS, Contact
from htcp_jax.runs import columns, provenance
from htcp_jax.status import SegmentStatus, UndecidedCause
from htcp_jax.system import files, output_files

PROOF, SEGMENTS, PICTURE = "proof.json", "segments.parquet", "proof.png"
NAME = "segments"  # of the table in `columns.TABLES`
SCHEMA = pa.schema(
    [
        ("segment", pa.int32()),
        ("line_begin", pa.int64()),
        ("line_end", pa.int64()),
        ("kind", pa.string()),
        ("begin_s", pa.float64()),
        ("end_s", pa.float64()),
        ("verdict", pa.string()),
        ("cause", pa.string()),
        ("clearance_m", pa.float64()),
        ("place_share", pa.float64()),
        ("deepest_share", pa.float64()),
        ("body", pa.string()),
        ("other", pa.string()),
        ("depth_m", pa.float64()),
        ("queries", pa.int64()),
    ]
)
REFUTED, UNDECIDED = 1, 4  # exit codes


class UnprovenGroup(NamedTuple):
    """Consecutive segments with the same verdict and cause, none of them proven."""

    first: int
    last: int
    verdict: SegmentStatus
    cause: UndecidedCause
    deepest: int | None  # segment with the deepest contact; None: not measured


def exit_code(found: FileProof) -> int:
    """Return the exit code of `htcp prove`: 0, REFUTED also for a violated limit or a moved axis, or UNDECIDED."""
    if found.verdict == "refuted" or found.violated or found.moved_on_seams:
        return REFUTED
    too_small = found.error_scale is not None and found.error_scale.scale < 1
    return UNDECIDED if found.verdict != "proven" or too_small else 0


def segment_rows(found: FileProof) -> list[dict[str, Any]]:
    """Return one mapping per segment with the columns of `columns.SEGMENTS`; unknown values are None."""
    motion, proof = found.motion, found.proof
    rows = []
    for k in range(len(motion.line) - 1):
        contact = found.contacts.get(k)
        row: dict[str, Any] = dict.fromkeys(SCHEMA.names)
        row |= {"segment": k, "line_begin": int(motion.line[k]), "line_end": int(motion.line[k + 1])}
        row |= {"kind": None if motion.kind is None else motion.kind[k + 1]}
        row |= {"begin_s": found.time_at(k, 0.0), "end_s": found.time_at(k, 1.0)}
        row |= {"verdict": SegmentStatus.NOT_CHECKED.name, "queries": 0}
        if proof is not None:
            row |= {"verdict": SegmentStatus(int(proof.verdict[k])).name, "queries": int(proof.queries[k])}
            row |= {"cause": UndecidedCause(int(proof.cause[k])).name if proof.cause[k] else None}
            row |= {"clearance_m": _finite(proof.clearance_m[k]), "place_share": _finite(proof.place[k])}
        if contact is not None:
            row |= {"deepest_share": contact.place, "body": contact.body, "other": contact.other}
            row |= {"depth_m": -contact.clearance_m}
        rows.append(row)
    return rows


def unproven_groups(found: FileProof) -> list[UnprovenGroup]:
    """Return the refuted and undecided segments in groups, refuted ones first, each by depth."""
    if found.proof is None:
        return []
    results, groups, begin = list(zip(found.proof.verdict.tolist(), found.proof.cause.tolist(), strict=True)), [], 0
    for k in range(1, len(results) + 1):
        if k < len(results) and results[k] == results[begin]:
            continue
        verdict, cause = results[begin]
        if verdict != SegmentStatus.VALID:
            known = [each for each in range(begin, k) if each in found.contacts]
            deepest = min(known, key=lambda each: found.contacts[each].clearance_m, default=None)
            groups.append(UnprovenGroup(begin, k - 1, SegmentStatus(verdict), UndecidedCause(cause), deepest))
        begin = k
    return sorted(groups, key=lambda each: _rank(found, each))


def worst_pairs(found: FileProof, group: UnprovenGroup) -> list[Contact]:
    """Return the deepest contact of each link with each obstacle in a group, the deepest first; at most PAIRS.

    A pair other than the deepest one is included if its clearance is less than required.
    """
    pairs = dict[tuple[int, str], Contact]()
    contacts = [found.contacts[k] for k in range(group.first, group.last + 1) if k in found.contacts]
    every = [each for contact in contacts for each in (contact, *contact.others)]
    for k, each in enumerate(sorted(every, key=lambda each: each.clearance_m)):
        if k == 0 or each.clearance_m <= found.required_m(each.segment):
            pairs.setdefault((each.link, each.other), each)
    return list(pairs.values())[:PAIRS]


def _rank(found: FileProof, group: UnprovenGroup) -> tuple[bool, float]:
    clearance = math.inf if group.deepest is None else found.contacts[group.deepest].clearance_m
    return group.verdict == SegmentStatus.UNDECIDED, clearance


def lines_of(found: FileProof, first: int, last: int | None = None) -> str:
    """Return the place of segments in the file as text, such as "lines 4 to 5".

    Args:
        found: The proof.
        first: The first segment.
        last: The last segment; None: the first one.
    """
    line = found.motion.line
    return f"{found.counted}s {line[first]} to {line[(first if last is None else last) + 1]}"


def headline(found: FileProof) -> str:
    """Return the verdict and its reason as one line: of a refuted motion the first contact."""
    if found.proof is None:
        count = len(found.motion.line)
        return f"not proven: the file has {count} poses; the motion between them is the controller's own"
    if found.verdict == "proven":
        if math.isinf(found.guaranteed_m):
            return "proven: nothing is there to collide with"
        k = decisive_segment(found)
        assert k is not None
        pair = "" if (near := found.contacts.get(k)) is None else f": {near.body} next to {near.other}"
        text = f"proven: guaranteed clearance {mm_text(found.guaranteed_m)}, smallest on {_where(found, k)}{pair}"
        off = found.deviation
        if off is None or off.distance_m <= off.tolerance_m:
            return text
        return f"{text}; but the TCP is {mm_text(off.distance_m)} off the path ({mm_text(off.tolerance_m)} allowed)"
    if (first := found.first) is not None:
        is_hit = found.proof.verdict[first.segment] == SegmentStatus.IN_COLLISION
        what = "first contact" if is_hit else "first below the margin"
        where = _where(found, first.segment, first.place)
        text = f"{found.verdict}: {what} on {where}: {first.body} and {first.other} {first.at}"
        deepest = found.contacts[first.segment]
        if first.segment == decisive_segment(found):
            return text
        if (deepest.body, deepest.other) != (first.body, first.other) or deepest.clearance_m > 0:
            return f"{text}; on these {found.counted}s {_contact_text(found, first.segment)}"
        return f"{text}, {deepest.depth} deep on these {found.counted}s"
    group = unproven_groups(found)[0]
    if group.deepest is None:
        return f"{found.verdict}: {lines_of(found, group.first, group.last)}"
    return f"{found.verdict}: {_deepest_text(found, group.deepest)}"


def second_line(found: FileProof) -> str:
    """Return the deepest contact of a refuted motion as one line; "" for other motions."""
    if found.first is None or (k := decisive_segment(found)) is None:
        return ""
    return f"{'deepest' if found.contacts[k].clearance_m <= 0 else 'nearest'}: {_deepest_text(found, k)}"


def _deepest_text(found: FileProof, segment: int) -> str:
    return f"{_where(found, segment, found.contacts[segment].place)}: {_contact_text(found, segment)}"


def decisive_segment(found: FileProof) -> int | None:
    """Return the segment with the deepest contact or, if all are proven, with the guaranteed clearance.

    It is None if there is nothing to collide with, or if nothing is proven.
    """
    if found.proof is None or math.isinf(found.guaranteed_m):
        return None
    if found.verdict == "proven":
        return int(found.proof.clearance_m.argmin())
    group = unproven_groups(found)[0]
    return group.first if group.deepest is None else group.deepest


def segment_text(found: FileProof, segment: int) -> str:
    """Return the verdict on a segment and its reason as text, such as "proven, at least 2 mm clear"."""
    assert found.proof is not None
    verdict, clearance_m = SegmentStatus(int(found.proof.verdict[segment])), float(found.proof.clearance_m[segment])
    if verdict == SegmentStatus.VALID:
        return "proven" if math.isinf(clearance_m) else f"proven, at least {mm_text(clearance_m)} clear"
    return f"{verdict.words}: {_contact_text(found, segment)}" if segment in found.contacts else verdict.words


def _contact_text(found: FileProof, segment: int) -> str:
    """Return the deepest contact on an unproven segment, and the cause if it is undecided."""
    assert found.proof is not None
    contact, cause = found.contacts[segment], UndecidedCause(int(found.proof.cause[segment])).message
    is_near = found.proof.verdict[segment] == SegmentStatus.BELOW_MARGIN and contact.clearance_m > 0
    less = f", less than the margin of {1e3 * found.required_m(segment):g} mm" if is_near else ""
    return f"{contact.text}{less}{f'; {cause}' if cause else ''}"


def _where(found: FileProof, segment: int, share: float | None = None) -> str:
    """Return a segment, and a place on it, as text."""
    text = lines_of(found, segment)
    begin, end = found.time_at(segment, 0.0), found.time_at(segment, 1.0)
    if share is None:
        return text if begin is None else f"{text} ({begin:.4g} to {end:.4g} s)"
    time_s = found.time_at(segment, share)
    return f"{text}, {100 * share:.0f} % of the way" + ("" if time_s is None else f" ({time_s:.4g} s)")


def counts(found: FileProof) -> dict[str, int]:
    """Return the number of segments by verdict, as in tables."""
    if found.proof is None:
        return {"not proven": len(found.motion.line) - 1}
    codes = [int(each) for each in found.proof.verdict]
    return {status.words: codes.count(status) for status in SegmentStatus if status in codes}


def record_of(found: FileProof) -> dict[str, Any]:
    """Return the proof as values for JSON."""
    motion, proof = found.motion, found.proof
    rows = segment_rows(found)
    least = decisive_segment(found) if found.verdict == "proven" else None
    return {
        "file": str(found.file),
        "verdict": found.verdict,
        "headline": headline(found),
        "exit_code": exit_code(found),
        "checked": dict(found.scene.checked),
        "robot": found.robot,
        "joints": list(found.joints),
        "format": motion.format,
        "interpolation": motion.interpolation,
        "notes": list(motion.notes),
        "configurations": len(motion.line),
        "duration_s": None if motion.time_s is None else float(motion.time_s[-1] - motion.time_s[0]),
        "margin_m": found.margin_m,
        "tracking": [float(each) for each in found.tracking],
        "segments": len(rows),
        "segments_by_verdict": counts(found),
        "clearance_m": _finite(found.guaranteed_m),
        "clearance_segment": least,
        "first_contact": _contact_record(found, found.first),
        "deepest_contact": _contact_record(found, None if found.first is None else _deepest(found)),
        "unproven": [row for row in rows if row["verdict"] != SegmentStatus.VALID.name],
        "limits": [use._asdict() for use in found.limits],
        "limits_violated": bool(found.violated),
        "deviation": _deviation_record(found),
        **({"seams": [each._asdict() for each in found.seams]} if found.seams else {}),
        "errors": found.errors and errors_record(found.errors, found.error_scale),
        "queries": 0 if proof is None else int(proof.queries.sum()),
        "seconds": found.seconds,
    }


def _deepest(found: FileProof) -> Contact | None:
    k = decisive_segment(found)
    return None if k is None else found.contacts.get(k)


def _contact_record(found: FileProof, contact: Contact | None) -> dict[str, Any] | None:
    """Return a contact, and the depth of the deepest one on its segment, as values for JSON."""
    if contact is None:
        return None
    k, line = contact.segment, found.motion.line
    where = {"segment": k, "line_begin": int(line[k]), "line_end": int(line[k + 1])}
    where |= {"place_share": contact.place, "time_s": found.time_at(k, contact.place)}
    bodies = {"body": contact.body, "other": contact.other, "point_m": contact.point.tolist()}
    return where | bodies | {"depth_m": -contact.clearance_m, "segment_depth_m": -found.contacts[k].clearance_m}


def _deviation_record(found: FileProof) -> dict[str, Any] | None:
    if (deviation := found.deviation) is None:
        return None
    record = deviation._asdict() | {"rows": [row._asdict() for row in deviation.rows]}
    indexed = [axis._asdict() for axis in record.pop("indexed")]
    return record | ({"indexed": indexed} if indexed else {})


def errors_text(found: FileProof) -> str:
    """Return the largest scale of the errors that is proven, and where it is decided, as text; "" without errors."""
    if found.errors is None:
        return ""
    text, scale = scale_text(found.errors, found.error_scale), found.error_scale
    return text if scale is None or scale.segment is None else f"{text}, decided on {_where(found, scale.segment)}"


def limit_text(use: LimitUse) -> str:
    """Return a use of a limit as text, such as "42 % of the limit (joint_a3)"."""
    if use.quantity == "position" and use.is_violated:
        return f"{_size(use, use.excess or 0.0)} beyond its limit of {_size(use, use.limit or 0.0)} ({use.joint})"
    if use.quantity == "position":
        return f"kept; nearest to its limit: {use.joint}" if use.share is not None else "no limits"
    if use.share is None:
        return f"at most {_size(use, use.largest)} ({use.joint}); no limit is stated"
    return f"{100 * use.share:.3g} % of the limit of {_size(use, use.limit or 0.0)} ({use.joint})"


def _size(use: LimitUse, value: float) -> str:
    """Return a value of a joint with its unit, in degrees or mm."""
    per = {"position": "", "velocity": "/s", "acceleration": "/s2", "jerk": "/s3"}[use.quantity]
    return f"{1e3 * value:.4g} mm{per}" if use.is_slide else f"{math.degrees(value):.4g} deg{per}"


def write_proof(folder: Path, found: FileProof) -> None:
    """Write proof.json and segments.parquet into a folder.

    Raises:
        InputError: If a file cannot be written.
    """
    record = record_of(found)
    output_files.write_json(folder / PROOF, record)
    rows = pa.Table.from_pylist(segment_rows(found), SCHEMA)
    made = {"file": str(found.file), **provenance.planned_by()}
    files.write_atomically(folder, SEGMENTS, arrays.parquet_bytes(columns.described(rows, NAME, (), made)))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
