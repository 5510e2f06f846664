"""Shards of a sweep: blocks of scenarios, so large that one takes about a minute."""

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from htcp_jax.device import lane_function, processes

SHARD_S = 60.0  # aimed planning time of a shard [s]; this much work is lost if a sweep is stopped
GROWTH = 8  # a shard has at most this many times the scenarios of a finished one
MOST_TARGETS = 1_000_000  # maximum number of targets in a shard, which limits the memory for its plans


class Shard(NamedTuple):
    """A unit of work: one method on a block of scenarios."""

    method: str
    rows: Sequence[int]  # indices of the scenarios in the batch


class ShardSizes:
    """Number of scenarios per shard, by method: `least` at first, then as many as are planned in SHARD_S.

    Args:
        least: Minimum number of scenarios.
        most: Maximum number of scenarios.
        least_rest: If fewer scenarios than this would be left, they are added to the shard before them.
    """

    def __init__(self, least: int, most: int, least_rest: int = 1):
        self._least, self._most, self._least_rest = least, most, least_rest
        self._sizes: dict[str, int] = {}

    @classmethod
    def on(cls, platform: str, cores: int, targets: int, gpus: int = 1) -> "ShardSizes":
        """Return the sizes for a kind of device. On GPUs a shard has at least the scenarios that they plan in parallel.

        Args:
            platform: Name of the platform, such as "cpu".
            cores: Number of CPU cores that plan a shard.
            targets: Number of targets per scenario.
            gpus: Number of GPUs that plan a shard.
        """
        most = max(1, MOST_TARGETS // targets)
        if platform == "cpu":
            return cls(min(most, processes.EACH_PAYS * cores), most)
        parallel = min(most, lane_function.STEP.gpu.capacity * gpus)
        return cls(parallel, most, parallel)

    def cut(self, missing: Iterable[Shard]) -> Iterator[Shard]:
        """Yield shards that together have all missing scenarios, each of the size that its method has by then."""
        for method, rows in missing:
            while rows:
                count = self._sizes.get(method, self._least)
                if len(rows) - count < self._least_rest and len(rows) <= self._most:
                    count = len(rows)
                yield Shard(method, rows[:count])
                rows = rows[count:]

    def note(self, shard: Shard, seconds: float) -> None:
        """Set the size of the method's next shards by the planning time of a finished one [s]."""
        wanted = int(len(shard.rows) * min(GROWTH, SHARD_S / max(seconds, 1e-9)))
        self._sizes[shard.method] = min(max(wanted, self._least), self._most)
