"""The rows of a motion: the postures that an arm passes from a plan's start on, one straight joint path after another.

    motion(plans, 12, on_path)                  # of one scenario
    motions(plans, on_path).cost(len(plans.x))  # of all of them at once

Only what is executable is a motion; what a plan has beyond that is no part of it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Int8

from htcp_jax.planner.plans import Plans
from htcp_jax.status import Kind

ONE_POINT_M = 1e-5  # targets closer to each other are one point of the path
OnPath = int | Int[np.ndarray, "S"]  # the first target that is a point of the path, see `Scenario`


class Motion(NamedTuple):
    """Of one scenario; the start comes first. There are no rows where no target is executable."""

    x: Float[np.ndarray, "n N"]  # [rad or m]
    target: Int[np.ndarray, "n"]  # to which the row leads; of a dwell, the one that the tool stays at
    kind: Int8[np.ndarray, "n"]  # `status.Kind`: what the arm does on its way to this row from the one before


class Motions(NamedTuple):
    """Of S scenarios, one after the other; see `Motion`."""

    scenario: Int[np.ndarray, "n"]
    x: Float[np.ndarray, "n N"]  # [rad or m]
    target: Int[np.ndarray, "n"]
    kind: Int8[np.ndarray, "n"]

    def of(self, scenario: int) -> Motion:
        """That of one scenario, by its row."""
        return Motion(*(column[self.scenario == scenario] for column in self[1:]))

    @property
    def steps(self) -> Float[np.ndarray, "n"]:
        """|x_k - x_{k-1}| from the row before [rad]; 0 at the starts."""
        first = np.diff(self.scenario, prepend=-1) != 0
        return np.where(first, 0.0, np.linalg.norm(np.diff(self.x, axis=0, prepend=self.x[:1]), axis=1))


def motion(plans: Plans, scenario: int, on_path: int, *, retract: bool = False) -> Motion:
    """The motion of one scenario, up to its last executable target.

    scenario: its row in `plans`; on_path: the first target that is a point of the path, `Scenario.on_path`. retract:
    whether it leads back to the start, too, through the same postures: what is clear one way is clear the other.
    """
    there = motions(plans.rows([scenario]), on_path).of(0)
    if not retract:
        return there
    x, target, kind = (column[-2::-1] for column in there)
    back = Motion(x, target, np.full_like(kind, Kind.RETRACT))
    return Motion(*map(np.concatenate, zip(there, back, strict=True)))


def motions(plans: Plans, on_path: OnPath, rows: Bool[np.ndarray, "S T"] | None = None) -> Motions:
    """The motions of all scenarios. rows: the targets to go to, in place of the executable ones."""
    rows = plans.executable if rows is None else rows
    begun, (s, t) = np.flatnonzero(rows.any(axis=1)), np.nonzero(rows)
    knots = plans.knots
    passed = rows[knots.scenario, knots.target]
    scenario = np.concatenate([begun, knots.scenario[passed], s])
    target = np.concatenate([np.zeros_like(begun), knots.target[passed], t])
    x = np.concatenate([plans.start[begun], knots.x[passed], plans.x[s, t]])
    place = np.repeat([0, 1, 2], [len(begun), passed.sum(), len(s)])  # on the way to a target: start, knots, row
    order = np.lexsort((place, target, scenario))
    scenario, target, place = scenario[order], target[order], place[order]
    kind = _kinds(target, place, np.broadcast_to(on_path, len(rows))[scenario])
    return Motions(scenario, x[order], target - (kind == Kind.DWELL), kind)


def _kinds(target: np.ndarray, place: np.ndarray, on_path: np.ndarray) -> Int8[np.ndarray, "n"]:
    """What the arm does on its way to postures that lead to targets; a start is the transfer's if there is one."""
    knot = place == 1
    kind = np.where(target > on_path, np.where(knot, Kind.DWELL, Kind.FEED), Kind.APPROACH)
    kind[knot & (target == 0)] = Kind.TRANSFER
    kind[(place == 0) & np.append(kind[1:] == Kind.TRANSFER, False)] = Kind.TRANSFER
    return kind.astype(np.int8)
