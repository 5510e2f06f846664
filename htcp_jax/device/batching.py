"""Functions of one lane, run over tables with a lane a row: one compiled program serves one lane and a thousand, and a
lane's result does not depend on how many others there are.
"""

from collections.abc import Callable
from functools import partial
from operator import attrgetter
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.types import Bool, Int


class Loop(NamedTuple):
    """What a function of one lane returns in place of its result, so that lanes of any number of steps fill a GPU: the
    result is that of the state after all steps, taken as long as it is going. Which lane it is, is known to all. What
    a step needs that is not in the state is computed in every step."""

    state: Any
    going: Callable[[Any], jax.Array]
    step: Callable[[Any], Any]
    result: Callable[[Any], Any] = lambda state: state


def finished(found: Any) -> Any:
    """The result of one lane."""
    if not isinstance(found, Loop):
        return found
    return found.result(jax.lax.while_loop(found.going, found.step, found.state))


def chunked(function: Callable, width: int) -> Callable:
    """`function(scene, *one lane)` over tables with a leading axis of capacity C: run(scene, lanes, *tables) computes
    as many lanes, `width` of them at a time; what it writes behind them is nobody's. One lane at a time is not batched:
    loops then ask for no lane but their own, and the program is a fifth shorter."""

    @jax.jit  # so that Python traces it once, for the shapes of its results as for the loop
    def one_chunk(scene, tables, start):
        if width == 1:
            lane = jax.tree.map(lambda t: jax.lax.dynamic_index_in_dim(t, start, keepdims=False), tables)
            return jax.tree.map(lambda r: jnp.asarray(r)[None], finished(function(scene, *lane)))
        part = jax.tree.map(lambda t: jax.lax.dynamic_slice_in_dim(t, start, width), tables)
        return jax.vmap(lambda *lane: finished(function(scene, *lane)))(*part)

    def run(scene, lanes, *tables):
        def body(i, results):
            start = i * width
            return jax.tree.map(
                lambda all_, part: jax.lax.dynamic_update_slice_in_dim(all_, part, start, 0),
                results,
                one_chunk(scene, tables, start),
            )

        capacity = jax.tree.leaves(tables)[0].shape[0]
        if width == capacity:
            return one_chunk(scene, tables, 0)
        empty = _empty(jax.eval_shape(one_chunk, scene, tables, lanes), capacity)
        return jax.lax.fori_loop(0, (lanes + width - 1) // width, body, empty)

    return jax.jit(run)


class Slots(NamedTuple):
    """Lanes side by side, each in a slot."""

    row: Int[jax.Array, "width"]  # of the tables; their length where a slot is empty
    lane: Any  # what the tables say of it
    state: Any
    going: Bool[jax.Array, "width"]


def refilled(function: Callable, width: int) -> Callable:
    """The same of a function that returns a `Loop`: lanes that are through leave their slot to others, and nobody waits
    for the longest of a chunk. While lanes are left, an eighth of the slots may be idle before others are let in."""

    def run(scene, lanes, *tables):
        capacity = jax.tree.leaves(tables)[0].shape[0]

        def of(part: Callable) -> Callable:
            return jax.vmap(lambda lane, state: part(function(scene, *lane))(state))

        is_going, step, result = (of(attrgetter(part)) for part in ("going", "step", "result"))
        begin = jax.vmap(lambda lane: jax.tree.map(jnp.asarray, function(scene, *lane).state))

        def let_in(slots: Slots, first) -> tuple[Slots, jax.Array]:
            free = ~slots.going
            row, new, following = next_rows(free, first, lanes)
            lane = jax.tree.map(lambda t: t[jnp.where(new, row, 0)], tables)
            lane, state = _where(new, (lane, begin(lane)), (slots.lane, slots.state))
            row = jnp.where(new, row, jnp.where(free, capacity, slots.row))
            going = is_going(lane, state) & (row < capacity)
            return Slots(row, lane, state, going), following

        def advance(slots: Slots) -> Slots:
            state = _where(slots.going, step(slots.lane, slots.state), slots.state)
            return slots._replace(state=state, going=slots.going & is_going(slots.lane, state))

        def turn(now):
            slots, first, results = now
            slots, first = let_in(slots, first)
            enough = jnp.where(first < lanes, width - max(1, width // 8), 0)
            slots = jax.lax.while_loop(lambda slots: jnp.sum(slots.going) > enough, advance, slots)
            write = partial(jax.tree.map, lambda all_, own: all_.at[slots.row].set(own, mode="drop"))
            return slots, first, write(results, result(slots.lane, slots.state))

        def more(now) -> jax.Array:
            slots, first, _ = now
            return (first < lanes) | jnp.any(slots.going)

        lane = jax.tree.map(lambda t: jnp.broadcast_to(t[0], (width, *t.shape[1:])), tables)
        state = begin(lane)
        slots = Slots(jnp.full(width, capacity, jnp.int32), lane, state, jnp.zeros(width, bool))
        results = _empty(jax.eval_shape(result, lane, state), capacity)
        return jax.lax.while_loop(more, turn, (slots, jnp.zeros((), jnp.int32), results))[2]

    return jax.jit(run)


def next_rows(
    free: Bool[jax.Array, "width"], first: jax.Array, lanes: jax.Array
) -> tuple[Int[jax.Array, "width"], Bool[jax.Array, "width"], jax.Array]:
    """Return the row that each free slot takes, from `first` on, which slots take one, and the first row left over."""
    row = first + jnp.cumsum(free, dtype=jnp.int32) - 1
    new = free & (row < lanes)
    return row, new, first + jnp.sum(new, dtype=jnp.int32)


def _empty(few: Any, capacity: int) -> Any:
    """Tables of as many rows, each row like those of some."""
    return jax.tree.map(lambda table: jnp.zeros((capacity, *table.shape[1:]), table.dtype), few)


def _where(rows: Bool[jax.Array, "width"], yes: Any, no: Any) -> Any:
    """By rows, of any tree of tables."""

    def chosen(a, b):
        return jnp.where(rows.reshape(rows.shape + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(chosen, yes, no)
