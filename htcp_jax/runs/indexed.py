"""Positions of indexed axes, which stand still within each seam."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from htcp_jax.model import Robot
from htcp_jax.motion import Plans


class IndexedAxes(NamedTuple):
    """Positions of the indexed axes on one seam of a plan."""

    seam: str | None  # name of the seam; None: the job has only one
    names: tuple[str, ...]
    slides: tuple[bool, ...]  # True for prismatic joints
    positions: tuple[float, ...]  # at the seam's first target [rad or m]
    moves: tuple[bool, ...]  # True for axes whose position is not exactly equal on the complete seam

    @property
    def description(self) -> str:
        """The positions as text, such as "turn at 20.5 deg, tilt at -51 deg"."""
        places = zip(self.slides, self.positions, strict=True)
        at = [f"{1e3 * place:.4g} mm" if slides else f"{np.rad2deg(place):.4g} deg" for slides, place in places]
        each = zip(self.names, self.moves, at, strict=True)
        text = ", ".join(f"{name} {'moves from' if moves else 'at'} {place}" for name, moves, place in each)
        return text if self.seam is None else f"{self.seam}: {text}"

    def record(self) -> dict[str, Any]:
        """Return the positions as a mapping for JSON."""
        return {
            "seam": self.seam,
            "positions": dict(zip(self.names, self.positions, strict=True)),
            "still": not any(self.moves),
        }


def indexed_axes(robot: Robot, plans: Plans, on_path: int, seams: Sequence[str]) -> list[IndexedAxes]:
    """Return the positions of the indexed axes on each seam that a plan of one scenario reaches.

    Args:
        robot: The robot.
        plans: The plan.
        on_path: Index of the first target on the path.
        seams: Names of the seams, in the order of work; empty if the job has only one.
    """
    joints = [k for k, name in enumerate(robot.joint_names) if name in robot.indexed]
    found, bounds = [], [on_path, *plans.seam_begins, plans.status.shape[1]]
    if not joints:
        return found
    names = tuple(robot.joint_names[k] for k in joints)
    slides = tuple(bool(robot.sliding[k]) for k in joints)
    for k, (first, end) in enumerate(itertools.pairwise(bounds)):
        reached = plans.executable[0, first:end]
        if not reached.any():
            continue
        via = plans.via_points
        between = via.x[(via.target > first) & (via.target < end) & plans.executable[0, via.target]]
        x = np.concatenate([plans.x[0, first:end][reached], between])[:, joints]
        moves = tuple((x != x[0]).any(axis=0).tolist())
        found.append(IndexedAxes(seams[k] if len(seams) else None, names, slides, tuple(x[0].tolist()), moves))
    return found
