"""Slack of a task's rows at the legs of a motion, and the slack that a displacement of the arm uses.

`row_proof` computes, for an interval of a straight joint path, how far a row's features may deviate from the path
without violating the row: a point by a length, an axis or a frame by the chord of an angle. This number is the row's
slack. For a leg it is the minimum over its PIECES intervals. A curve next to the leg satisfies every row if it uses no
more than the slack:

    a point            uses its displacement
    an axis            the displacement of its end, at length 1
    a frame            the norm of its three axes' displacements
    an axis that points at a place q away, q >= r
                       the displacement of its end, and m / (r - m) if its origin moves by m, for
                       |q/|q| - q'/|q'|| <= |q - q'| / sqrt(|q| |q'|)
"""

from collections.abc import Sequence
from functools import partial
from itertools import chain
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance.proof import row_proof
from htcp_jax.model import Feature, Robot, Row, Task
from htcp_jax.trajectory.displacement import in_padded_sizes

PIECES = 32  # number of intervals per leg


class RowSlacks(NamedTuple):
    """Slack of R rows of a task, at m legs or m via points."""

    rows: tuple[Row, ...]
    left: Float[np.ndarray, "m R"]  # slack: of points [m], of axes and frames as a chord
    apart: Float[np.ndarray, "m R"]  # lower bound r on the distance of an axis's place [m]; inf: no place

    @property
    def features(self) -> tuple[Feature, ...]:
        """Features of all rows, concatenated."""
        return tuple(feature for row in self.rows for feature in row.features)

    @staticmethod
    def together(parts: "Sequence[RowSlacks]") -> "RowSlacks | None":
        """Return the slack of the rows of several tasks at the same legs; None for no rows."""
        if len(parts) < 2:
            return parts[0] if parts else None
        rows, left, apart = zip(*parts, strict=True)
        return RowSlacks(tuple(chain(*rows)), np.concatenate(left, axis=1), np.concatenate(apart, axis=1))

    def only(self, which: Int[np.ndarray, "k"]) -> "RowSlacks":
        """Return the slack of the legs in `which`."""
        return self._replace(left=self.left[which], apart=self.apart[which])

    def next_to_legs(self) -> "RowSlacks":
        """Return the slack at the via points, the minimum over the legs before and after each."""
        least = (np.minimum(np.append(v[:1], v, axis=0), np.append(v, v[-1:], axis=0)) for v in (self.left, self.apart))
        return RowSlacks(self.rows, *least)

    def taken(self, moved: Float[np.ndarray, "*S m F"]) -> Float[np.ndarray, "*S m R"]:
        """Return an upper bound on the slack that a displacement uses, by bounds `moved` on the features' motion."""
        found, first = [], 0
        for k, row in enumerate(self.rows):
            own = moved[..., first : first + len(row.features)]
            first += len(row.features)
            if row.is_view:
                axis, eye = own[..., 0], own[..., 1]
                distance = self.apart[:, k] - eye
                found.append(axis + np.divide(eye, distance, out=np.full_like(eye, np.inf), where=distance > 0))
            else:
                found.append(np.linalg.norm(own, axis=-1))
        return np.stack(found, axis=-1)


def slack_of_rows(
    task: Task, robot: Robot, x: Float[np.ndarray, "n N"], goals: Float[np.ndarray, "m 2 G"], on: Bool[np.ndarray, "m"]
) -> RowSlacks | None:
    """Return the slack of a task's rows at the m = n - 1 legs between configurations.

    Args:
        task: The task.
        robot: The robot with the job's tool.
        x: The configurations [rad or m].
        goals: Goals at both ends of each leg [m, rad].
        on: True for legs on which the task applies; the slack of other legs is unlimited.

    Returns:
        The slack; None for a task that constrains only the TCP's position, for which the tube is used.
    """
    if not (rows := row_proof.checked(task.parts)):
        return None
    left, apart = in_padded_sizes(partial(_slacks, task), robot, x[:-1], x[1:], goals)
    return RowSlacks(rows, np.where(on[:, None], np.maximum(left, 0.0), np.inf), np.where(on[:, None], apart, np.inf))


@jax.jit
@partial(jax.vmap, in_axes=(None, None, 0, 0, 0))
def _slacks(task: Task, robot: Robot, a, b, goals):
    requested, half = row_proof.between(task, goals), jnp.asarray(0.5 / PIECES)
    places = (jnp.arange(PIECES, dtype=float) + 0.5) / PIECES
    found = jax.vmap(
        lambda place: row_proof.row_slacks(robot, task.parts, requested, a + place * (b - a), b - a, half)
    )(places)
    return jnp.min(found.left, axis=0), jnp.min(found.apart, axis=0)
