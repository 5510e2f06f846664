"""Shards of a sweep: blocks of scenarios, so large that one takes about a minute."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from htcp_jax.device import processes
from htcp_jax.runs.manifest import Span

SHARD_S = 60.0  # aimed planning time of a shard [s]; this much work is lost if a sweep is stopped
GROWTH = 8  # a shard has at most this many times the scenarios of a finished one
MOST_TARGETS = 1_000_000  # maximum number of targets in a shard, which limits the memory for its plans


class Shard(NamedTuple):
    """A unit of work: one method on a block of consecutive scenarios."""

    method: str
    span: Span

    @property
    def count(self) -> int:
        """Number of scenarios."""
        return self.span.last - self.span.first + 1


class ShardSizes:
    """Number of scenarios per shard, by method: `least` at first, then as many as are planned in SHARD_S.

    Args:
        least: Minimum number of scenarios.
        most: Maximum number of scenarios.
    """

    def __init__(self, least: int, most: int):
        self._least, self._most = least, most
        self._sizes: dict[str, int] = {}

    @classmethod
    def on(cls, platform: str, cores: int, targets: int) -> "ShardSizes":
        """Return the sizes for a kind of device. On a GPU they are large from the first shard, as it plans in parallel.

        Args:
            platform: Name of the platform, such as "cpu".
            cores: Number of CPU cores that plan a shard.
            targets: Number of targets per scenario.
        """
        most = max(1, MOST_TARGETS // targets)
        return cls(min(most, processes.EACH_PAYS * cores) if platform == "cpu" else most, most)

    def cut(self, missing: Iterable[Shard]) -> Iterator[Shard]:
        """Yield shards that together have all missing scenarios, each of the size that its method has by then."""
        for method, (first, last) in missing:
            while first <= last:
                end = min(last, first + self._sizes.get(method, self._least) - 1)
                yield Shard(method, Span(first, end))
                first = end + 1

    def note(self, shard: Shard, seconds: float) -> None:
        """Set the size of the method's next shards by the planning time of a finished one [s]."""
        wanted = int(shard.count * min(GROWTH, SHARD_S / max(seconds, 1e-9)))
        self._sizes[shard.method] = min(max(wanted, self._least), self._most)
