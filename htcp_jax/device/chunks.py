"""Proofs of joint paths in chunks computed side by side, for devices that compute many lanes in the time of one.

Most proofs need one or two clearance queries, a few need thousands. Without chunks, all slots would wait for these few.
Each slot therefore proves one chunk of a path. When the chunk is done, the slot takes the next path. When no path is
left, it takes over the last part of another slot's chunk: the longest interval that bisection will check and has not
reached. The result of bisection on an interval does not depend on earlier intervals. The combined result is therefore
the same as if each path had been searched from its start to its end. Results after the place where a path is refuted
are dropped.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.proof import bisection
from htcp_jax.device.batching import next_rows
from htcp_jax.types import Bool, Int


class ChunkSlots(NamedTuple):
    """Chunks computed side by side, one per slot, and the state of their proofs."""

    row: Int[jax.Array, "width"]  # row of the path in the tables; the tables' length if the slot is free
    search: bisection.Bisection  # state of the proof; the initial state if the slot is free


class PathResults(NamedTuple):
    """Results for all paths, each combined from the path's chunks."""

    ends: Int[jax.Array, "capacity"]  # start of the first interval that is not proven, in units of 1 / WHOLE
    proof: bisection.Proof


def by_chunks(function: Callable, width: int) -> Callable:
    """Return a compiled function as `batching.refilled` does, for a function whose loop is a bisection.

    The loop must begin with `initial_state()`; its step must be one clearance query, and its result `proven_result`.
    """

    def run(scene, lanes, *tables) -> bisection.Proof:
        capacity = jax.tree.leaves(tables)[0].shape[0]

        @jax.vmap
        def query(row, search: bisection.Bisection) -> bisection.Bisection:
            lane = jax.tree.map(lambda table: table[row], tables)
            return function(scene, *lane).step(search)

        def query_all_slots(progress):
            slots, following, results = progress
            row, new, following = next_rows(slots.row == capacity, following, lanes)
            slots = _share_chunks(slots._replace(row=jnp.where(new, row, slots.row)), capacity)
            search = query(jnp.where(slots.row < capacity, slots.row, 0), slots.search)
            slots, results = _combine(slots, search, results, capacity)
            return slots, following, results

        def is_unfinished(progress) -> jax.Array:
            slots, following, _ = progress
            return (following < lanes) | jnp.any(slots.row < capacity)

        slots = ChunkSlots(jnp.full(width, capacity, jnp.int32), _table_of(bisection.initial_state(), width))
        results = PathResults(jnp.full(capacity, bisection.WHOLE), _table_of(bisection.initial_state().proof, capacity))
        *_, results = jax.lax.while_loop(is_unfinished, query_all_slots, (slots, jnp.zeros((), jnp.int32), results))
        return jax.vmap(bisection.proven_result)(results.proof)

    return jax.jit(run, keep_unused=True)


def _share_chunks(slots: ChunkSlots, capacity: int) -> ChunkSlots:
    """Return the slots after free slots took over the last parts of other slots' chunks, at most one part per chunk."""
    row, search = slots
    rest = search.end - search.place - (1 << (bisection.WHOLE_DEPTH - search.depth))  # beyond the next interval
    free, gives = row == capacity, (row < capacity) & (rest > 0)
    nth_free, nth_giver = (jnp.cumsum(which, dtype=jnp.int32) - 1 for which in (free, gives))
    gives &= nth_giver < jnp.sum(free, dtype=jnp.int32)
    takes = free & (nth_free < jnp.sum(gives, dtype=jnp.int32))
    giver = jnp.nonzero(gives, size=len(row), fill_value=0)[0][jnp.where(takes, nth_free, 0)]
    # The longest part of a divided interval that ends where the chunk ends and is not longer than the rest.
    of_rest = bisection.WHOLE_DEPTH - (63 - jax.lax.clz(jnp.maximum(rest, 1)))
    depth = bisection.longest_part(search.levels, of_rest)
    start = search.end - (bisection.WHOLE >> depth)
    new = bisection.initial_state()._replace(
        index=start[giver] >> (bisection.WHOLE_DEPTH - depth[giver]),
        depth=depth[giver],
        levels=1 << depth[giver],
        end=search.end[giver],
    )
    shortened = search._replace(end=jnp.where(gives, start, search.end))
    search = jax.tree.map(lambda fresh, own: jnp.where(takes, fresh, own), new, shortened)
    return ChunkSlots(jnp.where(takes, row[giver], row), search)


def _combine(
    slots: ChunkSlots, queried: bisection.Bisection, results: PathResults, capacity: int
) -> tuple[ChunkSlots, PathResults]:
    """Return the slots that continue after a clearance query, and the updated results."""
    row, start = slots.row, slots.search.place  # start of the checked interval
    combined, found = results.proof, queried.proof

    def rows(which: Bool[jax.Array, "width"]) -> jax.Array:
        return jnp.where(which, row, capacity)  # writes to row `capacity` are dropped

    fails = (row < capacity) & (found.verdict != bisection.PathVerdict.VALID)
    ends = results.ends.at[rows(fails)].min(start, mode="drop")
    end = ends[jnp.minimum(row, capacity - 1)]
    foremost, goes_on = rows(fails & (start == end)), queried.going & (queried.place < end)
    through = rows(~goes_on)
    combined = bisection.Proof(
        combined.verdict.at[foremost].set(found.verdict, mode="drop"),
        combined.place.at[foremost].set(found.place, mode="drop"),
        combined.clearance.at[through].min(found.clearance, mode="drop"),
        combined.queries.at[through].add(found.queries, mode="drop"),
        combined.depth.at[through].max(found.depth, mode="drop"),
    )
    search = jax.tree.map(lambda fresh, own: jnp.where(goes_on, own, fresh), bisection.initial_state(), queried)
    return ChunkSlots(rows(goes_on), search), PathResults(ends, combined)


def _table_of(one: Any, length: int) -> Any:
    """Return a table of `length` rows, all equal to `one`."""
    return jax.tree.map(lambda value: jnp.full(length, value), one)
