"""Bodies that move about where they are, and how clear they are to stay."""

from typing import NamedTuple

from htcp_jax.types import Array, Float, Scalar


class Sweep(NamedTuple):
    """How K bodies move about where they are, while a joint path goes some way back and forth."""

    p: Float[Array, "K 3"]  # how far the first end of each axis goes along its velocity, either way [m]
    q: Float[Array, "K 3"]  # and the second
    bend: Float[Array, "K"]  # how far from there any point of the axis is, at most [m]
    travel: Float[Array, "K"]  # and from where it was


class Wanted(NamedTuple):
    """How clear bodies are to stay [m]."""

    least: Scalar  # less will not do
    enough: Scalar  # more need not be found out
