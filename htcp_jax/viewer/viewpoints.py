"""Viewpoint of a plan: the side from which the arm and the workpiece, cut open, hide least of the path and the tool.

Horizontal directions all round are tried. Occlusion is measured along parallel rays, without the half of the cloud that
faces the camera. There are penalties for a side from which the path is foreshortened, and for one whose cut removes the
wall along the path. The result is deterministic.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy
from jaxtyping import Bool, Float

DIRECTIONS = 16
ABOVE_RAD = np.radians(16.0)  # downward angle of a camera
ASIDE_RAD = np.radians(-28.0), np.radians(28.0)  # angles of a camera to the side that is cut open
SQUARE = 0.05  # bonus of the view perpendicular to the path, in shares hidden
FORESHORTENED, CUT_OFF = 0.3, 0.3  # weights, in shares hidden
MOST_POINTS, ALONG = 3000, 12  # samples of the cloud, and of an axis


class View(NamedTuple):
    """A side view of the world: a point projects to (right @ p, up @ p), nearer ones have larger near @ p."""

    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    near: Float[np.ndarray, "3"]

    def flat(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Project points along the view [m]."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


class Viewpoint(NamedTuple):
    """The side that is cut open, and the camera's angle to it [rad]."""

    view: View
    aside_rad: float


class ShownBodies(NamedTuple):
    """Capsules at F configurations: their ends, world [m], and a mask of the tool's."""

    p: Float[np.ndarray, "F K 3"]
    q: Float[np.ndarray, "F K 3"]
    radius: Float[np.ndarray, "K"]
    tool: Bool[np.ndarray, "K"]


def flat_side(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], arm: ShownBodies) -> View:
    """Choose the side of an orthographic, horizontal view.

    Args:
        cloud: The workpiece, world [m].
        path: The targets of the path, world [m].
        arm: The arm at some configurations.
    """
    return _best_view(cloud, path, arm, (0.0,), 0.0).view


def camera_view(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], arm: ShownBodies) -> Viewpoint:
    """Choose the side of a camera that is inclined downwards, at an angle to the cut.

    Args:
        cloud: The workpiece, world [m].
        path: The targets of the path, world [m].
        arm: The arm at some configurations.
    """
    return _best_view(cloud, path, arm, ASIDE_RAD, ABOVE_RAD)


def view_from_side(cloud: Float[np.ndarray, "P 3"], targets: Float[np.ndarray, "T 3"]) -> View:
    """Horizontal view, perpendicular to the direction of the targets, from the side of the cloud opposite to them."""
    ahead = (targets[-1] - targets[0]) * [1, 1, 0]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0, 0])
    near = np.cross(ahead, [0.0, 0, 1])
    return _view(-near if near @ (targets[-1] - cloud.mean(axis=0)) > 0 else near)


def _best_view(cloud, path, arm: ShownBodies, asides: Sequence[float], above_rad: float) -> Viewpoint:
    cloud = cloud[:: -(-len(cloud) // MOST_POINTS)]
    square = view_from_side(cloud, path)
    apart = np.median(scipy.spatial.cKDTree(cloud).query(cloud, k=2)[0][:, 1]) if len(cloud) > 1 else 0.0
    turns = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    best, least = Viewpoint(square, asides[0]), np.inf
    for turn in turns:  # the square side first: among equals the first is taken
        view = _view(np.cos(turn) * square.near + np.sin(turn) * square.right)
        depth = cloud @ view.near
        cut = (depth.max() + depth.min()) / 2
        kept, lost = cloud[depth <= cut], CUT_OFF * (path @ view.near > cut).mean() - SQUARE * (turn == 0)
        for aside in asides:
            toward = towards_camera(view, aside, above_rad)
            badness = hidden(kept, 1.5 * apart, path, arm, toward) + FORESHORTENED * _foreshortened(path, toward) + lost
            if badness < least - 1e-9:
                best, least = Viewpoint(view, aside), badness
    return best


def _view(near: Float[np.ndarray, "3"]) -> View:
    up = np.array([0.0, 0, 1])
    return View(np.cross(up, near), up, near)


def towards_camera(view: View, aside_rad: float, above_rad: float) -> Float[np.ndarray, "3"]:
    """Unit direction towards a camera.

    Args:
        view: The side.
        aside_rad: Horizontal angle from the side to the camera.
        above_rad: Angle of the camera above the horizontal.
    """
    level = np.cos(aside_rad) * view.near + np.sin(aside_rad) * view.right
    return np.cos(above_rad) * level + np.sin(above_rad) * view.up


def hidden(
    cloud: Float[np.ndarray, "P 3"],
    radius: float,
    path: Float[np.ndarray, "T 3"],
    arm: ShownBodies,
    toward: Float[np.ndarray, "3"],
) -> float:
    """Share of the path and the tool that a distant camera does not see, as the mean over the arm's configurations.

    Links of the arm hide them, and discs about the cloud's points.

    Args:
        cloud: The workpiece, world [m].
        radius: Radius of the discs [m].
        path: The targets of the path, world [m].
        arm: The arm at some configurations.
        toward: Unit direction towards the camera.
    """
    plane = np.linalg.svd(toward[None])[2][1:].T  # two directions across
    shares = np.linspace(0, 1, ALONG)[:, None, None]
    path = path[:: -(-len(path) // 40)]
    wall = scipy.spatial.cKDTree(cloud @ plane) if len(cloud) else None
    found = []
    for p, q in zip(arm.p, arm.q, strict=True):
        along = (1 - shares) * p + shares * q  # ALONG K 3
        seen = np.concatenate([path, along[:, arm.tool].reshape(-1, 3)])
        links = along[:, ~arm.tool].reshape(-1, 3)
        radii = np.tile(arm.radius[~arm.tool], ALONG)
        apart = np.linalg.norm((seen @ plane)[:, None] - (links @ plane)[None], axis=2)
        nearer = (links @ toward)[None] > (seen @ toward)[:, None]
        covered = (nearer & (apart < radii[None])).any(axis=1)
        if wall is not None:
            for k, near in enumerate(wall.query_ball_point(seen @ plane, radius)):
                covered[k] |= bool((cloud[near] @ toward > seen[k] @ toward + 3 * radius).any())
        found.append(covered.mean())
    return float(np.mean(found))


def _foreshortened(path: Float[np.ndarray, "T 3"], toward: Float[np.ndarray, "3"]) -> float:
    """Share of the path's length that is lost by projection along a direction."""
    legs = np.diff(path, axis=0)
    whole = np.linalg.norm(legs, axis=1).sum()
    across = np.linalg.norm(legs - (legs @ toward)[:, None] * toward, axis=1).sum()
    return 1 - across / whole if whole > 0 else 0.0
