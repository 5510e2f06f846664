"""State and result of the bisection of a joint path, see `motion_proof`.

An interval that is not proven is divided into two, four or eight equal parts, by one, two or three halvings. Intervals
are checked from the start of the path to its end.
"""

import enum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from htcp_jax.types import Array, Bool, Int, Scalar

WHOLE_DEPTH = 52  # places on a path are multiples of 2^-52; the maximum depth is smaller
WHOLE = 1 << WHOLE_DEPTH


class PathVerdict(enum.IntEnum):
    """Result for a joint path; its values are those of `status.SegmentStatus`, which has the descriptions."""

    VALID = 0
    IN_COLLISION = 1  # refuted: a body touches
    OFF_PATH = 2  # refuted: the TCP leaves its tube, or a row of the task is violated
    REVERSES = 3  # refuted: the TCP moves backwards along its line
    UNDECIDED = 4  # neither proven nor refuted
    BELOW_MARGIN = 7  # refuted: a body is nearer than the required clearance


class Proof(NamedTuple):
    """Result of the bisection of a joint path, or of a chunk of a path."""

    verdict: Int[Array, ""]
    place: Scalar  # 0 to 1: the middle of the refuted or undecided interval; 1 if all intervals are proven
    clearance: Scalar  # lower bound on D along the proven part [m], see `kept` in `motion_proof.query_on`
    queries: Int[Array, ""]  # number of checked intervals
    depth: Int[Array, ""]  # number of halvings that led to the shortest interval


class Bisection(NamedTuple):
    """State of the proof for a chunk of a joint path.

    The path's parameter runs from 0 to 1. Its interval [index, index + 1] 2^-depth is checked next; everything before
    is proven. The chunk ends at end / WHOLE. Bit d of `levels` is 1 if an interval of length 2^-d that contains the
    next interval is one of the parts of a divided interval, or the complete chunk. `proof` is the result so far.
    """

    index: Int[Array, "*n"]
    depth: Int[Array, "*n"]
    levels: Int[Array, "*n"]
    end: Int[Array, "*n"]
    proof: Proof

    @property
    def place(self) -> Int[ArrayLike, "*n"]:
        """Start of the next interval, in units of 1/WHOLE."""
        return self.index << (WHOLE_DEPTH - self.depth)

    @property
    def going(self) -> Bool[ArrayLike, "*n"]:
        """True while intervals are left to check."""
        return (self.proof.verdict == PathVerdict.VALID) & (self.place < self.end)


def initial_state() -> Bisection:
    """Return the initial state for a complete path."""
    proof = Proof(np.int32(PathVerdict.VALID), np.float64(1), np.float64(np.inf), np.int32(0), np.int32(0))
    return Bisection(np.int64(0), np.int64(0), np.int64(1), np.int64(WHOLE), proof)


def moved_on(search: Bisection, proven: Bool[Array, ""], halvings: Int[ArrayLike, ""], proof: Proof) -> Bisection:
    """Return the state after an interval was checked: at the part after it, or at the first of its own parts.

    Args:
        search: The state before.
        proven: True if the interval is proven.
        halvings: Number of halvings that divide the interval if it is not proven, at least one.
        proof: The new result.
    """
    index, depth, levels, end, _ = search
    following = index + 1
    up = jnp.minimum(lowest_bit(following), depth)
    part = longest_part(levels, depth - up)
    after = following >> (depth - part), part, levels & ((2 << part) - 1)
    within = index << halvings, depth + halvings, levels | (1 << (depth + halvings))
    return Bisection(*jax.tree.map(partial(jnp.where, proven), after, within), end, proof)


def longest_part(levels: Int[Array, "*n"], depth: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Return the depth of the longest part in `Bisection.levels` that is not longer than an interval of a depth."""
    return lowest_bit(levels & -(1 << depth))


def lowest_bit(number: Int[Array, "*n"]) -> Int[Array, "*n"]:
    """Return the place of the lowest bit that is 1."""
    return jax.lax.population_count((number & -number) - 1)


def proven_result(proof: Proof) -> Proof:
    """Return the proof; if the path is not proven, only verdict and place are kept.

    All other fields then get their initial values, as they would depend on the order of the checks.
    """
    proven = proof.verdict == PathVerdict.VALID
    reported = jax.tree.map(partial(jnp.where, proven), proof, initial_state().proof)
    return reported._replace(verdict=proof.verdict, place=proof.place)
