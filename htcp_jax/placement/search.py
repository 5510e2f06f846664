"""Sampling of mountings: first a Halton sequence over the ranges, then CMA-ES runs from the best mountings so far.

The proposed mountings depend only on the results of earlier rounds and on the seed.
"""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

from htcp_jax.motion import configurations

if TYPE_CHECKING:
    import cma

EVEN = 0.5  # share of the budget for the Halton sequence
ROUND = 512  # mountings per round of the Halton sequence
FROM, POPULATION = 4, 24  # number of parallel CMA-ES runs, and of mountings per run and round
SIGMA, ENDED = 0.08, 0.004  # initial step size, and step size at which a run restarts, relative to the ranges
APART = 0.1  # minimum difference in at least one parameter, relative to its range


class SearchResults(NamedTuple):
    """Results of n mountings."""

    u: Float[np.ndarray, "n d"]  # mountings in the unit cube
    done: Float[np.ndarray, "n"]  # completed share of the targets
    complete: Bool[np.ndarray, "n"]
    objective: Float[np.ndarray, "n A"]  # larger is better; -inf if the mounting is not complete


def even(dimensions: int, first: int, count: int, seed: int) -> Float[np.ndarray, "n d"]:
    """Return n mountings of a scrambled Halton sequence, in the unit cube.

    Args:
        dimensions: The number of parameters, d.
        first: The index of the first mounting in the sequence.
        count: The number of mountings, n.
        seed: The seed of the scrambling.
    """
    sequence = scipy.stats.qmc.Halton(dimensions, rng=np.random.default_rng(seed))
    if first:
        sequence.fast_forward(first)
    return sequence.random(count)


def score(known: SearchResults, weights: Float[np.ndarray, "A"]) -> Float[np.ndarray, "n"]:
    """Return the cost of each mounting, which CMA-ES minimises.

    If the arm completes all paths, the cost is negative: minus the weighted sum of the objectives, each scaled to its
    range so far. An objective that was not computed counts as the worst value. Otherwise the cost is the share of
    targets without a motion.

    Args:
        known: Results of n mountings.
        weights: Weights of the objectives.
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
    """Return the indices of up to `count` mountings in the given order, each at least APART from all chosen before it.

    Args:
        u: Mountings in the unit cube.
        order: Indices of the mountings, best first, (n,).
        count: Maximum number of mountings.
    """
    return order[configurations.first_apart(u[order], 0, count, APART, np.inf)].tolist()


class Evolution:
    """Several parallel CMA-ES runs; a run that has converged restarts from another mounting."""

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

    def _begin(self, weights: np.ndarray) -> "cma.CMAEvolutionStrategy":
        """Return a new run that starts at the best mounting apart from all earlier starts, or at random without one."""
        import cma  # here, as the import is slow

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
    """Return the weights of the objectives in the k-th run; with several objectives they differ from run to run."""
    if objectives == 1:
        return np.ones(1)
    share = k / (FROM - 1)
    return np.array([1 - share, share])
