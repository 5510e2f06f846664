"""Choice of a viewpoint: the side from which the arm, the workpiece and the cell hide least of the path and the tool.

DIRECTIONS horizontal directions are compared with the complete workpiece; with a cut one, the horizontal axes of the
workpiece's own frame, without what is in front of the path, and without the half that faces the camera. The plane of a
cut is perpendicular to that axis. Rays from points of the path, the tool and the workpiece to a distant camera are
cast against the triangles that are drawn: the workpiece's mesh, the convex pieces of the arm, and the fixtures.
Capsules and the points of a cloud are tested as such. A side shows the plan if most of the path's length is visible,
and most of the tool is not behind the workpiece, the fixtures or the arm's links. Sides that show it with the complete
part come first, then those that show it with a part that is cut open in front of the path, then all others. Among
these, penalties apply to sides from which the path is foreshortened, to a cut, and to a cut that removes the wall along
the path. The result is deterministic.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

DIRECTIONS = 16
ABOVE_RAD = np.radians(16.0), np.radians(40.0), np.radians(62.0)  # angles by which a camera looks downwards
ASIDE_RAD = np.radians(-28.0), np.radians(28.0)  # horizontal angles between a camera and the normal of the open side
SQUARE = 0.05  # bonus for the view perpendicular to the path, in units of the hidden share of the path
NEARLY_SQUARE = np.cos(np.pi / DIRECTIONS)  # least cosine of the angle between that view and another with the bonus
LEVEL = 0.5  # least horizontal share of an axis of the workpiece that a cut can be perpendicular to
HIDDEN_TOOL, HIDDEN_TIP = 1.0, 0.5  # weights of the hidden shares of the tool, and of its tips
HIDDEN_PART = 0.8  # weight of the hidden share of the part behind the arm
HALF = 0.5  # share of the workpiece that is cut off if the path reaches over it
MOST_HIDDEN = 0.5  # a side shows the plan if less than this share of the path, and of the tool, is hidden or cut off
IN_FRONT_M = 0.03  # a cut nearer to the path than this removes the wall along the path
FORESHORTENED, CUT_OFF, CUT, STEEP = 0.3, 1.0, 0.1, 0.03  # weights of the penalties; STEEP: for the steeper camera
SPACED = 300  # maximum number of points whose distance from the nearest other point is measured
MOST_POINTS, MOST_RAYS, ALONG = 3000, 40, 5  # maximum numbers of cloud points and of rays; samples of a tool's axis
SKIN_M = 0.005  # what is less far in front of a point does not hide it: a target is drawn as a bead
TIP_SKIN_M = 0.001  # the same for a tip, which is free: SKIN_M before the TCP
AT_ONCE = 2_000_000  # maximum number of pairs of ray and triangle that are tested together
APART_RAD = np.radians(60.0)  # minimum angle between two sides from which the same plan is drawn
LEAST_APART_RAD = np.radians(20.0)  # the same if fewer sides show the plan
COMPLETE, CUT_OPEN, HIDES = range(3)  # tiers of viewpoints: the plan is shown by the complete part, by a cut one, not

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


class PartAxis(NamedTuple):
    """An axis of the workpiece's own frame, in one of its two directions."""

    name: str  # such as "+x"
    direction: Float[np.ndarray, "3"]  # unit vector in the world


class Viewpoint(NamedTuple):
    """The open side, the camera's angles, and the part of the workpiece on the open side that is cut off."""

    view: View
    aside_rad: float  # horizontal angle to the open side's normal
    above_rad: float  # angle above the horizontal
    cut: float  # share of the workpiece's extent that is cut off; 0: the workpiece is complete
    axis: PartAxis  # axis towards the open side; a cut is perpendicular to it

    @property
    def toward(self) -> Float[np.ndarray, "3"]:
        """Unit direction towards the camera."""
        return towards_camera(*self[:3])

    @property
    def cut_text(self) -> str:
        """The cut as text; empty if the workpiece is complete."""
        if not self.cut:
            return ""
        name = self.axis.name
        return f"cut perpendicular to its {name[1]} axis, without {100 * self.cut:.0f} % towards {name}"


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
    tip: Float[np.ndarray, "F 3"] | None = None  # tip of the tool; None: its visibility does not matter

    def only(self, f: int) -> "ShownBodies":
        """Return the bodies at one of the configurations."""
        own, tip = (None if each is None else each[f : f + 1] for each in (self.triangles, self.tip))
        return self._replace(p=self.p[f : f + 1], q=self.q[f : f + 1], triangles=own, tip=tip)


class ShownScene(NamedTuple):
    """The workpiece, the path, the fixtures and the arm at some configurations; world [m]."""

    cloud: Float[np.ndarray, "P 3"]
    path: Float[np.ndarray, "T 3"]
    arm: ShownBodies
    triangles: Float[np.ndarray, "M 3 3"] = NO_TRIANGLES  # mesh of the workpiece; none: discs at the cloud's points
    fixtures: Float[np.ndarray, "F 3 3"] = NO_TRIANGLES
    part_axes: Float[np.ndarray, "3 3"] = np.eye(3)  # columns: axes of the workpiece's frame
    inward: Float[np.ndarray, "T 3"] | None = None  # normals of a cloud's wall at the path; None: a mesh, or unknown


def flat_side(scene: ShownScene) -> Viewpoint:
    """Return the best side for a horizontal, orthographic view."""
    return best_views([scene], (0.0,), (0.0,))[0]


def camera_views(scenes: Sequence[ShownScene], moves: bool = False) -> tuple[Viewpoint, Viewpoint]:
    """Return the best viewpoint of a camera that looks downwards, and the best one from another side.

    The other side is at least APART_RAD from the first. If none of these shows the plan, it is the side that shows it
    and is farthest from the first, by at least LEAST_APART_RAD.

    Args:
        scenes: Scenes over which the mean is taken.
        moves: True for a part that moves, which is not cut.
    """
    ranked = _ranked(scenes, ASIDE_RAD, ABOVE_RAD, cuts=not moves)
    level = np.array([each.at.toward[:2] / np.linalg.norm(each.at.toward[:2]) for each in ranked])
    near = (level @ level[0]).round(9)  # cosine of the horizontal angle to the best side
    other = int((near <= np.cos(APART_RAD).round(9)).argmax())
    shows = np.array([each.tier < HIDES for each in ranked])
    if not shows[other] and near[shows].min(initial=1.0) <= np.cos(LEAST_APART_RAD):
        other = int(np.where(shows, near, 1.0).argmin())
    return ranked[0].at, ranked[other].at


def view_from_side(cloud: Float[np.ndarray, "P 3"], targets: Float[np.ndarray, "T 3"]) -> View:
    """Return the horizontal view perpendicular to the path, with the last target behind the cloud's centre."""
    ahead = (targets[-1] - targets[0]) * [1, 1, 0]
    ahead = ahead / np.linalg.norm(ahead) if np.linalg.norm(ahead) > 1e-6 else np.array([1.0, 0, 0])
    near = np.cross(ahead, [0.0, 0, 1])
    return _view(-near if near @ (targets[-1] - cloud.mean(axis=0)) > 0 else near)


def best_views(
    scenes: Sequence[ShownScene], asides: Sequence[float], aboves: Sequence[float], cuts: bool = True
) -> list[Viewpoint]:
    """Return all viewpoints of these angles, the best mean over the scenes first.

    Args:
        scenes: The scenes.
        asides: Horizontal angles between the camera and the open side's normal [rad].
        aboves: Angles of the camera above the horizontal [rad].
        cuts: True for viewpoints with cut workpieces, too.
    """
    return [each.at for each in _ranked(scenes, asides, aboves, cuts)]


class _Ranked(NamedTuple):
    """A viewpoint with its tier, and its penalties."""

    tier: int
    badness: float
    at: Viewpoint


def _ranked(
    scenes: Sequence[ShownScene], asides: Sequence[float], aboves: Sequence[float], cuts: bool = True
) -> list[_Ranked]:
    """Return all viewpoints with their tiers and penalties, the best first; see `best_views`."""
    scenes = [_sampled(each) for each in scenes]
    square, radius = view_from_side(scenes[0].cloud, scenes[0].path), 1.5 * _spacing(scenes[0].cloud)
    found = []
    for view, axis, shares in _sides(scenes[0], square, cuts):  # the perpendicular side first; it wins ties
        for above in aboves:
            for aside in asides:
                views = [Viewpoint(view, aside, above, cut, axis) for cut in shares]
                found_shares = np.mean([_shares(scene, views, radius) for scene in scenes], axis=0)
                for at, (bad, *hidden) in zip(views, found_shares.tolist(), strict=True):
                    tier = HIDES if max(hidden) >= MOST_HIDDEN else CUT_OPEN if at.cut else COMPLETE
                    bad += STEEP * aboves.index(above) - SQUARE * (view.near @ square.near > NEARLY_SQUARE)
                    found.append(_Ranked(tier, round(bad, 9), at))
    return sorted(found, key=lambda each: each[:2])


def _sides(scene: ShownScene, square: View, cuts: bool) -> list[tuple[View, PartAxis, list[float]]]:
    """Return the views that are compared, each with the workpiece's axis towards it and the cuts of `Viewpoint.cut`.

    Args:
        scene: The scene.
        square: The view perpendicular to the path, which is the first one.
        cuts: True for views with cut workpieces, too.
    """
    axes = [
        PartAxis(f"{sign}{name}", factor * axis)
        for name, axis in zip("xyz", scene.part_axes.T, strict=True)
        for sign, factor in (("+", 1.0), ("-", -1.0))
    ]
    found = []
    for turn in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
        view = _view(np.cos(turn) * square.near + np.sin(turn) * square.right)
        found.append((view, max(axes, key=lambda each: each.direction @ view.near), [0.0]))
    for axis in axes if cuts else ():
        level = np.hypot(*axis.direction[:2])
        if level >= LEVEL:
            found.append((_view(axis.direction * [1, 1, 0] / level), axis, _cuts(scene, axis.direction)))
    return found


def hidden_targets(scene: ShownScene, at: Viewpoint) -> Bool[np.ndarray, "F T"]:
    """Return True for the targets of the path that are hidden from a distant camera, at each configuration.

    Args:
        scene: The scene.
        at: The viewpoint.
    """
    radius = 1.5 * _spacing(scene.cloud)
    return _by_arm(scene.arm, scene.path, at.toward) | _path_by_walls(scene, at, radius)


def _sampled(scene: ShownScene) -> ShownScene:
    """Return the scene with a part of the cloud's points and of the targets."""
    cloud, path, step = scene.cloud, scene.path, -(-len(scene.path) // MOST_RAYS)
    inward = None if scene.inward is None else scene.inward[::step]
    return scene._replace(cloud=cloud[:: -(-len(cloud) // MOST_POINTS)], path=path[::step], inward=inward)


def _shares(scene: ShownScene, views: Sequence[Viewpoint], radius: float) -> list[tuple[float, ...]]:
    """Return four numbers for viewpoints that differ only in the cut.

    They are the weighted sum of hidden shares and penalties, the share of the path's length that is hidden or lost by
    projection, the share of the tool behind other bodies, and the share of the path along which the cut removes the
    wall.
    """
    toward, arm, path = views[0].toward, scene.arm, scene.path
    along = np.linspace(0, 1, ALONG)[:, None, None]
    tool = ((1 - along) * arm.p[:, None, arm.tool] + along * arm.q[:, None, arm.tool]).reshape(len(arm.p), -1, 3)
    part = scene.cloud[:: -(-len(scene.cloud) // MOST_RAYS)]
    by_arm, links = _by_arm(arm, path, toward), ~arm.tool
    tool_by_links = np.stack([_by_arm(arm.only(f), own, toward, links)[0] for f, own in enumerate(tool)])
    short = _foreshortened(path, toward)
    always = HIDDEN_PART * _by_arm(arm, part, toward, links).mean() + FORESHORTENED * short
    tips = np.empty((0, 3)) if arm.tip is None else arm.tip
    tip_by_arm = np.array([_by_arm(arm.only(f), tips[f : f + 1], toward)[0, 0] for f in range(len(tips))], bool)
    found = []
    for at in views:
        hides_tool = tool_by_links | _by_walls(scene, at, tool.reshape(-1, 3), radius).reshape(tool.shape[:2])
        hides_path = (by_arm | _path_by_walls(scene, at, radius)).mean()
        hidden_tool = hides_tool.mean() if tool.size else 0.0
        hides_tip = (tip_by_arm | _by_walls(scene, at, tips, radius, TIP_SKIN_M)).mean() if len(tips) else 0.0
        share = hides_path + HIDDEN_TIP * hides_tip + HIDDEN_TOOL * hidden_tool
        near = path @ at.axis.direction > cut_depth(scene.cloud, at) - IN_FRONT_M + 1e-9
        lost = near.mean() if at.cut else 0.0
        found.append(
            (
                share + always + (CUT + CUT_OFF * lost if at.cut else 0.0),
                1 - (1 - hides_path) * (1 - short),
                hidden_tool,
                lost,
            )
        )
    return found


def _cuts(scene: ShownScene, direction: Float[np.ndarray, "3"]) -> list[float]:
    """Return the cuts that are compared, see `Viewpoint.cut`: what is in front of the path, the half."""
    depth = scene.cloud @ direction
    share = (depth.max() - (scene.path @ direction).max() - IN_FRONT_M) / max(np.ptp(depth), 1e-9)
    return [*([float(share)] if 0 < share < HALF else []), HALF]


def cut_depth(cloud: Float[np.ndarray, "P 3"], at: Viewpoint) -> float:
    """Return the distance from the origin of the plane at which the cloud is cut [m], along `Viewpoint.axis`."""
    depth = cloud @ at.axis.direction
    return float(depth.max() - at.cut * np.ptp(depth))


def _path_by_walls(scene: ShownScene, at: Viewpoint, radius: float) -> Mask:
    """Return True for targets that the workpiece or the fixtures hide; a cloud's wall also hides what lies on it."""
    hides = _by_walls(scene, at, scene.path, radius)
    return hides if scene.inward is None else hides | (scene.inward @ at.toward < 0)


def _by_walls(
    scene: ShownScene, at: Viewpoint, points: Float[np.ndarray, "n 3"], radius: float, skin_m: float = SKIN_M
) -> Mask:
    """Return True for points that the workpiece or the fixtures hide.

    What remains of triangles after a cut hides the ray where it meets them behind the cut.
    """
    toward, hides = at.toward, shadowed(points, scene.fixtures, at.toward, skin_m=skin_m)
    most = (at.axis.direction, cut_depth(scene.cloud, at)) if at.cut else None
    if len(scene.triangles):
        return hides | shadowed(points, scene.triangles, toward, most, skin_m)
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
    skin_m: float = SKIN_M,
) -> Mask:
    """Return True for points from which a ray meets a triangle more than `skin_m` away.

    Args:
        points: The points [m].
        triangles: The triangles [m].
        toward: Unit direction of the rays.
        most: Normal and depth of a plane, beyond which triangles are cut off [m]; None: no cut.
        skin_m: What is less far in front of a point does not hide it [m].
    """
    found = np.zeros(len(points), bool)
    if not len(triangles) or not len(points):
        return found
    plane = _plane(toward)
    p, d = points @ plane, points @ toward
    t, far = triangles @ plane, triangles @ toward
    overlap = (t.min(axis=1) <= p.max(axis=0)).all(axis=1) & (t.max(axis=1) >= p.min(axis=0)).all(axis=1)
    chosen = np.flatnonzero(overlap & (far.max(axis=1) > d.min() + skin_m))
    for some in np.array_split(chosen, max(1, -(-len(chosen) * len(points) // AT_ONCE))):
        a, (e, g) = t[some, 0], np.moveaxis(t[some, 1:] - t[some, :1], 1, 0)
        area = e[:, 0] * g[:, 1] - e[:, 1] * g[:, 0]
        safe = np.where(area == 0, np.inf, area)
        x, y = np.moveaxis(p[:, None] - a, 2, 0)
        u, v = (x * g[:, 1] - y * g[:, 0]) / safe, (y * e[:, 0] - x * e[:, 1]) / safe
        deep = far[some, 0] + u * (far[some, 1] - far[some, 0]) + v * (far[some, 2] - far[some, 0])
        meets = (u >= 0) & (v >= 0) & (u + v <= 1) & (deep > d[:, None] + skin_m) & (area != 0)
        if most is not None:
            normal, offset = most
            meets &= (points @ normal)[:, None] + (deep - d[:, None]) * (toward @ normal) <= offset
        found |= meets.any(axis=1)
    return found


def _behind(cloud: Float[np.ndarray, "P 3"], radius: float, points: Float[np.ndarray, "n 3"], toward) -> Mask:
    """Return True for points that are hidden by discs around the cloud's points.

    All pairs in the points' rectangle are tested: a k-d tree is slower, with the import of scipy.spatial.

    Args:
        cloud: The cloud [m].
        radius: Radius of the discs [m].
        points: The points [m].
        toward: Unit direction towards the camera.
    """
    if not len(points):
        return np.zeros(0, bool)
    plane = _plane(toward)
    p, d, c, far = points @ plane, points @ toward, cloud @ plane, cloud @ toward
    near = (c >= p.min(axis=0) - radius) & (c <= p.max(axis=0) + radius)
    near = np.flatnonzero(near.all(axis=1) & (far > d.min() + 3 * radius))
    x, y = p.T[..., None] - c[near].T[:, None]
    return ((far[near] > d[:, None] + 3 * radius) & (x * x + y * y <= radius**2)).any(axis=1)


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
