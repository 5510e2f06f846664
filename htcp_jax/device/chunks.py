"""Proofs of joint paths in chunks computed side by side, for devices that compute many lanes in the time of one.

Most proofs need one or two clearance queries, a few need thousands, and all would wait for those. So each slot proves
one chunk of a path. When it is done it takes the next path; when no path is left it takes over the far end of another
slot's chunk, the longest interval that bisection has not reached there. Bisection's result on an interval does not
depend on those before it, so the combined result is the same as if each path had been searched from its start to its
end. Results beyond the point where a path is refuted are dropped.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.clearance.proof import bisection
from htcp_jax.device.batching import next_rows
from htcp_jax.types import Bool, Int


class ChunkSlots(NamedTuple):
    """Chunks computed side by side, one per slot, and the state of their proofs; initial states in free slots."""

    row: Int[jax.Array, "width"]  # the path's row in the tables; their length if the slot is free
    far: bisection.Bisection


class PathResults(NamedTuple):
    """Result for every path, combined from its chunks."""

    ends: Int[jax.Array, "capacity"]  # start of the first interval that is refuted or undecided, in units of 1 / WHOLE
    proof: bisection.Proof


def by_chunks(function: Callable, width: int) -> Callable:
    """Return `batching.refilled` for a function whose loop is a bisection.

    Its state is a `Bisection` that has not begun, every step one clearance query, and its result `proven_result`.
    """

    def run(scene, lanes, *tables) -> bisection.Proof:
        capacity = jax.tree.leaves(tables)[0].shape[0]

        @jax.vmap
        def query(row, far: bisection.Bisection) -> bisection.Bisection:
            lane = jax.tree.map(lambda table: table[row], tables)
            return function(scene, *lane).step(far)

        def advance(now):
            slots, following, known = now
            row, new, following = next_rows(slots.row == capacity, following, lanes)
            slots = _shared_out(slots._replace(row=jnp.where(new, row, slots.row)), capacity)
            far = query(jnp.where(slots.row < capacity, slots.row, 0), slots.far)
            slots, known = _put_together(slots, far, known, capacity)
            return slots, following, known

        def more(now) -> jax.Array:
            slots, following, _ = now
            return (following < lanes) | jnp.any(slots.row < capacity)

        slots = ChunkSlots(jnp.full(width, capacity, jnp.int32), _table_of(bisection.initial_state(), width))
        known = PathResults(jnp.full(capacity, bisection.WHOLE), _table_of(bisection.initial_state().proof, capacity))
        *_, known = jax.lax.while_loop(more, advance, (slots, jnp.zeros((), jnp.int32), known))
        return jax.vmap(bisection.proven_result)(known.proof)

    return jax.jit(run, keep_unused=True)


def _shared_out(slots: ChunkSlots, capacity: int) -> ChunkSlots:
    """Return the slots after free ones took over the far ends of others' chunks, one from each."""
    row, far = slots
    rest = far.end - far.place - (1 << (bisection.WHOLE_DEPTH - far.depth))  # beyond the next interval
    free, gives = row == capacity, (row < capacity) & (rest > 0)
    nth_free, nth_giver = (jnp.cumsum(which, dtype=jnp.int32) - 1 for which in (free, gives))
    gives &= nth_giver < jnp.sum(free, dtype=jnp.int32)
    takes = free & (nth_free < jnp.sum(gives, dtype=jnp.int32))
    giver = jnp.nonzero(gives, size=len(row), fill_value=0)[0][jnp.where(takes, nth_free, 0)]
    # The longest interval at the end that bisection comes to: as long as the largest power of two in the rest.
    level = 63 - jax.lax.clz(jnp.maximum(rest, 1))
    start = far.end - (1 << level)
    new = bisection.initial_state()._replace(
        index=start[giver] >> level[giver], depth=bisection.WHOLE_DEPTH - level[giver], end=far.end[giver]
    )
    left = far._replace(end=jnp.where(gives, start, far.end))
    far = jax.tree.map(lambda fresh, own: jnp.where(takes, fresh, own), new, left)
    return ChunkSlots(jnp.where(takes, row[giver], row), far)


def _put_together(
    slots: ChunkSlots, queried: bisection.Bisection, known: PathResults, capacity: int
) -> tuple[ChunkSlots, PathResults]:
    """Return the results after a clearance query, and the slots that continue."""
    row, here = slots.row, slots.far.place  # start of the interval that was examined
    whole, found = known.proof, queried.proof

    def rows(which: Bool[jax.Array, "width"]) -> jax.Array:
        return jnp.where(which, row, capacity)  # writes to that row are dropped

    fails = (row < capacity) & (found.verdict != bisection.PathVerdict.VALID)
    ends = known.ends.at[rows(fails)].min(here, mode="drop")
    end = ends[jnp.minimum(row, capacity - 1)]
    foremost, goes_on = rows(fails & (here == end)), queried.going & (queried.place < end)
    through = rows(~goes_on)
    whole = bisection.Proof(
        whole.verdict.at[foremost].set(found.verdict, mode="drop"),
        whole.place.at[foremost].set(found.place, mode="drop"),
        whole.clearance.at[through].min(found.clearance, mode="drop"),
        whole.queries.at[through].add(found.queries, mode="drop"),
        whole.depth.at[through].max(found.depth, mode="drop"),
    )
    far = jax.tree.map(lambda fresh, own: jnp.where(goes_on, own, fresh), bisection.initial_state(), queried)
    return ChunkSlots(rows(goes_on), far), PathResults(ends, whole)


def _table_of(one: Any, length: int) -> Any:
    """Return a table of so many rows, all equal to `one`."""
    return jax.tree.map(lambda value: jnp.full(length, value), one)
