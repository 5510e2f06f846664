"""Execution of functions of one lane over tables with one lane per row.

One executable computes any number of lanes, and a lane's result does not depend on the other lanes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.types import Bool, Int


class Remembering(NamedTuple):
    """Steps of loops that are run one after the other, and that use what earlier steps have found.

    The memory may only save time: a lane's result must not depend on it.
    """

    memory: Any  # before the first step of the first lane
    step: Callable[[Any, Any], tuple[Any, Any]]  # state, memory -> next state, memory


class Loop(NamedTuple):
    """Loop that a function of one lane returns in place of its result, so that loops of different lengths fill a GPU.

    The lane's result is `result(state)` once `going(state)` is false. All functions are closures over the lane's
    arguments. Values that a step needs and the state does not contain are recomputed in every step.
    """

    state: Any  # the initial state
    going: Callable[[Any], jax.Array]  # state -> True while the loop continues
    step: Callable[[Any], Any]  # state -> next state
    result: Callable[[Any], Any] = lambda state: state  # last state -> the lane's result
    remembering: Remembering | None = None  # in place of `step`, where lanes are computed one after the other


def finished(found: Any, memory: Any = None) -> tuple[Any, Any]:
    """Return the result of one lane, and the memory after it; if `found` is a `Loop`, run the loop.

    Without a memory, the loop takes the steps that need none.
    """
    if not isinstance(found, Loop):
        return found, memory
    if memory is None:
        return found.result(jax.lax.while_loop(found.going, found.step, found.state)), None
    step, start = found.remembering.step, (found.state, memory)
    state, memory = jax.lax.while_loop(lambda now: found.going(now[0]), lambda now: step(*now), start)
    return found.result(state), memory


def chunked(function: Callable, width: int, remembers: bool = False) -> jax.stages.Wrapped:
    """Return a compiled function that applies `function` to the rows of tables, `width` at a time.

    The compiled function is run(scene, lanes, *tables). Tables have C rows, of which the first `lanes` are computed;
    rows of the results from `lanes` on are undefined. With width 1 the function is not batched: a loop then runs only
    as long as its lane needs, and the executable is a fifth shorter. Lanes then follow each other, and a `Loop` may
    pass on a memory.

    Args:
        function: Function of (scene, *one lane).
        width: Number of lanes computed side by side.
        remembers: True if the function returns a `Loop` that passes on a memory.
    """

    @jax.jit  # traced only once, for the shapes of the results and for the loop
    def one_chunk(scene, tables, start, memory):
        if width == 1:
            result, memory = finished(function(scene, *_lane(tables, start)), memory)
            return jax.tree.map(lambda r: jnp.asarray(r)[None], result), memory
        part = jax.tree.map(lambda t: jax.lax.dynamic_slice_in_dim(t, start, width), tables)
        return jax.vmap(lambda *lane: finished(function(scene, *lane))[0])(*part), memory

    def run(scene, lanes, *tables):
        def body(i, now):
            start, (results, memory) = i * width, now
            part, memory = one_chunk(scene, tables, start, memory)
            update = lambda all_, part: jax.lax.dynamic_update_slice_in_dim(all_, part, start, 0)  # noqa: E731
            return jax.tree.map(update, results, part), memory

        capacity = jax.tree.leaves(tables)[0].shape[0]
        if width == capacity:
            return one_chunk(scene, tables, 0, None)[0]
        memory = function(scene, *_lane(tables, 0)).remembering.memory if remembers and width == 1 else None
        empty = _empty(jax.eval_shape(one_chunk, scene, tables, lanes, memory)[0], capacity)
        return jax.lax.fori_loop(0, (lanes + width - 1) // width, body, (empty, memory))[0]

    return jax.jit(run, keep_unused=True)  # its text then has all arguments, see `kept_executables`


class Slots(NamedTuple):
    """Lanes computed side by side, one per slot."""

    row: Int[jax.Array, "width"]  # row of the lane in the tables; the tables' length if the slot is empty
    lane: Any  # the lane's arguments, from the tables
    state: Any  # state of the lane's loop
    going: Bool[jax.Array, "width"]  # True while the lane's loop continues


@dataclass(frozen=True, eq=False)
class SlotLoops:
    """Loops of lanes in slots: a function that returns a `Loop`, and the tables of its arguments."""

    function: Callable  # of (scene, *one lane)
    scene: Any
    lanes: jax.Array  # number of lanes, a scalar
    tables: tuple
    width: int  # number of slots

    @property
    def capacity(self) -> int:
        """Number of rows of the tables."""
        return jax.tree.leaves(self.tables)[0].shape[0]

    def empty_slots(self) -> Slots:
        """Return slots without lanes; their contents are those of the first lane."""
        lane = jax.tree.map(lambda t: jnp.broadcast_to(t[0], (self.width, *t.shape[1:])), self.tables)
        state = self.begin(lane)
        return Slots(jnp.full(self.width, self.capacity, jnp.int32), lane, state, jnp.zeros(self.width, bool))

    def begin(self, lane: Any) -> Any:
        """Return the initial states."""
        return jax.vmap(lambda lane: jax.tree.map(jnp.asarray, self.function(self.scene, *lane).state))(lane)

    def call(self, part: str, lane: Any, state: Any) -> Any:
        """Call a function of all loops: going, step or result."""
        return jax.vmap(lambda lane, state: getattr(self.function(self.scene, *lane), part)(state))(lane, state)

    def refill(self, slots: Slots, first: jax.Array) -> tuple[Slots, jax.Array]:
        """Return the slots with the next lanes in free slots, and the first row that is left."""
        free = ~slots.going
        row, new, following = next_rows(free, first, self.lanes)
        lane = jax.tree.map(lambda t: t[jnp.where(new, row, 0)], self.tables)
        lane, state = _where(new, (lane, self.begin(lane)), (slots.lane, slots.state))
        row = jnp.where(new, row, jnp.where(free, self.capacity, slots.row))
        going = self.call("going", lane, state) & (row < self.capacity)
        return Slots(row, lane, state, going), following

    def advance(self, slots: Slots) -> Slots:
        """Return the slots after one step of every loop that continues."""
        state = _where(slots.going, self.call("step", slots.lane, slots.state), slots.state)
        return slots._replace(state=state, going=slots.going & self.call("going", slots.lane, state))

    def refill_and_advance(self, now: tuple[Slots, jax.Array, Any]) -> tuple[Slots, jax.Array, Any]:
        """Refill the slots, advance until enough of them are free, and write their results."""
        slots, first, results = now
        slots, first = self.refill(slots, first)
        enough = jnp.where(first < self.lanes, self.width - max(1, self.width // 8), 0)
        slots = jax.lax.while_loop(lambda slots: jnp.sum(slots.going) > enough, self.advance, slots)
        write = partial(jax.tree.map, lambda all_, own: all_.at[slots.row].set(own, mode="drop"))
        return slots, first, write(results, self.call("result", slots.lane, slots.state))

    def is_unfinished(self, now: tuple[Slots, jax.Array, Any]) -> jax.Array:
        """Return True while a lane is left or a loop continues."""
        slots, first, _ = now
        return (first < self.lanes) | jnp.any(slots.going)


def refilled(function: Callable, width: int) -> jax.stages.Wrapped:
    """Return a compiled function as `chunked` does, for a function that returns a `Loop`.

    When a lane's loop ends, the lane's slot takes the next lane, so that no lane waits for the longest one in its
    chunk. While lanes are left, up to an eighth of the slots may be idle before they are refilled.
    """

    def run(scene, lanes, *tables):
        loops = SlotLoops(function, scene, lanes, tables, width)
        slots = loops.empty_slots()
        results = _empty(jax.eval_shape(partial(loops.call, "result"), slots.lane, slots.state), loops.capacity)
        start = slots, jnp.zeros((), jnp.int32), results
        return jax.lax.while_loop(loops.is_unfinished, loops.refill_and_advance, start)[2]

    return jax.jit(run, keep_unused=True)  # its text then has all arguments, see `kept_executables`


def next_rows(
    free: Bool[jax.Array, "width"], first: jax.Array, lanes: jax.Array
) -> tuple[Int[jax.Array, "width"], Bool[jax.Array, "width"], jax.Array]:
    """Return the row for each free slot, True for the slots that get a row, and the first row that is left.

    Args:
        free: True for free slots.
        first: First row to assign, a scalar.
        lanes: Number of rows, a scalar.
    """
    row = first + jnp.cumsum(free, dtype=jnp.int32) - 1
    new = free & (row < lanes)
    return row, new, first + jnp.sum(new, dtype=jnp.int32)


def _lane(tables: tuple, row: Any) -> tuple:
    """Return a row of tables."""
    return jax.tree.map(lambda table: jax.lax.dynamic_index_in_dim(table, row, keepdims=False), tables)


def _empty(few: Any, capacity: int) -> Any:
    """Return tables of zeros with `capacity` rows of the same shape and type as those of `few`."""
    return jax.tree.map(lambda table: jnp.zeros((capacity, *table.shape[1:]), table.dtype), few)


def _where(rows: Bool[jax.Array, "width"], yes: Any, no: Any) -> Any:
    """Return trees of tables with each row from `yes` where `rows` is True, else from `no`."""

    def chosen(a, b):
        return jnp.where(rows.reshape(rows.shape + (1,) * (a.ndim - 1)), a, b)

    return jax.tree.map(chosen, yes, no)
