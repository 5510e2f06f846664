"""Air moves: proven joint paths between the ends of seams, and from and to home.

A joint path that is proven in one direction is one in the other, too, so each pair of configurations is joined once.
If two configurations are not joined directly, the arm may pass through home.
"""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.device import tables
from htcp_jax.motion import CollisionChecker, Problem, joint_search

FIRST_PAIR = 1_000_000  # number of the first pair, which seeds its random numbers; those from home are smaller


class AirMove(NamedTuple):
    """A proven joint path between two configurations."""

    via_points: Float[np.ndarray, "_ N"]  # [rad or m]
    time_s: float  # at the joints' full speed


class AirMoves:
    """Air moves between configurations, which are joined when they are asked for.

    Attributes:
        configurations: The configurations [rad or m], one row each; the last row is home if there is one.
        speed: Full speeds of the joints [rad/s or m/s].
    """

    def __init__(
        self,
        problem: Problem,
        configurations: Float[np.ndarray, "n N"],
        home: Float[np.ndarray, "N"] | None,
        speed: Float[np.ndarray, "N"],
    ):
        self._problem, self.speed = problem, speed
        self.home = None if home is None else len(configurations)
        self.configurations = configurations if home is None else np.concatenate([configurations, home[None]])
        self._known: dict[tuple[int, int], AirMove | None] = {}

    def least_time_s(self, a: np.ndarray, b: np.ndarray) -> Float[np.ndarray, "*n"]:
        """Return a lower bound on the time between configurations, given by their rows: that of the straight path."""
        return (np.abs(self.configurations[a] - self.configurations[b]) / self.speed).max(axis=-1)

    def find(self, pairs: Iterable[tuple[int, int]], report: Callable[[int], None] = lambda joined: None) -> None:
        """Join pairs of configurations, given by their rows; those that are known already are not joined again.

        Args:
            pairs: The pairs.
            report: Function that is called again and again, on any thread, with the number of pairs newly joined.
        """
        new = self._join({_sorted(pair) for pair in pairs}, report)
        if self.home is not None:
            legs = {_sorted((end, self.home)) for pair in new if self._known[pair] is None for end in pair}
            self._join(legs, report)

    def between(self, a: int, b: int) -> AirMove | None:
        """Return the air move from one configuration to another, through home if necessary; None if none is known."""
        direct = self._known.get(_sorted((a, b)))
        if direct is not None or self.home in (None, a, b):
            return direct and (direct if a < b else direct._replace(via_points=direct.via_points[::-1]))
        to, back = self.between(a, self.home), self.between(self.home, b)
        if to is None or back is None:
            return None
        home = self.configurations[self.home][None]
        return AirMove(np.concatenate([to.via_points, home, back.via_points]), to.time_s + back.time_s)

    @property
    def known(self) -> list[tuple[int, int]]:
        """Pairs that have been joined, or for which the attempt has failed, by row."""
        return list(self._known)

    def is_known(self, a: int, b: int) -> bool:
        """Return True if the pair has been joined, or the attempt has failed."""
        return _sorted((a, b)) in self._known

    def _join(self, pairs: set[tuple[int, int]], report: Callable[[int], None]) -> list[tuple[int, int]]:
        """Join those pairs that are not known, and return them."""
        new = sorted(pair for pair in pairs if pair not in self._known)
        if not new:
            return new
        a, b = np.array(new).T
        number = FIRST_PAIR + a * len(self.configurations) + b
        scenarios = tables.gather(self._problem.scenarios, np.zeros(len(new), int))  # one each, which counts the pairs

        def join(checker: CollisionChecker, share: slice) -> list[np.ndarray | None]:
            rows, ends = np.arange(len(new))[share], (self.configurations[a[share]], self.configurations[b[share]])
            settings = self._problem.settings
            return joint_search.join(checker, scenarios, rows, number[share], *ends, settings, report=report)

        threads = min(self._problem.threads, len(new))
        parts = self._problem.in_threads(join, threads)
        found = [parts[k % threads][k // threads] for k in range(len(new))]
        for pair, via_points in zip(new, found, strict=True):
            self._known[pair] = None if via_points is None else AirMove(via_points, self._time_s(pair, via_points))
        return new

    def _time_s(self, pair: tuple[int, int], via_points: np.ndarray) -> float:
        a, b = self.configurations[list(pair)]
        steps = np.diff(np.concatenate([a[None], via_points, b[None]]), axis=0)
        return float((np.abs(steps) / self.speed).max(axis=1).sum())


def _sorted(pair: tuple[int, int]) -> tuple[int, int]:
    return (pair[0], pair[1]) if pair[0] < pair[1] else (pair[1], pair[0])
