"""Division of a path's file into seams: by blank lines between rows, or by a column `seam`."""

import re
import warnings
from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError, Note
from htcp_jax.io.parts.headings import Heading

# Columns that divide the rows; a column in which every row has its own value counts rows. Names are compounds of these
# words, with an optional suffix, in lower case and without blanks: seam_id, Seam ID, SeamID, weld line.
DIVIDING = re.compile(
    "(?:seam|segment|path|pass|weld|bead|trajectory|toolpath|stroke|polyline|curve|contour|line|layer|group|part|type|id"
    "|traj|run|track|block|operation|feature|naht|bahn|raupe|lage|schicht|spur|process|arc|laser|welding|motion|active"
    "|processon|arcon|laseron|weldon|toolon|sprayon)+(?:no|nr|number|nummer|index|name)?"
)
SEAM_COLUMN = re.compile("seam(?:no|nr|id|number|name|index)?")  # divides the rows into seams that a job can plan
REMEDY = "divide them by a blank line or a column seam; a job then plans all of them"
MOST_SEAMS = 3  # maximum number of seams in a message
JUMP = 10.0  # a step of so many usual ones is named
SHORTEST_JUMP_M = 0.01


class SeamRows(NamedTuple):
    """Rows of one seam in a path's file."""

    label: str  # its value in the column `seam`, or its number in the file
    first: int  # first row, counted from 0
    count: int  # number of rows


def seam_rows(
    source: str, rows: Sequence[Sequence[str]], blank: Sequence[int], header: Sequence[Heading]
) -> list[SeamRows]:
    """Return the rows of each seam in a file; one seam with all rows if nothing divides them.

    Args:
        source: The file, for messages.
        rows: Cells of each row.
        blank: Number of blank lines in sequence before each row. Blank lines after every row are doubled line ends.
        header: The columns' names; empty if the table has none.

    Raises:
        InputError: If a column that may mean something else than seams divides the rows.
    """
    between = np.array(blank[1:], int)
    starts = [0, *(np.flatnonzero(between > min(between, default=0)) + 1).tolist(), len(rows)]
    labels = [str(k + 1) for k in range(len(starts) - 1)]
    for k, head in enumerate(header):
        name = re.sub(r"[\W_]", "", head.name)
        if not DIVIDING.fullmatch(name):
            continue
        runs = [(value, len(list(run))) for value, run in groupby(_value(row[k]) for row in rows)]
        if SEAM_COLUMN.fullmatch(name):
            starts = np.cumsum([0, *(count for _, count in runs)]).tolist()
            labels = [f"{value:g}" if isinstance(value, float) else value for value, _ in runs]
            if "" in labels:
                row = starts[labels.index("")] + 1
                raise InputError(f"{source}: row {row} has no value in the column {head.text}; each row needs its seam")
        elif 1 < len(runs) < len(rows):
            bounds = np.cumsum([0, *(count for _, count in runs)]).tolist()
            what = f"{_seams(bounds)}, by column {head.text}"
            raise InputError(f"{source}: {what}; if these are seams, rename the column to seam, else to another name")
    return [SeamRows(label, a, b - a) for label, (a, b) in zip(labels, pairwise(starts), strict=True)]


def check_one_seam(source: str, found: Sequence[SeamRows]) -> None:
    """Check that a path's file has one seam.

    Raises:
        InputError: If it has several.
    """
    if len(found) > 1:
        bounds = [*(seam.first for seam in found), found[-1].first + found[-1].count]
        raise InputError(f"{source}: {_seams(bounds)}; here a path is one seam; choose one by rows in the job's seams")


def name_jumps(source: str, xyz: Float[np.ndarray, "P 3"], one_point_m: float, seam: SeamRows) -> None:
    """Name steps of a seam that are JUMP times as long as its usual step, the median, in a Note.

    Args:
        source: The file, for messages.
        xyz: Points of the path [m].
        one_point_m: Shorter steps do not count.
        seam: Rows of the seam.
    """
    steps = np.linalg.norm(np.diff(xyz[seam.first : seam.first + seam.count], axis=0), axis=1)
    moves = steps[steps > one_point_m]
    if len(moves) < 3:
        return
    usual = float(np.median(moves))
    jumps = np.flatnonzero((steps > JUMP * usual) & (steps > SHORTEST_JUMP_M))
    if not len(jumps):
        return
    first = [
        f"from row {row} to {row + 1} by {1e3 * steps[row - 1 - seam.first]:.4g} mm"
        for row in (seam.first + 1 + jumps[:MOST_SEAMS]).tolist()
    ]
    more = f" and {len(jumps) - MOST_SEAMS} more" if len(jumps) > MOST_SEAMS else ""
    text = f"the path jumps {', '.join(first)}{more}; its usual step is {1e3 * usual:.3g} mm"
    warnings.warn(f"{source}: {text}; if these are several seams, {REMEDY}", Note, stacklevel=4)


def _value(cell: str) -> str | float:
    text = cell.strip(" \t\"'")
    try:
        return float(text)
    except ValueError:
        return text


def _seams(bounds: Sequence[int]) -> str:
    """Return the seams' rows as text, from the index of the first row of each seam, and the number of rows."""
    ranges = [f"rows {a + 1} to {b}" if b > a + 1 else f"row {b}" for a, b in pairwise(bounds)]
    more = f" and {len(ranges) - MOST_SEAMS} more" if len(ranges) > MOST_SEAMS else ""
    return f"{len(ranges)} seams ({', '.join(ranges[:MOST_SEAMS])}{more})"
