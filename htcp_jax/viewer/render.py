"""Pictures and movies of a plan, rendered by MuJoCo off screen.

The arm's capsules, or the convex pieces that are checked in their place, are bodies that are placed at the plan's
configurations. The workpiece, cut open where its walls would hide the path, is its own mesh, or small discs at the
points of a cloud. The targets are beads coloured by status.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
from jaxtyping import Float, UInt8

from htcp_jax.viewer import drawn_meshes
from htcp_jax.viewer.arm_pose import ArmPose, moved, seen, together
from htcp_jax.viewer.camera import camera_pose, cut_plane, floor_height, kept_points, middle_root, viewpoint_of
from htcp_jax.viewer.colours import (
    DWELL,
    FAILED,
    FIXTURE,
    HERE,
    LINKS,
    NEAREST,
    NORMAL,
    OUTSIDE,
    TOOL,
    WALL,
    is_tool,
    rgb,
    target_styles,
)
from htcp_jax.viewer.movie import LAST_REPEATS, Film
from htcp_jax.viewer.offscreen import Camera
from htcp_jax.viewer.playback import pose_at, poses_along
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.viewpoints import Viewpoint

BEAD_M, FAILED_M, TIP_M = 0.008, 0.018, 0.007  # radii of the targets, the failed target, the tool's bare tip
MARK_M, NOWHERE = 0.012, [0.0] * 4  # radius of a contact point's marker, and its colour if hidden
GLYPH_M = 0.0012  # radius of a normal's glyph
DWELL_M = 0.011  # half the edge length of the cube at a dwell
FLOOR, EDGE, SKY = (0.95, 0.955, 0.96), (0.85, 0.87, 0.89), (0.92, 0.935, 0.95)
FOVY_DEG = 32.0
FEW_CORNERS = 4  # corners of a disc in a movie; few, as triangles dominate the rendering time
UNTOUCHED = {"contype": 0, "conaffinity": 0}  # no contacts: the plan is only displayed

_Geom = mujoco.mjtGeom


class Studio:
    """Renderer of a plan's pictures and movies; use it as a context manager.

    Args:
        replay: The plan.
        width: Width of a frame [pixels].
        height: Height of a frame [pixels].
        close: True for a close view of the cloud and the tool, without all of the arm.
        fine: True for smooth edges and shadows; a frame then takes three times as long.
        from_part: True to draw a moving part at rest and cut open; False to draw the world at rest and the part
            complete.
        side: 0 to look from the best side, 1 from the second.

    Raises:
        InputError: If no off-screen OpenGL platform works.
    """

    def __init__(
        self,
        replay: Replay,
        width: int = 1280,
        height: int = 880,
        close: bool = False,
        fine: bool = True,
        from_part: bool = False,
        side: int = 0,
    ):
        self._replay, self._close, self._from_part = replay, close, from_part or not replay.robot.part_moves
        self._side = side
        self._model = _model(replay, width, height, fine, self._from_part, side)
        self._data = mujoco.MjData(self._model)
        self._camera = Camera(self._model)
        self._beads = np.array([self._model.geom(f"target {t}").id for t in range(len(replay.target))])
        self._met_rgba = self._model.geom_rgba[self._beads].copy()
        self._not_yet = _rgba(target_styles(replay.status)[0].colour)
        self._colliding = _colliding_geoms(replay, self._model)
        self._dwells = {target: self._model.geom(f"dwell {target}").id for target in replay.summary.dwells}

    def __enter__(self) -> "Studio":
        return self

    def __exit__(self, *_) -> None:
        self._camera.__exit__()

    @property
    def width(self) -> int:
        """Width of a frame [pixels]."""
        return self._model.vis.global_.offwidth

    @property
    def cut_text(self) -> str:
        """The cut of the workpiece as text, see `Viewpoint.cut_text`."""
        return viewpoint_of(self._replay, self._from_part, self._side).cut_text

    def still(self, target: int) -> UInt8[np.ndarray, "H W 3"]:
        """Render the arm at a target, with all targets coloured by status."""
        pose = pose_at(self._replay, target)
        return self._frame(pose, self._view([pose]), len(self._beads))

    def movie(self) -> Film:
        """Return the film of the motion up to the last tracked target."""
        poses = poses_along(self._replay)
        return self.film([*poses, poses[-1]], LAST_REPEATS)

    def film(self, poses: Sequence[ArmPose], last_repeats: int = 0) -> Film:
        """Return a film with one frame per pose.

        A target has its status colour once it is reached; in the last frame all targets have it. The cube at a dwell is
        highlighted while the arm dwells there.

        Args:
            poses: The poses of the arm.
            last_repeats: How many more times the last frame is shown.
        """
        met, view = np.maximum.accumulate([pose.target + 1 for pose in poses]), self._view(poses)
        met = [*met.tolist()[:-1], len(self._beads)]
        return Film(len(poses), lambda k: self._frame(poses[k], view, met[k]), last_repeats)

    def _frame(self, pose: ArmPose, view: mujoco.MjvCamera, met: int) -> UInt8[np.ndarray, "H W 3"]:
        pose = seen(pose, self._from_part)
        ends = pose.arm.axes()
        self._data.mocap_pos[:-1] = (ends[0] + ends[1]) / 2
        self._data.mocap_pos[-1] = pose.T_root[:3, 3]
        mujoco.mju_mat2Quat(self._data.mocap_quat[-1], pose.T_root[:3, :3].ravel())
        for body, axis in enumerate(ends[1] - ends[0]):
            mujoco.mju_quatZ2Vec(self._data.mocap_quat[body], axis)
        for body in self._replay.pieces:
            self._data.mocap_pos[body] = pose.links[body, :3, 3]
            mujoco.mju_mat2Quat(self._data.mocap_quat[body], pose.links[body, :3, :3].ravel())
        self._model.geom_rgba[self._beads] = np.where(
            np.arange(len(self._beads))[:, None] < met, self._met_rgba, self._not_yet
        )
        for geom, shown, else_shown in self._colliding:
            self._model.geom_rgba[geom] = shown if pose.target == self._replay.failed else else_shown
        for target, geom in self._dwells.items():
            turning = pose.dwells and pose.target == target
            self._model.geom_rgba[geom] = _rgba(HERE if turning else DWELL)
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        return self._camera.shoot(self._data, view)

    def _view(self, poses: Sequence[ArmPose]) -> mujoco.MjvCamera:
        """Return a camera with the arm in all poses in view; in a close view, only with the poses at the targets."""
        size = self._model.vis.global_
        aspect = size.offwidth / size.offheight
        if self._close and len(poses) > 1:
            poses = [pose_at(self._replay, target) for target in range(len(self._replay.target))]
        how = np.radians(FOVY_DEG), aspect, self._close, self._from_part, self._side
        eye, look_at = camera_pose(self._replay, poses, *how)
        ahead = look_at - eye
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance = look_at, np.linalg.norm(ahead)
        camera.azimuth = np.degrees(np.arctan2(ahead[1], ahead[0]))
        camera.elevation = np.degrees(np.arcsin(ahead[2] / camera.distance))
        return camera


def _model(replay: Replay, width: int, height: int, fine: bool, from_part: bool, side: int) -> mujoco.MjModel:
    """Return a MuJoCo model of a plan: a body per capsule, and a last body with all objects fixed to the part."""
    spec = mujoco.MjSpec()
    ends, pieces = replay.arm_at(0).axes(), replay.pieces
    radius = np.append(np.asarray(replay.robot.capsule_radius), TIP_M)
    colours = [*np.where(is_tool(replay.robot), TOOL, LINKS), TOOL]
    for k, (p, q, r, colour) in enumerate(zip(*ends, radius, colours, strict=True)):
        half = np.linalg.norm(q - p) / 2
        kind = {"type": _Geom.mjGEOM_CAPSULE} if half > 0 else {"type": _Geom.mjGEOM_SPHERE}
        if k in pieces:
            vertices, faces = drawn_meshes.rounded_hull(*pieces[k])
            spec.add_mesh(name=f"piece {k}", uservert=vertices.ravel(), userface=faces.ravel())
            kind = {"type": _Geom.mjGEOM_MESH, "meshname": f"piece {k}"}
        body = spec.worldbody.add_body(mocap=True)
        body.add_geom(name=f"body {k}", **kind, size=[r, half, 0], rgba=_rgba(colour), **UNTOUCHED)
    part = spec.worldbody.add_body(name="part", mocap=True)
    spec.add_material(name="bead", emission=0.35)
    for style in target_styles(replay.status):
        bead = {"type": _Geom.mjGEOM_SPHERE, "size": [FAILED_M if style.colour == FAILED else BEAD_M, 0, 0]}
        for t in np.flatnonzero(style.where).tolist():
            place = {"name": f"target {t}", "pos": replay.target[t]}
            part.add_geom(**place, **bead, material="bead", rgba=_rgba(style.colour), **UNTOUCHED)
    for foot, tip in replay.normals:
        glyph = {"type": _Geom.mjGEOM_BOX, "fromto": [*foot, *tip], "size": [GLYPH_M, GLYPH_M, 0]}
        part.add_geom(**glyph, material="bead", rgba=_rgba(NORMAL), **UNTOUCHED)
    if replay.obstruction is not None and replay.obstruction.collides:
        ball = {"type": _Geom.mjGEOM_SPHERE, "size": [MARK_M, 0, 0], "pos": replay.obstruction.point}
        part.add_geom(name="colliding body", **ball, material="bead", rgba=NOWHERE, **UNTOUCHED)
    _add_marks(part, replay)
    seen_from = viewpoint_of(replay, from_part, side)
    _add_part(spec, part, replay, drawn_meshes.CORNERS if fine else FEW_CORNERS, seen_from)
    _add_fixtures(spec, part, replay)
    _add_surroundings(spec, replay, fine, from_part, seen_from.view.near)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.global_.fovy = FOVY_DEG
    return spec.compile()


def _add_marks(part: mujoco.MjsBody, replay: Replay) -> None:
    """Add a cube at every dwell, and a ball at the minimum of the guaranteed clearance."""
    for target in replay.summary.dwells:
        cube = {"type": _Geom.mjGEOM_BOX, "size": [DWELL_M] * 3, "pos": replay.target[target]}
        part.add_geom(name=f"dwell {target}", **cube, material="bead", rgba=_rgba(DWELL), **UNTOUCHED)
    if replay.narrow is not None:
        ball = {"type": _Geom.mjGEOM_SPHERE, "size": [MARK_M, 0, 0], "pos": replay.narrow.cloud}
        part.add_geom(name="minimum clearance", **ball, material="bead", rgba=_rgba(NEAREST), **UNTOUCHED)


def _colliding_geoms(replay: Replay, model: mujoco.MjModel) -> list[tuple[int, list[float], np.ndarray]]:
    """Return the geoms of the colliding body and its contact point, each with its highlighted and its usual colour."""
    if replay.obstruction is None or not replay.obstruction.collides:
        return []
    names = f"body {replay.robot.capsule_names.index(replay.obstruction.body)}", "colliding body"
    colours = _rgba(FAILED), _rgba(NEAREST)
    geoms = [model.geom(name).id for name in names]
    return [(geom, colour, model.geom_rgba[geom].copy()) for geom, colour in zip(geoms, colours, strict=True)]


def _add_part(spec: mujoco.MjSpec, part: mujoco.MjsBody, replay: Replay, corners: int, at: Viewpoint) -> None:
    """Add the workpiece, or its half behind the cut: its own triangles, or discs of a cloud; both sides of them."""
    near, share = at.axis.direction, at.cut
    if has_mesh := len(replay.triangles) > 0:
        kept = drawn_meshes.cut_triangles(replay.triangles, near, cut_plane(replay, share, near))
    else:
        surface = replay.surface.only(kept_points(replay, share, near))
    for name, side, colour in (("inside", 1, WALL[1]), ("outside", -1, OUTSIDE)):
        mesh = drawn_meshes.flat_mesh(kept, side) if has_mesh else drawn_meshes.discs(surface, side, corners)
        arrays = {"uservert": mesh.vertices, "usernormal": mesh.normals, "userface": mesh.faces}
        shell = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # a solid would have no volume
        spec.add_mesh(name=name, inertia=shell, **{key: array.ravel() for key, array in arrays.items()})
        part.add_geom(type=_Geom.mjGEOM_MESH, meshname=name, rgba=_rgba(colour), **UNTOUCHED)


def _add_fixtures(spec: mujoco.MjSpec, part: mujoco.MjsBody, replay: Replay) -> None:
    """Add the other obstacles as one transparent mesh."""
    both = [drawn_meshes.discs(replay.fixtures.clouds, side) for side in (1, -1)]
    corners = np.concatenate([replay.fixtures.triangles, *(mesh.vertices[mesh.faces] for mesh in both)]).reshape(-1, 3)
    if len(corners):
        faces, shell = np.arange(len(corners), dtype=np.int32), mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.add_mesh(name="fixtures", inertia=shell, uservert=corners.ravel(), userface=faces)
        look = {"rgba": [*_rgba(FIXTURE)[:3], 0.5]}
        part.add_geom(type=_Geom.mjGEOM_MESH, meshname="fixtures", **look, **UNTOUCHED)


def _add_surroundings(
    spec: mujoco.MjSpec, replay: Replay, fine: bool, from_part: bool, near: Float[np.ndarray, "3"]
) -> None:
    """Add floor, sky and light."""
    arms = together([seen(pose_at(replay, target), from_part) for target in range(len(replay.target))])
    cloud, low = moved(replay.cloud, middle_root(replay, from_part)), floor_height(replay, from_part)
    kind, drawn, mark = mujoco.mjtTexture, mujoco.mjtBuiltin, mujoco.mjtMark
    tiles = {"builtin": drawn.mjBUILTIN_FLAT, "mark": mark.mjMARK_EDGE, "rgb1": FLOOR, "rgb2": FLOOR, "markrgb": EDGE}
    spec.add_texture(name="tiles", type=kind.mjTEXTURE_2D, **tiles, width=512, height=512)
    sky = {"builtin": drawn.mjBUILTIN_FLAT, "rgb1": SKY, "rgb2": SKY}
    spec.add_texture(name="sky", type=kind.mjTEXTURE_SKYBOX, **sky, width=64, height=64)
    floor = spec.add_material(name="floor", texrepeat=[2, 2], texuniform=True)
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "tiles"
    plane = {"type": _Geom.mjGEOM_PLANE, "size": [0, 0, 0.1], "pos": [0, 0, low]}
    spec.worldbody.add_geom(**plane, material="floor", **UNTOUCHED)
    lamp = spec.worldbody.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, castshadow=True)
    lamp.dir = [*-near[:2], -0.9]  # light shines into the open side
    lamp.pos = cloud.mean(axis=0) - 3 * lamp.dir
    lamp.diffuse, lamp.specular = [0.42] * 3, [0.15] * 3
    visual = spec.visual
    visual.headlight.ambient, visual.headlight.diffuse, visual.headlight.specular = [0.5] * 3, [0.3] * 3, [0.08] * 3
    visual.quality.shadowsize, visual.quality.offsamples = (8192, 8) if fine else (2048, 4)
    visual.quality.numslices, visual.quality.numstacks = (64, 32) if fine else (20, 10)
    visual.map.znear, visual.rgba.haze = 0.01, [*SKY, 1]
    visual.map.shadowclip = 2  # the floor next to the arm is within the range of shadows, too
    reach = np.ptp(np.concatenate([cloud, arms.p.reshape(-1, 3)]), axis=0)
    spec.stat.extent, spec.stat.center = np.linalg.norm(reach), cloud.mean(axis=0)


def _rgba(colour: str) -> list[float]:
    return [*(part / 255 for part in rgb(colour)), 1.0]
