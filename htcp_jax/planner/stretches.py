"""Joint paths that are proven in stretches side by side, for machines that compute many lanes in the time of one.

Most proofs take a look or two, a few take thousands, and all would wait for those. So a call looks at a few intervals
of every stretch. What is not done then gives away its far end, the longest interval that bisection has yet to come to,
as long as there are lanes with nothing to do. What bisection finds of an interval does not depend on those before it:
put together again, all is as if each path had been looked at from its one end to the other. What lies behind a place
where a path is refuted is forgotten.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.clearance.bisection import WHOLE, WHOLE_DEPTH, Bisection, Proof, begun
from htcp_jax.planner.tables import concatenate, gather
from htcp_jax.status import Way
from htcp_jax.types import Int

LOOKS = 8  # at a stretch in a call, after the first, which looks once: most paths need no more


class Stretches(NamedTuple):
    """Stretches of paths, and how far their proofs have come."""

    path: Int[np.ndarray, "n"]
    start: Int[np.ndarray, "n"]  # of WHOLE
    far: Bisection


def whole_paths(count: int) -> Stretches:
    """As many, of which nothing is known."""
    far = jax.tree.map(lambda value: np.full(count, value), begun())
    return Stretches(np.arange(count), np.zeros(count, np.int64), far)


def proven_by_stretches(look: Callable[[Stretches, int], Bisection], count: int, room: int) -> Proof:
    """What there is to find of so many paths. look: at so many intervals of each of some stretches, in the time of
    `room` of them however few they are."""
    going, looks, done = whole_paths(count), 1, []
    refuted = np.full(count, WHOLE)  # where, of WHOLE
    while len(going.path):
        going = going._replace(far=look(going, looks))
        fails = going.far.proof.verdict != Way.PROVEN
        np.minimum.at(refuted, going.path[fails], going.start[fails])
        done.append(gather(going, ~going.far.going))
        going = gather(going, going.far.going & (going.start < refuted[going.path]))
        going, looks = shared_out(going, room), LOOKS
    done = concatenate(done)
    return _together(gather(done, done.start <= refuted[done.path]), count)


def shared_out(going: Stretches, room: int) -> Stretches:
    """The same as up to `room` stretches: each gives away its far end, and again what is its far end then."""
    parts = [going]
    while True:
        far = going.far
        rest = far.end - far.place - (1 << (WHOLE_DEPTH - far.depth))  # behind the interval that is next
        gives = rest > 0
        room -= len(parts[-1].path)
        gives &= np.cumsum(gives) <= room
        if not gives.any():
            return concatenate([going, *parts[1:]])
        # The longest interval at the end that bisection comes to: as long as the largest power of two in the rest.
        level = np.frexp(rest[gives].astype(float))[1].astype(int) - 1
        end, start = far.end[gives], far.end[gives] - (1 << level)
        new = Stretches(going.path[gives], start, whole_paths(len(start)).far)
        parts.append(new._replace(far=new.far._replace(index=start >> level, depth=WHOLE_DEPTH - level, end=end)))
        left = far.end.copy()
        left[gives] = start
        going = going._replace(far=far._replace(end=left))


def _together(done: Stretches, count: int) -> Proof:
    """The proofs of whole paths from those of their stretches, of which the last is refuted or open, if any."""
    path, (verdict, place, clearance, queries, depth) = done.path, done.far.proof
    whole = whole_paths(count).far.proof
    last = verdict != Way.PROVEN
    whole.verdict[path[last]], whole.place[path[last]] = verdict[last], place[last]
    np.minimum.at(whole.clearance, path, clearance)
    np.add.at(whole.queries, path, queries)
    np.maximum.at(whole.depth, path, depth)
    return whole
