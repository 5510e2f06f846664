"""What the rows of a task leave beside the legs of a motion, and how much a nudge of the arm takes of it.

`row_proof` bounds, on an interval of a straight joint path, how far what a row looks at may be off the path
before the row is not sure to hold between its two targets: a point by a length, an axis or a frame by the chord of an
angle. That is what is left of the row, one number a row and leg in the row's own unit, the least of the leg's PIECES.
A curve beside the leg holds every row for certain where it takes no more than that:

    a point            takes as much as it moves
    an axis            as its end moves, of length 1
    a frame            the root of the squares of its three axes
    an axis that looks at a place q away, q >= r
                       as its end moves, and m / (r - m) where the point that it looks from moves by m, for
                       |q/|q| - q'/|q'|| <= |q - q'| / sqrt(|q| |q'|)
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof.row_proof import between, heeded, rows_left
from htcp_jax.model.robot import Robot
from htcp_jax.model.task import Task
from htcp_jax.model.task_rows import Feature, Row
from htcp_jax.trajectory.nudge import padded

PIECES = 32  # of a leg


class RowsLeft(NamedTuple):
    """Of R rows, beside m legs or at m knots."""

    rows: tuple[Row, ...]
    left: Float[np.ndarray, "m R"]  # points [m]; axes and frames, as a chord
    apart: Float[np.ndarray, "m R"]  # how far the place that a row looks at is, at least [m]; inf: it looks at none

    @property
    def features(self) -> tuple[Feature, ...]:
        """What the rows look at, one row after another."""
        return tuple(feature for row in self.rows for feature in row.features)

    def only(self, which: Int[np.ndarray, "k"]) -> "RowsLeft":
        """Beside some of the legs."""
        return self._replace(left=self.left[which], apart=self.apart[which])

    def beside(self) -> "RowsLeft":
        """At the knots: the less of the legs before and after each."""
        least = (np.minimum(np.append(v[:1], v, axis=0), np.append(v, v[-1:], axis=0)) for v in (self.left, self.apart))
        return RowsLeft(self.rows, *least)

    def taken(self, moved: Float[np.ndarray, "*S m F"]) -> Float[np.ndarray, "*S m R"]:
        """How much of it a nudge takes at most that moves the features by so much."""
        found, first = [], 0
        for k, row in enumerate(self.rows):
            own = moved[..., first : first + len(row.features)]
            first += len(row.features)
            if _looks(row):
                axis, eye = own[..., 0], own[..., 1]
                room = self.apart[:, k] - eye
                found.append(axis + np.divide(eye, room, out=np.full_like(eye, np.inf), where=room > 0))
            else:
                found.append(np.linalg.norm(own, axis=-1))
        return np.stack(found, axis=-1)


def rows_beside(
    task: Task, robot: Robot, x: Float[np.ndarray, "n N"], goals: Float[np.ndarray, "m 2 G"], on: Bool[np.ndarray, "m"]
) -> RowsLeft | None:
    """What a task leaves beside the m = n - 1 legs between postures, that lead from one goal to another; all there is
    where it does not hold. None of a task that asks for the TCP at a place alone, which its tube has."""
    if not (rows := heeded(task.parts)):
        return None
    left, apart = padded(partial(_left, task), robot, x[:-1], x[1:], goals)
    return RowsLeft(rows, np.where(on[:, None], np.maximum(left, 0.0), np.inf), np.where(on[:, None], apart, np.inf))


@jax.jit
@partial(jax.vmap, in_axes=(None, None, 0, 0, 0))
def _left(task: Task, robot: Robot, a, b, goals):
    asked, half = between(task, goals), jnp.asarray(0.5 / PIECES)
    places = (jnp.arange(PIECES, dtype=float) + 0.5) / PIECES
    found = jax.vmap(lambda place: rows_left(robot, task.parts, asked, a + place * (b - a), b - a, half))(places)
    return jnp.min(found.left, axis=0), jnp.min(found.apart, axis=0)


def _looks(row: Row) -> bool:
    return len(row.features) == 2
