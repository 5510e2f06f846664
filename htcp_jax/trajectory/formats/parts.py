"""Programs of several files: a main file that calls parts in order, for controllers that limit a program's length."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np


class ProgramFile(NamedTuple):
    """One file of a program."""

    suffix: str  # appended to the program's name; empty for the main file
    text: str
    rows: range  # indices of its configurations; empty for a main file that only calls parts


def split(rows: int, most: int) -> list[range]:
    """Return ranges of at most `most` rows, which differ in length by at most one."""
    ends = np.linspace(0, rows, 1 + -(-rows // most)).astype(int).tolist()
    return [range(a, b) for a, b in pairwise(ends)]
