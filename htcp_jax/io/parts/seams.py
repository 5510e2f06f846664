"""Detection of several seams in one path's file."""

import re
import warnings
from collections.abc import Sequence
from itertools import groupby, pairwise

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
REMEDY = "plan one at a time: write each into its own file, and set home_rad of the next job to the end of the last"
MOST_SEAMS = 3  # maximum number of seams in a message
JUMP = 10.0  # a step of so many usual ones is named
SHORTEST_JUMP_M = 0.01


def check_one_seam(source: str, rows: Sequence[Sequence[str]], blank: Sequence[int], header: Sequence[Heading]) -> None:
    """Check that the rows of a path are one seam.

    Args:
        source: The file, for messages.
        rows: Cells of each row.
        blank: Number of blank lines in sequence before each row. Blank lines after every row are doubled line ends.
        header: The columns' names; empty if the table has none.

    Raises:
        InputError: If a blank line between rows, or a column, divides the rows into several seams.
    """
    between = np.array(blank[1:], int)
    starts = (np.flatnonzero(between > min(between, default=0)) + 1).tolist()
    if len(starts):
        raise InputError(f"{source}: {_seams(starts, len(rows))}, separated by a blank line; {REMEDY}")
    for k, head in enumerate(header):
        if not DIVIDING.fullmatch(re.sub(r"[\W_]", "", head.name)):
            continue
        runs = [len(list(run)) for _, run in groupby(_value(row[k]) for row in rows)]
        if 1 < len(runs) < len(rows):
            starts = np.cumsum(runs)[:-1].tolist()
            remedy = f"{REMEDY}; or rename the column"
            raise InputError(f"{source}: {_seams(starts, len(rows))}, by column {head.text}; {remedy}")


def name_jumps(source: str, xyz: Float[np.ndarray, "P 3"], one_point_m: float) -> None:
    """Name steps of a path that are JUMP times as long as its usual step, the median, in a Note.

    Args:
        source: The file, for messages.
        xyz: Points of the path [m].
        one_point_m: Shorter steps do not count.
    """
    steps = np.linalg.norm(np.diff(xyz, axis=0), axis=1)
    moves = steps[steps > one_point_m]
    if len(moves) < 3:
        return
    usual = float(np.median(moves))
    jumps = np.flatnonzero((steps > JUMP * usual) & (steps > SHORTEST_JUMP_M))
    if not len(jumps):
        return
    first = [f"from row {k + 1} to {k + 2} by {1e3 * steps[k]:.4g} mm" for k in jumps[:MOST_SEAMS]]
    more = f" and {len(jumps) - MOST_SEAMS} more" if len(jumps) > MOST_SEAMS else ""
    text = f"the path jumps {', '.join(first)}{more}; its usual step is {1e3 * usual:.3g} mm"
    warnings.warn(f"{source}: {text}; if these are several seams, {REMEDY}", Note, stacklevel=4)


def _value(cell: str) -> str | float:
    text = cell.strip(" \t\"'")
    try:
        return float(text)
    except ValueError:
        return text


def _seams(starts: Sequence[int], rows: int) -> str:
    """Return the seams' rows as text, from the index of the first row of each seam but the first."""
    bounds = [0, *starts, rows]
    ranges = [f"rows {a + 1} to {b}" if b > a + 1 else f"row {b}" for a, b in pairwise(bounds)]
    more = f" and {len(ranges) - MOST_SEAMS} more" if len(ranges) > MOST_SEAMS else ""
    return f"{len(ranges)} seams ({', '.join(ranges[:MOST_SEAMS])}{more})"
