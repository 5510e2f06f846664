"""Tables of `prove`, printed as Markdown, and the words and counts of verdicts."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from htcp_jax.proving import MotionProof


class Table(NamedTuple):
    """Rows of text below a title."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __str__(self) -> str:
        lines = [self.title, "", _line(self.head), _line(["---"] * len(self.head)), *map(_line, self.rows)]
        return "\n".join(lines)


def named(proof: MotionProof) -> str:
    """Return the verdict on one motion: "proven", "refuted" or "undecided"."""
    return "proven" if proof.proven else "refuted" if proof.refuted else "undecided"


def counted(proof: MotionProof) -> tuple[int, int, int]:
    """Return the numbers of proven, refuted and undecided motions of a batch."""
    proven, refuted = int(np.sum(proof.proven)), int(np.sum(proof.refuted))
    return proven, refuted, len(proof.verdict) - proven - refuted


def _line(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"
