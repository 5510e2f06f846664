"""Random draws for sweeps: a sample of a grid's scenarios, and the values of random axes.

A draw is computed from the SHA-256 of its seed, name and index. It is the same on every machine and with every version
of NumPy, and a longer draw begins with the shorter ones.
"""

import hashlib
from collections.abc import Sequence
from itertools import pairwise
from numbers import Integral
from statistics import NormalDist

from htcp_jax.errors import InputError

BITS = 53  # of a draw; a double has as many


def random_share(seed: int, name: str, index: int) -> float:
    """Return a number between 0 and 1, without both, that is drawn uniformly."""
    digest = hashlib.sha256(f"{seed} {name} {index}".encode()).digest()
    return ((int.from_bytes(digest[:8], "big") >> (64 - BITS)) + 0.5) / 2**BITS


def uniform(seed: int, name: str, low: float, high: float, count: int) -> tuple[float, ...]:
    """Return numbers that are drawn uniformly between two bounds.

    Args:
        seed: Seed of the draw.
        name: Name of the draw; draws with different names are independent.
        low: Lower bound.
        high: Upper bound.
        count: Number of draws.
    """
    return tuple(low + (high - low) * random_share(seed, name, k) for k in range(count))


def normal(seed: int, name: str, mean: float, sigma: float, count: int) -> tuple[float, ...]:
    """Return numbers that are drawn from a normal distribution.

    Args:
        seed: Seed of the draw.
        name: Name of the draw; draws with different names are independent.
        mean: Mean.
        sigma: Standard deviation.
        count: Number of draws.
    """
    distribution = NormalDist(mean, sigma)
    return tuple(distribution.inv_cdf(random_share(seed, name, k)) for k in range(count))


def drawn_numbers(seed: int, count: int, full: int) -> tuple[int, ...]:
    """Return the ascending numbers of scenarios that are drawn from a grid, without repetition.

    Args:
        seed: Seed of the draw.
        count: Number of draws.
        full: Number of scenarios in the grid.
    """
    return tuple(sorted(sorted(range(full), key=lambda number: random_share(seed, "scenario", number))[:count]))


def chosen_numbers(
    full: int, seed: int, limit: int | None, scenarios: Sequence[int] | None, sample: int | None
) -> tuple[int, ...] | None:
    """Return the numbers of the scenarios to plan, ascending; None for the first ones up to the limit.

    Args:
        full: Number of scenarios in the grid.
        seed: Seed of the sample.
        limit: Maximum number of scenarios; None: all.
        scenarios: Numbers of the scenarios; None: all.
        sample: Number of scenarios to draw; None: all.

    Raises:
        InputError: If more than one selection is given, or if the grid does not have the scenarios.
    """
    given = {"limit": limit, "scenarios": scenarios, "sample": sample}
    names = [name for name, value in given.items() if value is not None]
    if len(names) > 1:
        raise InputError(f"{' and '.join(names)} are given; valid: one of limit, scenarios, sample")
    if sample is not None:
        if not 1 <= sample <= full:
            raise InputError(f"sample is {sample}; the grid has {full:,} scenarios; valid: 1 to {full}")
        return drawn_numbers(seed, sample, full)
    if scenarios is None:
        return None
    if not len(scenarios):
        raise InputError(f"scenarios is empty; valid: numbers from 0 to {full - 1}")
    for number in scenarios:
        if not isinstance(number, Integral) or not 0 <= number < full:
            raise InputError(f"the grid has no scenario {number!r}; valid: 0 to {full - 1}")
    chosen = tuple(sorted(map(int, scenarios)))
    if twice := [a for a, b in pairwise(chosen) if a == b]:
        raise InputError(f"scenario {twice[0]} is given twice")
    return chosen
