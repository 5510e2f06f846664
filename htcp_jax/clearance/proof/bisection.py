"""How far the bisection of a joint path has come, see `motion_proof`; and what it found."""

import enum
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike

from htcp_jax.types import Array, Bool, Int, Scalar

WHOLE_DEPTH = 52  # places on a path are numbers of its 2^-52; nothing may be halved as often
WHOLE = 1 << WHOLE_DEPTH


class Verdict(enum.IntEnum):
    """What is known of a joint path; the numbers of `status.Way`, where they have words."""

    PROVEN = 0
    COLLIDES = 1  # refuted: a body touches
    LEAVES = 2  # refuted: the TCP leaves its tube, or a row of the task is broken
    TURNS_BACK = 3  # refuted: the TCP moves against its line
    OPEN = 4  # neither proven nor refuted


class Proof(NamedTuple):
    """What bisection found on a joint path, or on a stretch of one."""

    verdict: Int[Array, ""]
    place: Scalar  # 0 to 1: the middle of the interval that is refuted or open; 1 where all are proven
    clearance: Scalar  # D all along what is proven, at least [m]
    queries: Int[Array, ""]  # places looked at
    depth: Int[Array, ""]  # halvings of the shortest interval


class Bisection(NamedTuple):
    """How far the proof of a stretch of a joint path has come: up to interval number `index` of those of length
    2^-depth, which is next. It ends at `end`, of WHOLE."""

    index: Int[Array, "*n"]
    depth: Int[Array, "*n"]
    end: Int[Array, "*n"]
    proof: Proof

    @property
    def place(self) -> Int[ArrayLike, "*n"]:
        """Where the next interval begins, of WHOLE."""
        return self.index << (WHOLE_DEPTH - self.depth)

    @property
    def going(self) -> Bool[ArrayLike, "*n"]:
        """Whether there is more to look at."""
        return (self.proof.verdict == Verdict.PROVEN) & (self.place < self.end)


def begun() -> Bisection:
    """Of a whole path of which nothing is known."""
    proof = Proof(np.int32(Verdict.PROVEN), np.float64(1), np.float64(np.inf), np.int32(0), np.int32(0))
    return Bisection(np.int64(0), np.int64(0), np.int64(WHOLE), proof)


def of_proven(proof: Proof) -> Proof:
    """The same; of a path that is not proven its verdict and place alone, and nothing known of the rest, which depends
    on the order of looks."""
    proven = proof.verdict == Verdict.PROVEN
    told = jax.tree.map(partial(jnp.where, proven), proof, begun().proof)
    return told._replace(verdict=proof.verdict, place=proof.place)
