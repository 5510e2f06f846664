"""Choice of a viewpoint: the side from which the arm, the workpiece and the cell hide least of the path and the tool.

DIRECTIONS horizontal directions are compared, with and without the half of the workpiece that faces the camera. Rays
from points of the path, the tool and the workpiece to a distant camera are cast against the triangles that are drawn:
the workpiece's mesh, the convex pieces of the arm, and the fixtures. Capsules and the points of a cloud are tested as
such. Penalties apply to sides from which the path is foreshortened, to a cut, and to a cut that removes the wall along
the path. The result is deterministic.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

DIRECTIONS = 16
ABOVE_RAD = np.radians(16.0), np.radians(40.0)  # angles by which a camera looks downwards
ASIDE_RAD = np.radians(-28.0), np.radians(28.0)  # horizontal angles between a camera and the normal of the open side
SQUARE = 0.05  # bonus for the view perpendicular to the path, in units of the hidden share of the path
HIDDEN_TOOL, HIDDEN_PART = 1.0, 0.8  # weights of the hidden shares of the tool, and of the part behind the arm
FORESHORTENED, CUT_OFF, CUT, STEEP = 0.3, 0.3, 0.1, 0.03  # weights of the penalties; STEEP: for the steeper camera
SPACED = 300  # maximum number of points whose distance from the nearest other point is measured
MOST_POINTS, MOST_RAYS, ALONG = 3000, 40, 5  # maximum numbers of cloud points and of rays; samples of a tool's axis
SKIN_M = 0.005  # what is less far in front of a point does not hide it: a target is drawn as a bead
AT_ONCE = 2_000_000  # maximum number of pairs of ray and triangle that are tested together
APART_RAD = np.radians(60.0)  # minimum angle between two sides from which the same plan is drawn

NO_TRIANGLES = np.empty((0, 3, 3))
Mask = Bool[np.ndarray, "n"]


class View(NamedTuple):
    """A side view of the world: point p is projected to (right @ p, up @ p); near @ p is larger for nearer points."""

    right: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    near: Float[np.ndarray, "3"]

    def flat(self, points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
        """Return points projected along the view [m]."""
        return np.stack([points @ self.right, points @ self.up], axis=-1)


class Viewpoint(NamedTuple):
    """The open side, the camera's angles, and True if the half of the workpiece on the open side is cut off."""

    view: View
    aside_rad: float  # horizontal angle to the open side's normal
    above_rad: float  # angle above the horizontal
    cut: bool

    @property
    def toward(self) -> Float[np.ndarray, "3"]:
        """Unit direction towards the camera."""
        return towards_camera(*self[:3])


class ShownBodies(NamedTuple):
    """Capsules at F configurations: ends of the axes, world [m], radii, and a mask of the tool's capsules.

    E triangles of the convex pieces are drawn in place of some capsules.
    """

    p: Float[np.ndarray, "F K 3"]
    q: Float[np.ndarray, "F K 3"]
    radius: Float[np.ndarray, "K"]
    tool: Bool[np.ndarray, "K"]
    triangles: Float[np.ndarray, "F E 3 3"] | None = None  # None: all bodies are drawn as capsules
    capsule: Int[np.ndarray, "E"] | None = None  # capsule in whose place each triangle is drawn

    def only(self, f: int) -> "ShownBodies":
        """Return the bodies at one of the configurations."""
        own = None if self.triangles is None else self.triangles[f : f + 1]
        return self._replace(p=self.p[f : f + 1], q=self.q[f : f + 1], triangles=own)


class ShownScene(NamedTuple):
    """The workpiece, the path, the fixtures and the arm at some configurations; world [m]."""

    cloud: Float[np.ndarray, "P 3"]
    path: Float[np.ndarray, "T 3"]
    arm: ShownBodies
    triangles: Float[np.ndarray, "M 3 3"] = NO_TRIANGLES  # mesh of the workpiece; none: discs at the cloud's points
    fixtures: Float[np.ndarray, "F 3 3"] = NO_TRIANGLES


def flat_side(scene: ShownScene) -> Viewpoint:
    """Return the best side for a horizontal, orthographic view."""
    return best_views([scene], (0.0,), (0.0,), (False, True))[0]


def camera_views(scenes: Sequence[ShownScene], moves: bool = False) -> tuple[Viewpoint, Viewpoint]:
    """Return the best viewpoint of a camera that looks downwards, and the best one at least APART_RAD from it.

    Args:
        scenes: Scenes over which the mean is taken.
        moves: True for a part that moves, which is not cut.
    """
    views = best_views(scenes, ASIDE_RAD, ABOVE_RAD, (False,) if moves else (False, True))
    level = [each.toward[:2] / np.linalg.norm(each.toward[:2]) for each in views]
    apart = (each for each, own in zip(views, level, strict=True) if own @ level[0] < np.cos(APART_RAD) + 1e-9)
    return views[0], next(apart)


def view_from_side(cloud: Float[np.ndarray, "P 3"], targets: Float[np.ndarray, "T 3"]) -> View:
    """Return the horizontal view perpendicular to the path, with the last target behind the cloud's centre."""
    ahead = (targets[-1] - targets[0]) * [1, 1, 0]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0, 0])
    near = np.cross(ahead, [0.0, 0, 1])
    return _view(-near if near @ (targets[-1] - cloud.mean(axis=0)) > 0 else near)


def best_views(
    scenes: Sequence[ShownScene], asides: Sequence[float], aboves: Sequence[float], cuts: Sequence[bool]
) -> list[Viewpoint]:
    """Return all viewpoints of these angles, the best mean over the scenes first.

    Args:
        scenes: The scenes.
        asides: Horizontal angles between the camera and the open side's normal [rad].
        aboves: Angles of the camera above the horizontal [rad].
        cuts: Whether to cut off the half of the workpiece on the open side.
    """
    scenes = [_sampled(each) for each in scenes]
    square, radius = view_from_side(scenes[0].cloud, scenes[0].path), 1.5 * _spacing(scenes[0].cloud)
    found = []
    for turn in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:  # the perpendicular side first; it wins ties
        view = _view(np.cos(turn) * square.near + np.sin(turn) * square.right)
        for above in aboves:
            for aside in asides:
                one = [Viewpoint(view, aside, above, cut) for cut in cuts]
                bad = np.mean([_badness(scene, one, radius) for scene in scenes], axis=0)
                bad = bad - SQUARE * (turn == 0) + STEEP * (above > min(aboves))
                found += zip(bad.round(9).tolist(), one, strict=True)
    return [each for _, each in sorted(found, key=lambda each: each[0])]


def hidden_targets(scene: ShownScene, at: Viewpoint) -> Bool[np.ndarray, "F T"]:
    """Return True for the targets of the path that are hidden from a distant camera, at each configuration.

    Args:
        scene: The scene.
        at: The viewpoint.
    """
    radius = 1.5 * _spacing(scene.cloud)
    return _by_arm(scene.arm, scene.path, at.toward) | _by_walls(scene, at, scene.path, radius)


def _sampled(scene: ShownScene) -> ShownScene:
    """Return the scene with a part of the cloud's points and of the targets."""
    cloud, path = scene.cloud, scene.path
    return scene._replace(cloud=cloud[:: -(-len(cloud) // MOST_POINTS)], path=path[:: -(-len(path) // MOST_RAYS)])


def _badness(scene: ShownScene, views: Sequence[Viewpoint], radius: float) -> list[float]:
    """Return the weighted sum of hidden shares and penalties for viewpoints that differ only in the cut."""
    toward, arm, path = views[0].toward, scene.arm, scene.path
    along = np.linspace(0, 1, ALONG)[:, None, None]
    tool = ((1 - along) * arm.p[:, None, arm.tool] + along * arm.q[:, None, arm.tool]).reshape(len(arm.p), -1, 3)
    part = scene.cloud[:: -(-len(scene.cloud) // MOST_RAYS)]
    by_arm, links = _by_arm(arm, path, toward), ~arm.tool
    tool_by_links = np.stack([_by_arm(arm.only(f), own, toward, links)[0] for f, own in enumerate(tool)])
    always = HIDDEN_PART * _by_arm(arm, part, toward, links).mean() + FORESHORTENED * _foreshortened(path, toward)
    found = []
    for at in views:
        hides_tool = tool_by_links | _by_walls(scene, at, tool.reshape(-1, 3), radius).reshape(tool.shape[:2])
        hides_path = by_arm | _by_walls(scene, at, path, radius)
        share = hides_path.mean() + (HIDDEN_TOOL * hides_tool.mean() if tool.size else 0.0)
        lost = (path @ at.view.near > cut_depth(scene.cloud, at.view)).mean() if at.cut else 0.0
        found.append(float(share + always + (CUT + CUT_OFF * lost if at.cut else 0.0)))
    return found


def cut_depth(cloud: Float[np.ndarray, "P 3"], view: View) -> float:
    """Return the depth of the plane in the middle of the cloud at which it is cut [m], see `View.near`."""
    depth = cloud @ view.near
    return float((depth.max() + depth.min()) / 2)


def _by_walls(scene: ShownScene, at: Viewpoint, points: Float[np.ndarray, "n 3"], radius: float) -> Mask:
    """Return True for points that the workpiece or the fixtures hide.

    What remains of triangles after a cut hides the ray where it meets them behind the cut.
    """
    toward, hides = at.toward, shadowed(points, scene.fixtures, at.toward)
    most = (at.view.near, cut_depth(scene.cloud, at.view)) if at.cut else None
    if len(scene.triangles):
        return hides | shadowed(points, scene.triangles, toward, most)
    cloud = scene.cloud if most is None else scene.cloud[scene.cloud @ most[0] <= most[1]]
    return hides | _behind(cloud, radius, points, toward)


def _by_arm(
    arm: ShownBodies, points: Float[np.ndarray, "n 3"], toward: Float[np.ndarray, "3"], which: Mask | None = None
) -> Bool[np.ndarray, "F n"]:
    """Return True for points that the arm hides, at each configuration.

    Args:
        arm: The arm.
        points: The points [m].
        toward: Unit direction towards the camera.
        which: Mask of the capsules that hide; None: all.
    """
    which, plane = np.ones_like(arm.tool) if which is None else which, _plane(toward)
    round_, found = which.copy(), []
    if arm.triangles is not None:
        round_[arm.capsule] = False
    flat, deep, r = points @ plane, points @ toward, arm.radius[round_]
    for f, (p, q) in enumerate(zip(arm.p[:, round_], arm.q[:, round_], strict=True)):
        a, b = p @ plane, (q - p) @ plane
        off = flat[:, None] - a
        share = np.clip((off * b).sum(axis=2) / np.maximum((b * b).sum(axis=1), 1e-12), 0, 1)
        away = off - share[..., None] * b
        nearer = p @ toward + share * ((q - p) @ toward) > deep[:, None]
        hides = (nearer & ((away * away).sum(axis=2) < r**2)).any(axis=1)
        if arm.triangles is not None:
            hides |= shadowed(points, arm.triangles[f, which[arm.capsule]], toward)
        found.append(hides)
    return np.stack(found)


def shadowed(
    points: Float[np.ndarray, "n 3"],
    triangles: Float[np.ndarray, "M 3 3"],
    toward: Float[np.ndarray, "3"],
    most: tuple[Float[np.ndarray, "3"], float] | None = None,
) -> Mask:
    """Return True for points from which a ray meets a triangle more than SKIN_M away.

    Args:
        points: The points [m].
        triangles: The triangles [m].
        toward: Unit direction of the rays.
        most: Normal and depth of a plane, beyond which triangles are cut off [m]; None: no cut.
    """
    found = np.zeros(len(points), bool)
    if not len(triangles) or not len(points):
        return found
    plane = _plane(toward)
    p, d = points @ plane, points @ toward
    t, far = triangles @ plane, triangles @ toward
    overlap = (t.min(axis=1) <= p.max(axis=0)).all(axis=1) & (t.max(axis=1) >= p.min(axis=0)).all(axis=1)
    chosen = np.flatnonzero(overlap & (far.max(axis=1) > d.min() + SKIN_M))
    for some in np.array_split(chosen, max(1, -(-len(chosen) * len(points) // AT_ONCE))):
        a, (e, g) = t[some, 0], np.moveaxis(t[some, 1:] - t[some, :1], 1, 0)
        area = e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0]
        safe = np.where(area == 0, np.inf, area)
        x, y = np.moveaxis(p[:, None] - a, 2, 0)
        u, v = (x * g[:, 1] - y * g[:, 0]) / safe, (y * e[:, 0] - x * e[:, 1]) / safe
        deep = far[some, 0] + u * (far[some, 1] - far[some, 0]) + v * (far[some, 2] - far[some, 0])
        meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (deep > d[:, None] + SKIN_M) & (area != 0)
        if most is not None:
            normal, offset = most
            meets &= (points @ normal)[:, None] + (deep - d[:, None]) * (toward @ normal) <= offset
        found |= meets.any(axis=1)
    return found


def _behind(cloud: Float[np.ndarray, "P 3"], radius: float, points: Float[np.ndarray, "n 3"], toward) -> Mask:
    """Return True for points that are hidden by discs around the cloud's points.

    All pairs are tested: for so few points a k-d tree is slower, with the import of scipy.spatial.

    Args:
        cloud: The cloud [m].
        radius: Radius of the discs [m].
        points: The points [m].
        toward: Unit direction towards the camera.
    """
    plane = _plane(toward)
    x, y = (points @ plane).T[..., None] - (cloud @ plane).T[:, None]
    nearer = cloud @ toward > (points @ toward)[:, None] + 3 * radius
    return (nearer & (x * x + y * y <= radius**2)).any(axis=1)


def _plane(toward: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 2"]:
    """Return two directions perpendicular to the view."""
    return np.linalg.svd(toward[None])[2][1:].T


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
