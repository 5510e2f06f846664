"""Sampling of mountings: first a Halton sequence over the ranges, then CMA-ES from several of the best so far.

A round depends only on the results of earlier rounds and on the seed: repeated with the same results, it proposes the
same mountings.
"""

from typing import NamedTuple

import cma
import numpy as np
from jaxtyping import Bool, Float
from scipy.stats import qmc

from htcp_jax.motion import selection

EVEN = 0.5  # share of the budget for the Halton sequence
ROUND = 512  # mountings of an even round
FROM, POPULATION = 4, 24  # number of parallel CMA-ES runs, and mountings of each per round
SIGMA, ENDED = 0.08, 0.004  # in shares of the ranges: initial step size, and the one at which a run restarts
APART = 0.1  # smallest difference of distinct mountings in at least one parameter, in shares of its range


class SearchResults(NamedTuple):
    """Results of n mountings."""

    u: Float[np.ndarray, "n d"]  # in the unit cube
    done: Float[np.ndarray, "n"]  # share of the targets
    complete: Bool[np.ndarray, "n"]
    objective: Float[np.ndarray, "n A"]  # larger is better; -inf if the mounting is not complete


def even(dimensions: int, first: int, count: int, seed: int) -> Float[np.ndarray, "n d"]:
    """Mountings of a scrambled Halton sequence, in the unit cube.

    Args:
        dimensions: The number of parameters, d.
        first: The index of the first mounting in the sequence.
        count: The number of mountings, n.
        seed: The seed of the scrambling.
    """
    sequence = qmc.Halton(dimensions, rng=np.random.default_rng(seed))
    if first:
        sequence.fast_forward(first)
    return sequence.random(count)


def score(known: SearchResults, weights: Float[np.ndarray, "A"]) -> Float[np.ndarray, "n"]:
    """Cost that CMA-ES minimises.

    It is below 0 for a complete mounting, the lower the better, else the share of targets without a motion. Objectives
    are scaled to their range so far; an unknown one is taken for the worst.
    """
    reported = np.isfinite(known.objective)
    low, high = (np.where(reported, known.objective, none) for none in (np.inf, -np.inf))
    low, high = low.min(axis=0), high.max(axis=0)
    scaled = np.divide(
        known.objective - low, np.maximum(high - low, 1e-12), where=reported, out=np.zeros_like(known.objective)
    )
    whole = -1e-6 - (scaled * weights).sum(axis=1)
    return np.where(known.complete, whole, 1 - known.done + 1e-6)


def best_apart(u: Float[np.ndarray, "n d"], order: np.ndarray, count: int) -> list[int]:
    """Indices of the first `count` mountings in an order, each at least APART from all before it.

    Args:
        u: Mountings in the unit cube.
        order: Indices of the mountings, best first, (n,).
        count: The number of mountings; fewer are returned if no more are apart.
    """
    return order[selection.first_apart(u[order], count, APART, np.inf)].tolist()


class Evolution:
    """CMA-ES from several starts at a time; a run that has converged restarts elsewhere."""

    def __init__(self, known: SearchResults, objectives: int, seed: int):
        self._rng, self._known, self._begun = np.random.default_rng([seed, 1]), known, []
        self._weights = [_weights(k, objectives) for k in range(FROM)]
        self._runs = [self._begin(weights) for weights in self._weights]

    def ask(self) -> Float[np.ndarray, "n d"]:
        """Propose the mountings of the next round."""
        self._requested = [np.array(run.ask()) for run in self._runs]
        return np.clip(np.concatenate(self._requested)[:, : self._known.u.shape[1]], 0.0, 1.0)

    def tell(self, found: SearchResults) -> None:
        """Update the runs with the results of the proposed mountings."""
        self._known = SearchResults(*map(np.concatenate, zip(self._known, found, strict=True)))
        count = len(found.u)
        for k, (run, requested) in enumerate(zip(self._runs, self._requested, strict=True)):
            own = score(self._known, self._weights[k])[-count:][k * POPULATION : (k + 1) * POPULATION]
            run.tell(list(requested), own.tolist())
            if run.sigma * np.sqrt(np.max(run.D**2)) < ENDED or run.stop():
                self._runs[k] = self._begin(self._weights[k])

    def _begin(self, weights: np.ndarray) -> cma.CMAEvolutionStrategy:
        """Start a run at the best mounting that is apart from all earlier starts, or at random if there is none."""
        order = np.argsort(score(self._known, weights), kind="stable")
        u = np.concatenate([np.array(self._begun).reshape(-1, self._known.u.shape[1]), self._known.u])
        taken = len(self._begun)
        chosen = best_apart(u, np.append(np.arange(taken), taken + order), taken + 1)
        start = u[chosen[-1]] if len(chosen) > taken else self._rng.random(u.shape[1])
        self._begun.append(start)
        return cma.CMAEvolutionStrategy(
            start if len(start) > 1 else np.append(start, 0.5),  # CMA-ES needs two dimensions; the second is unused
            SIGMA,
            {
                "bounds": [0.0, 1.0],
                "popsize": POPULATION,
                "randn": lambda *shape: self._rng.standard_normal(shape),
                "seed": np.nan,
                "verbose": -9,
                "tolfun": 0,
                "tolfunhist": 0,
                "tolx": 0,
                "tolstagnation": 10**9,
                "tolflatfitness": 10**9,
            },
        )


def _weights(k: int, objectives: int) -> np.ndarray:
    """Weights of the objectives in the k-th run; with several objectives each run uses another mixture."""
    if objectives == 1:
        return np.ones(1)
    share = k / (FROM - 1)
    return np.array([1 - share, share])
