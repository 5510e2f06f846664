"""Paths in APT sources and CLS files of CAM systems: GOTO, FROM, RAPID, FEDRAT, UNITS.

A contour is a sequence of moves at a feed; RAPID divides contours. It begins where its first move at a feed begins. The
tool axis i, j, k leads from the tip to the handle, so it is the path's normal, which points away from the wall.

Sources: Dassault Systemes, Syntaxes Interpreted by APT Import, and APT Formats (NC Manufacturing help); CGTech,
Supported APT-CLS NC Program Records (Vericut help): continuation by $, comments by $$, FEDRAT and its units.
"""

import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.columns import NEARLY_UNIT
from htcp_jax.io.parts.lengths import PER_METRE
from htcp_jax.io.parts.seams import SeamRows
from htcp_jax.model import arrays
from htcp_jax.system import read_bytes

ENDINGS = ".apt", ".cls", ".aptsource"
G_CODE = ".nc", ".gcode", ".ngc", ".tap", ".mpf", ".cnc", ".eia", ".iso"
NO_G_CODE = (
    "G-code is not read: its rotations are the axes of one machine, not the tool's axis on the part; write the path as "
    "APT or CLS, before the postprocessor"
)
NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[EDed][-+]?\d+)?")
BLOCK = re.compile(r"%\s*|[NO]\d+\b.*|G\d+\b.*|(?:[A-Z][-+]?(?:\d+\.?\d*|\.\d+)\s*){2,}", re.IGNORECASE)  # of G-code
OPERATION = re.compile(r"(?:TOOL\s*PATH\s*/\s*([^,]+).*|.*\bOPERATION\s+NAME\s*:\s*(.+))", re.IGNORECASE)
SYSTEM = re.compile(r"\$\$\s*\*\s*CATIA0", re.IGNORECASE)
TEXTS = {"INSERT", "PPRINT", "PARTNO", "REMARK", "LETTER", "TITLES"}  # records of text
LENGTHS = {"MM": "mm", "INCH": "in", "INCHES": "in", "IN": "in", "CM": "cm"}
PER_MINUTE = {"MMPM": "mm", "IPM": "in", "PERMIN": None}  # units of feeds and their lengths; None: the file's
PER_TURN = {"MMPR", "IPR", "PERREV"}
ENDS = {"FINI", "END", "END-OF-PATH", "STOP", "REWIND"}  # last records of complete files
QUIET = {"FINI", "END", "REWIND", "TOOLPATH", "PAINT", "END-OF-PATH"}  # of `STILL`, those that no Note names
STILL = {  # records without motion
    "SPINDL", "COOLNT", "LOADTL", "LOAD", "TOOLNO", "CUTTER", "MACHIN", "MCHTOL", "INTOL", "OUTTOL", "TOLER", "LINTOL",
    "STOP", "OPSTOP", "END", "FINI", "REWIND", "TOOLPATH", "TLDATA", "PAINT", "END-OF-PATH", "SELECT", "SELCTL", "SET",
    "MODE", "DELAY", "SEQNO", "LEADER", "CLPRNT", "OPSKIP", "AUXFUN", "CLRSRF", "CLEARP", "CLAMP", "DISPLY", "PLABEL",
    "ISN", "VERIFY", "TDATA", "CATPROCESS", "CATPRODUCT", "PROGRM", "TMARK", "AUTOPS", "NOPOST", "GOUGCK", "PLUNGE",
    "DRAFT", "PPTOL", "CHECK", "HEADER", "INSERT",
}  # fmt: skip
IDENTITIES = {  # records that state the points' frame, with the values of the part's own
    "MSYS": [0, 0, 0, 1, 0, 0, 0, 1, 0],
    "CSYS": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0],
}
ALONG = 0.9998  # cosine of the angle within which a move is along the tool's axis
UNREADABLE = {"CYCLE", "CUTCOM", "CIRCLE", "ARC", "MOVARC", "TLON", "CYLNDR", "ARCSLP"}


class AptPath(NamedTuple):
    """Points of a file's contours, one contour after the other."""

    xyz: Float[np.ndarray, "T 3"]  # [m]
    normals: Float[np.ndarray, "T 3"] | None  # tool axis from the tip to the handle, unit; None: the file has none
    seams: list[SeamRows]
    feeds_m_s: list[float | None]  # feed of each seam; None: unknown, or several
    unit: str | None  # unit of the file's coordinates


class _Record(NamedTuple):
    line: int
    word: str
    values: list[str]


class _State:
    """Values that the records before have set."""

    def __init__(self, unit: str | None) -> None:
        self.unit = unit
        self.position: np.ndarray | None = None  # [m]
        self.axis: np.ndarray | None = None
        self.is_rapid = False
        self.feed_m_s: float | None = None
        self.operation = ""


class _Contour(NamedTuple):
    operation: str
    points: list[np.ndarray]  # [m]
    axes: list[np.ndarray | None]
    feeds: list[float | None]  # of the move to each point after the first one [m/s]


def read_apt(path: Path, unit: str | None = None) -> AptPath:
    """Return the contours of a file as seams, in the file's frame.

    A Note names the records that are not used, and frames that are not applied.

    Args:
        path: The file.
        unit: Unit of the coordinates, a key of `lengths.PER_METRE`; None: that of UNITS. A UserWarning reports a
            different UNITS.

    Raises:
        InputError: For G-code, records that move in another way than by GOTO and GODLTA or that are not known, numbers
            that cannot be read, a missing unit, and no contour; with the line.
    """
    text = _text(path)
    reader = _Reader(path, unit)
    for record in _records(path, text, reader):
        reader.take(record)
    return reader.found()


def _text(path: Path) -> str:
    if path.suffix.lower() in G_CODE:
        raise InputError(f"{path}: {NO_G_CODE}")
    try:
        return read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        return read_bytes(path).decode("latin-1")  # comments of old systems


def _records(path: Path, text: str, reader: "_Reader") -> Iterator[_Record]:
    """Yield the records, with continued lines joined, and without comments."""
    held, begin = "", 0
    for number, full in enumerate(text.splitlines(), start=1):
        if (named := OPERATION.fullmatch(full.strip())) is not None:
            reader.state.operation = " ".join((named[1] or named[2]).split())
        if SYSTEM.match(full.strip()):
            reader.frames.append("CATIA0")
        plain = full.partition("$$")[0].strip()
        if not held and BLOCK.fullmatch(plain):
            raise InputError(f"{path}, line {number}: {NO_G_CODE}")
        word = re.split(r"[\s/]", plain.upper(), maxsplit=1)[0]
        if not held and word in TEXTS:
            reader.unused |= {word} & {"INSERT"}
            continue
        before, dollar, _ = plain.partition("$")
        begin = begin if held else number
        held += before.strip()
        if dollar or not held:
            continue
        word, _, values = held.partition("/")
        held = ""
        cells = [cell.strip() for cell in values.split(",")] if values.strip() else []
        yield _Record(begin, "".join(word.upper().split()), cells)
    if held:
        raise InputError(f"{path}, line {begin}: the record is continued by $, but the file ends")


class _Reader:
    """Contours that the records describe."""

    def __init__(self, path: Path, unit: str | None) -> None:
        self.path, self.chosen, self.state = path, unit, _State(unit)
        self.contours: list[_Contour] = []
        self.is_open = False  # True: the next move at a feed continues the last contour
        self.frames: list[str] = []  # stated frames
        self.unused: set[str] = set()
        self.tools: set[str] = set()
        self.units_line = 0  # line of the last UNITS
        self.last = ""  # word of the last record

    def fail(self, record: _Record, message: str) -> None:
        raise InputError(f"{self.path}, line {record.line}: {message}")

    def take(self, record: _Record) -> None:
        """Use one record."""
        word, state, self.last = record.word, self.state, record.word
        if word in ("GOTO", "GODLTA"):
            self._move(record)
        elif word == "FROM":
            self._start(record)
        elif word == "RAPID" and not record.values:
            state.is_rapid = True
        elif word == "GOHOME":
            state.position, self.is_open = None, False
        elif word == "FEDRAT":
            self._feed(record)
        elif word in ("UNITS", "UNIT"):
            self._units(record)
        elif word == "TLAXIS":
            state.axis = self._axis(record, self._numbers(record, record.values, (3,)))
        elif word in IDENTITIES:
            self._frame(record)
        elif word == "MULTAX" and [each.upper() for each in record.values] in ([], ["ON"], ["OFF"]):
            return
        elif word in ("CYCLE", "CUTCOM") and [each.upper() for each in record.values] == ["OFF"]:
            return
        elif word == "ORIGIN" and not any(self._numbers(record, record.values, (3, 9))[:3]):
            return
        elif word == "TRNTYP" and not any(self._numbers(record, record.values[1:], (3,))):
            return
        elif word in UNREADABLE or word.startswith("TLON"):
            self.fail(
                record, f"{word} moves in a way that cannot be read; let the CAM system write arcs as points, by GOTO"
            )
        elif word in STILL or word.startswith("CSI_"):
            self.tools |= {",".join(record.values).upper()} if word in ("LOADTL", "LOAD") else set()
            self.unused |= {word} - QUIET
        else:
            readable = "only GOTO, GODLTA, FROM and RAPID can be read; let the CAM system write points, by GOTO"
            self.fail(record, f"{word[:40]} is not known, it may move; {readable}")

    def _frame(self, record: _Record) -> None:
        """Keep the frame of the points that follow.

        Raises:
            InputError: If the points before are in another one.
        """
        frame = f"{record.word}/{','.join(record.values)}"
        if self.contours and any(other != frame for other in self.frames if other.startswith(record.word)):
            self.fail(record, f"a second {record.word}, whose points are in another frame; write a file for each frame")
        self.frames.append(frame)

    def _numbers(self, record: _Record, cells: list[str], counts: tuple[int, ...]) -> list[float]:
        if len(cells) not in counts:
            valid = " or ".join(map(str, counts))
            hint = "; is the $ missing that continues the line?" if cells and not cells[-1] else ""
            self.fail(record, f"{record.word} has {len(cells)} values; valid: {valid}{hint}")
        for cell in cells:
            if NUMBER.fullmatch(cell) is None:
                self.fail(record, f"{record.word} holds {cell[:40]!r}, which is not a number")
        return [float(cell.upper().replace("D", "E")) for cell in cells]

    def _position(self, record: _Record) -> np.ndarray:
        """Return the point of a record [m], and set its tool axis."""
        if self.state.unit is None:
            self.fail(record, "the unit is unknown: UNITS is missing; set workpiece.path_unit: mm")
        numbers = self._numbers(record, record.values, (3, 6))
        if numbers[3:]:
            self.state.axis = self._axis(record, numbers[3:])
        return np.array(numbers[:3]) / PER_METRE[self.state.unit or "m"]

    def _axis(self, record: _Record, numbers: list[float]) -> np.ndarray:
        axis, length = np.array(numbers), float(np.linalg.norm(numbers))
        if not abs(length - 1) < NEARLY_UNIT:
            self.fail(record, f"the tool axis has the length {length:.4g}; it must be 1")
        return axis / length

    def _start(self, record: _Record) -> None:
        self.state.position, self.is_open, self.state.is_rapid = self._position(record), False, False

    def _move(self, record: _Record) -> None:
        state, before = self.state, self.state.axis
        point, last = self._position(record), state.position
        if record.word == "GODLTA":
            if last is None:
                self.fail(record, "GODLTA without a position before it")
            point = last + point
        state.position = point
        if state.is_rapid:
            state.is_rapid, self.is_open = False, False
            return
        if not self.is_open:
            first = ([last], [before]) if last is not None else ([], [])
            self.contours.append(_Contour(state.operation, *first, []))
            self.is_open = True
        contour = self.contours[-1]
        if contour.points:
            contour.feeds.append(state.feed_m_s)
        contour.points.append(point)
        contour.axes.append(state.axis)

    def _feed(self, record: _Record) -> None:
        words = [each.upper() for each in record.values]
        numbers = [each for each in words if NUMBER.fullmatch(each)]
        units = [each for each in words if each not in numbers]
        if len(numbers) != 1 or len(units) > 1 or not {*units} <= PER_MINUTE.keys() | PER_TURN:
            valid = ", ".join([*PER_MINUTE, *sorted(PER_TURN)])
            self.fail(
                record, f"FEDRAT/{','.join(record.values)[:40]} cannot be read; valid: a number and one of {valid}"
            )
        unit = units[0] if units else "PERMIN"
        length = PER_MINUTE.get(unit) or self.state.unit
        if unit in PER_TURN:
            self.unused.add(f"FEDRAT in {unit}")
        is_known = unit not in PER_TURN and length is not None
        value = float(numbers[0].replace("D", "E"))
        if is_known and not value > 0:
            self.fail(record, f"the feed is {value:g}; it must be above 0")
        self.state.feed_m_s = value / PER_METRE[length] / 60 if is_known and length else None

    def _units(self, record: _Record) -> None:
        name = ",".join(record.values).upper()
        if name not in LENGTHS:
            self.fail(record, f"UNITS/{name[:40]} is not known; valid: {', '.join(LENGTHS)}")
        if self.chosen is None:
            if self.state.unit not in (None, LENGTHS[name]):
                self.fail(record, f"UNITS/{name}, but line {self.units_line} has another unit; write one in each file")
            self.state.unit, self.units_line = LENGTHS[name], record.line
        elif LENGTHS[name] != self.chosen:
            text = f"the unit is {LENGTHS[name]} in UNITS and {self.chosen} in the job; the job's is used"
            warnings.warn(f"{self.path}: {text}", UserWarning, stacklevel=5)

    def found(self) -> AptPath:
        """Return the contours as seams."""
        whole = [each for each in self.contours if len(each.points) > 1]
        if not whole:
            raise InputError(f"{self.path}: no contour: no GOTO at a feed leads away from a position")
        contours = [_without_plunges(each) for each in whole]
        xyz = np.concatenate([each.points for each in contours])
        arrays.check_points(xyz, str(self.path), at_least=1)
        axes = [axis for each in contours for axis in each.axes]
        known = next((axis for axis in axes if axis is not None), None)
        normals = None if known is None else _filled(axes)
        ends = np.cumsum([0, *(len(each.points) for each in contours)]).tolist()
        labels = _labels([each.operation for each in contours])
        seams = [
            SeamRows(label, first, stop - first) for label, first, stop in zip(labels, ends, ends[1:], strict=False)
        ]
        feeds = [each.feeds[0] if len({*each.feeds}) == 1 else None for each in contours]
        self._name_unused(contours)
        if plunges := sum(len(each.points) for each in whole) - len(xyz):
            what = f"moves at a feed along the tool's axis, to or from the ends of contours, are not used: {plunges}"
            warnings.warn(f"{self.path}: {what}; the planner finds its own approach", Note, stacklevel=5)
        return AptPath(xyz, normals, seams, feeds, self.state.unit)

    def _name_unused(self, contours: list[_Contour]) -> None:
        notes = []
        if self.last not in ENDS:
            notes.append("it does not end with FINI or END-OF-PATH; check that the file is complete")
        if self.unused:
            notes.append(f"records that are not used: {', '.join(sorted(self.unused))}")
        if self.frames and any(not _is_identity(frame) for frame in self.frames):
            notes.append("its frame (MSYS, CSYS, CATIA0) is not applied: points are used as written")
        if all(axis is None for each in contours for axis in each.axes):
            notes.append("it has no tool axis (i,j,k): normals are those of the part")
        if len(self.tools) > 1:
            notes.append(f"{len(self.tools)} tools are loaded, but all seams are planned with the job's tool")
        if several := [each for each in contours if len({*each.feeds}) > 1]:
            feeds = ", ".join(
                "unknown" if feed is None else f"{1e3 * feed:.6g}" for feed in dict.fromkeys(several[0].feeds)
            )
            names = ", ".join(each.operation or "without a name" for each in several[:3])
            count = f"{len(several)} contours ({names})" if several[1:] else f"the contour {names}"
            notes.append(f"several feeds along {count}, such as {feeds} mm/s, are not used; set program.feed")
        for note in notes:
            warnings.warn(f"{self.path}: {note}", Note, stacklevel=6)


def _without_plunges(contour: _Contour) -> _Contour:
    """Return a contour without first moves along the tool's axis to the part, and last ones away from it.

    A contour of such moves only is returned as it is.
    """
    steps = np.diff(contour.points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    along = np.sum(steps * _filled(contour.axes)[1:], axis=1)
    first, last = 0, len(steps)
    while first < last and along[first] <= -ALONG * lengths[first]:
        first += 1
    while first < last and along[last - 1] >= ALONG * lengths[last - 1]:
        last -= 1
    if first == last:
        return contour
    return contour._replace(
        points=contour.points[first : last + 1], axes=contour.axes[first : last + 1], feeds=contour.feeds[first:last]
    )


def _filled(axes: list[np.ndarray | None]) -> Float[np.ndarray, "T 3"]:
    """Return the axes, with z, which APT begins with, before the first one that the file states."""
    return np.array([[0.0, 0.0, 1.0] if axis is None else axis for axis in axes])


def _is_identity(frame: str) -> bool:
    word, _, values = frame.partition("/")
    cells = values.split(",")
    return all(map(NUMBER.fullmatch, cells)) and [float(cell) for cell in cells] == IDENTITIES.get(word)


def _labels(operations: list[str]) -> list[str]:
    """Return a name for each contour: its operation's, with a number if it has several contours, or its number."""
    found, counts = [], dict[str, int]()
    for k, name in enumerate(operations):
        counts[name] = counts.get(name, 0) + 1
        found.append(str(k + 1) if not name else f"{name} {counts[name]}" if operations.count(name) > 1 else name)
    return found
