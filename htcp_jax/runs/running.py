"""Results of a running sweep, kept in memory, so that its summary need not read them from disk."""

from typing import NamedTuple

import numpy as np

from htcp_jax.motion import Plans
from htcp_jax.runs.manifest import Seconds, Span
from htcp_jax.runs.run_folder import Run


class FinishedShard(NamedTuple):
    """A shard that this process has planned and written to the folder."""

    method: str
    span: Span
    plans: Plans
    margin_m: np.ndarray  # (S,) required clearances of the scenarios


class RunningSummary:
    """Results of a sweep, in memory shard by shard, so that summaries need not read them from the folder.

    Usage: `sweep(..., finished=running.add)`.
    """

    def __init__(self):
        self._shards: dict[tuple[str, Span], FinishedShard] = {}

    def add(self, shard: FinishedShard) -> None:
        """Add a shard. The configurations of its plans are not kept, to save memory."""
        self._shards[shard.method, shard.span] = shard._replace(plans=shard.plans.without_configurations())

    def plans(self, run: Run, method: str) -> Plans:
        """Return all plans of one method.

        If all its shards are in memory, the plans have no configurations. Otherwise they are read from the folder.

        Raises:
            InputError: If a file is damaged.
        """
        if run.manifest.scenarios is not None or (known := self._known(run, method)) is None:
            return run.plans(method)
        seconds = run.manifest.seconds.get(method, Seconds())
        return Plans.concatenate([shard.plans for shard in known])._replace(**seconds.of_plans)

    def margins_m(self, run: Run, *methods: str) -> np.ndarray:
        """Return the distinct required clearances of the scenarios that the methods have planned, sorted [m].

        Raises:
            InputError: If a file is damaged.
        """
        known = [self._known(run, method) for method in methods]
        if None in known:
            return np.unique(run.scenarios(*methods)["margin_m"].to_numpy())
        return np.unique(np.concatenate([shard.margin_m for shards in known for shard in shards]))

    def _known(self, run: Run, method: str) -> list[FinishedShard] | None:
        """Return the shards of one method, in order; None if any of them is not in memory."""
        own = sorted((shard.first, shard.last) for shard in run.manifest.shards if shard.method == method)
        found = [self._shards.get((method, Span(*span))) for span in own]
        return None if None in found or run.missing(method) else found
