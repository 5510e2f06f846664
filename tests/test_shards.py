"""Sizes of a sweep's shards."""

from itertools import pairwise

import pytest

from htcp_jax.runs.shards import MOST_TARGETS, SHARD_S, Shard, ShardSizes


def planned(sizes: ShardSizes, missing: list[Shard], scenario_s: float) -> list[Shard]:
    """The shards, if every scenario takes `scenario_s` seconds."""
    found = []
    for shard in sizes.cut(missing):
        found.append(shard)
        sizes.note(shard, scenario_s * len(shard.rows))
    return found


@pytest.mark.parametrize("scenario_s", [1e-4, 0.1, 0.5, 3.0])
def test_shards_grow_until_one_takes_a_minute(scenario_s):
    sizes = ShardSizes.on("cpu", 2, 105)
    shards = planned(sizes, [Shard("beam", range(3000))], scenario_s)
    counts = [len(shard.rows) for shard in shards]
    assert counts[0] == 16 and sum(counts) == 3000
    assert all(later <= 8 * count for count, later in pairwise(counts))
    assert max(counts[1:]) * scenario_s <= SHARD_S
    assert len(counts) < 8 or min(counts[3:-1]) * scenario_s > 0.9 * SHARD_S


def test_every_missing_scenario_is_in_one_shard_and_each_method_has_its_own_size():
    missing = [Shard("beam", range(3, 6)), Shard("beam", range(40, 100)), Shard("baseline", range(100))]
    shards = planned(ShardSizes(4, 1000), missing, 1.0)
    for method in ("beam", "baseline"):
        numbers = [k for name, rows in shards if name == method for k in rows]
        assert numbers == [k for name, rows in missing if name == method for k in rows]
    assert [len(shard.rows) for shard in shards] == [3, 24, 36, 4, 32, 60, 4]


def test_on_gpus_a_shard_fills_them_and_no_smaller_one_is_left():
    """Quick scenarios: as many as a shard may have; slow ones: 4096 per GPU, and the rest belongs to the last shard."""
    for scenario_s, count, expected in (
        (8e-3, 6125, [6125]),
        (8e-3, 14_000, [4096, 9904]),
        (1.0, 14_000, [4096, 9904 - 4096, 4096]),
        (1.0, 5000, [5000]),
    ):
        shards = planned(ShardSizes.on("gpu", 16, 50), [Shard("beam", range(count))], scenario_s)
        assert sorted(len(shard.rows) for shard in shards) == sorted(expected), scenario_s
    twice = ShardSizes.on("gpu", 16, 10, gpus=2)
    assert [len(shard.rows) for shard in planned(twice, [Shard("beam", range(24576))], 1.0)] == [8192] * 3
    few = ShardSizes.on("gpu", 16, 2 * MOST_TARGETS)
    assert [len(shard.rows) for shard in few.cut([Shard("beam", range(2))])] == [1, 1]
