"""Choice of a viewpoint: the side from which the arm and the cut workpiece hide least of the path and the tool.

DIRECTIONS horizontal directions are compared. Occlusion is measured along parallel rays, without the half of the cloud
that faces the camera. Penalties apply to sides from which the path is foreshortened, and to sides whose cut removes
the wall along the path. The result is deterministic.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

DIRECTIONS = 16
ABOVE_RAD = np.radians(16.0)  # angle by which a camera looks downwards
ASIDE_RAD = np.radians(-28.0), np.radians(28.0)  # horizontal angles between a camera and the normal of the open side
SQUARE = 0.05  # bonus for the view perpendicular to the path, in units of the hidden share
FORESHORTENED, CUT_OFF = 0.3, 0.3  # weights of the penalties, in units of the hidden share
SPACED = 300  # maximum number of points whose distance from the nearest other point is measured
MOST_POINTS, ALONG = 3000, 12  # maximum number of samples of the cloud, and number of samples of a capsule's axis


class View(NamedTuple):
    """A side view of the world: point p is projected to (right @ p, up @ p); near @ p is larger for nearer points."""

    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    near: Float[np.ndarray, "3"]

    def flat(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Return points projected along the view [m]."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


class Viewpoint(NamedTuple):
    """The open side, and the camera's horizontal angle to its normal [rad]."""

    view: View
    aside_rad: float


class ShownBodies(NamedTuple):
    """Capsules at F configurations: ends of the axes, world [m], radii, and a mask of the tool's capsules."""

    p: Float[np.ndarray, "F K 3"]
    q: Float[np.ndarray, "F K 3"]
    radius: Float[np.ndarray, "K"]
    tool: Bool[np.ndarray, "K"]


class ShownScene(NamedTuple):
    """The cloud, the path and the arm at some configurations; world [m]."""

    cloud: Float[np.ndarray, "P 3"]
    path: Float[np.ndarray, "T 3"]
    arm: ShownBodies


def flat_side(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], arm: ShownBodies) -> View:
    """Return the best side for a horizontal, orthographic view.

    Args:
        cloud: The workpiece, world [m].
        path: The targets of the path, world [m].
        arm: The arm at some configurations.
    """
    return _best_view([ShownScene(cloud, path, arm)], (0.0,), 0.0).view


def camera_view(cloud: Float[np.ndarray, "P 3"], path: Float[np.ndarray, "T 3"], arm: ShownBodies) -> Viewpoint:
    """Return the best side and horizontal angle for a camera that looks downwards.

    Args:
        cloud: The workpiece, world [m].
        path: The targets of the path, world [m].
        arm: The arm at some configurations.
    """
    return _best_view([ShownScene(cloud, path, arm)], ASIDE_RAD, ABOVE_RAD)


def camera_view_of(scenes: Sequence[ShownScene]) -> Viewpoint:
    """Return the best viewpoint for a moving part, which is not cut: the best mean over the scenes."""
    return _best_view(scenes, ASIDE_RAD, ABOVE_RAD, cut=False)


def view_from_side(cloud: Float[np.ndarray, "P 3"], targets: Float[np.ndarray, "T 3"]) -> View:
    """Return the horizontal view perpendicular to the path, with the last target behind the cloud's centre."""
    ahead = (targets[-1] - targets[0]) * [1, 1, 0]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0, 0])
    near = np.cross(ahead, [0.0, 0, 1])
    return _view(-near if near @ (targets[-1] - cloud.mean(axis=0)) > 0 else near)


def _best_view(scenes: Sequence[ShownScene], asides: Sequence[float], above_rad: float, cut: bool = True) -> Viewpoint:
    scenes = [each._replace(cloud=each.cloud[:: -(-len(each.cloud) // MOST_POINTS)]) for each in scenes]
    cloud = scenes[0].cloud
    square = view_from_side(cloud, scenes[0].path)
    apart = _spacing(cloud)
    turns = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    best, least = Viewpoint(square, asides[0]), np.inf
    for turn in turns:  # the perpendicular side first; it wins if others are equally good
        view = _view(np.cos(turn) * square.near + np.sin(turn) * square.right)
        drawn = [_after_the_cut(scene, view) if cut else (scene, 0.0) for scene in scenes]
        for aside in asides:
            toward = towards_camera(view, aside, above_rad)
            badness = np.mean([_badness(*each, 1.5 * apart, toward) for each in drawn]) - SQUARE * (turn == 0)
            if badness < least - 1e-9:
                best, least = Viewpoint(view, aside), badness
    return best


def _after_the_cut(scene: ShownScene, view: View) -> tuple[ShownScene, float]:
    """Return the scene with the cloud that remains after a cut, and the penalty for targets on the removed side."""
    depth = scene.cloud @ view.near
    cut = (depth.max() + depth.min()) / 2
    return scene._replace(cloud=scene.cloud[depth <= cut]), CUT_OFF * (scene.path @ view.near > cut).mean()


def _badness(scene: ShownScene, lost: float, radius: float, toward: Float[np.ndarray, "3"]) -> float:
    cloud, path, arm = scene
    return hidden(cloud, radius, path, arm, toward) + FORESHORTENED * _foreshortened(path, toward) + lost


def _view(near: Float[np.ndarray, "3"]) -> View:
    up = np.array([0.0, 0, 1])
    return View(np.cross(up, near), up, near)


def towards_camera(view: View, aside_rad: float, above_rad: float) -> Float[np.ndarray, "3"]:
    """Return the unit direction towards a camera.

    Args:
        view: The open side.
        aside_rad: Horizontal angle from the side's normal to the camera.
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
    """Return the share of the path and the tool that is hidden from a distant camera, as mean over configurations.

    The arm's links and discs around the cloud's points hide them.

    Args:
        cloud: The workpiece, world [m].
        radius: Radius of the discs [m].
        path: The targets of the path, world [m].
        arm: The arm at some configurations.
        toward: Unit direction towards the camera.
    """
    plane = np.linalg.svd(toward[None])[2][1:].T  # two directions perpendicular to the view
    shares = np.linspace(0, 1, ALONG)[:, None, None]
    path = path[:: -(-len(path) // 40)]
    walled, found = _behind(cloud, radius, path, plane, toward), []
    for p, q in zip(arm.p, arm.q, strict=True):
        along = (1 - shares) * p + shares * q  # ALONG K 3
        tool = along[:, arm.tool].reshape(-1, 3)
        seen = np.concatenate([path, tool])
        links = along[:, ~arm.tool].reshape(-1, 3)
        radii = np.tile(arm.radius[~arm.tool], ALONG)
        x, y = (seen @ plane).T[..., None] - (links @ plane).T[:, None]
        nearer = links @ toward > (seen @ toward)[:, None]
        covered = (nearer & (x * x + y * y < radii**2)).any(axis=1)
        covered |= np.concatenate([walled, _behind(cloud, radius, tool, plane, toward)])
        found.append(covered.mean())
    return float(np.mean(found))


def _behind(
    cloud: Float[np.ndarray, "P 3"],
    radius: float,
    points: Float[np.ndarray, "n 3"],
    plane: Float[np.ndarray, "3 2"],
    toward: Float[np.ndarray, "3"],
) -> Bool[np.ndarray, "n"]:
    """Return True for points that are hidden by discs around the cloud's points, see `hidden`.

    All pairs are tested: for so few points a k-d tree is slower, with the import of scipy.spatial.
    """
    x, y = (points @ plane).T[..., None] - (cloud @ plane).T[:, None]
    nearer = cloud @ toward > (points @ toward)[:, None] + 3 * radius
    return (nearer & (x * x + y * y <= radius**2)).any(axis=1)


def _spacing(cloud: Float[np.ndarray, "P 3"]) -> float:
    """Return the median distance of some points of a cloud from the nearest other point [m]; 0 for a single point."""
    if len(cloud) < 2:
        return 0.0
    some = cloud[:: -(-len(cloud) // SPACED)]
    square = sum((some[:, None, k] - cloud[:, k]) ** 2 for k in range(3))
    return float(np.sqrt(np.median(np.partition(square, 1, axis=1)[:, 1])))


def _foreshortened(path: Float[np.ndarray, "T 3"], toward: Float[np.ndarray, "3"]) -> float:
    """Return the share of the path's length that is lost by projection along a direction."""
    legs = np.diff(path, axis=0)
    whole = np.linalg.norm(legs, axis=1).sum()
    across = np.linalg.norm(legs - (legs @ toward)[:, None] * toward, axis=1).sum()
    return 1 - across / whole if whole > 0 else 0.0
