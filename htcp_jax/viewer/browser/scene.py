"""3D scene of the viewer: the arm, the cut workpiece, the targets, and the pair of nearest points.

Each viser server has one `BrowserScene`. `show` draws a plan, `pose` moves the arm to a target.
"""

from collections.abc import Sequence

import mujoco
import numpy as np
import trimesh
import viser
from jaxtyping import Float

from htcp_jax.viewer.arm_pose import ArmPose, seen
from htcp_jax.viewer.camera import cut_plane, floor_height, kept_points
from htcp_jax.viewer.colours import (
    DWELL,
    FAILED,
    FIXTURE,
    HERE,
    INK,
    LINKS,
    NEAREST,
    NORMAL,
    OUTSIDE,
    TOOL,
    WALL,
    is_tool,
    rgb,
)
from htcp_jax.viewer.drawn_meshes import cut_triangles, flat_mesh, rounded_hull
from htcp_jax.viewer.playback import pose_at
from htcp_jax.viewer.replay import Replay

BEAD_M, FAILED_M, HERE_M, WITNESS_M, TIP_M, MINIMUM_M = 0.007, 0.017, 0.012, 0.003, 0.007, 0.006  # radii
LABEL_GAP = 4  # maximum difference of target indices at which labels would overlap
LEADER_M = 0.12  # length of the line from the clearance's minimum up to its label
DWELL_M = 0.018  # edge length of the cube at a dwell
LIT = 0.72  # factor on colours that compensates viser's lights
LIGHT_UP = 0.8  # upward component added to the light's direction, which points to the open side
# Radius and point size of the cloud around the nearest points, shown even if cut off.
AROUND_M, AROUND_SIZE_M = 0.05, 0.0015
PART = "/part"  # parent node of all objects that move with the part
ROUND = 72, 72  # numbers of facets of a capsule, about its axis and along its ends

Vector = Float[np.ndarray, "3"]


class BrowserScene:
    """The scene of a viser server."""

    def __init__(self, server: viser.ViserServer):
        self._server, self._scene = server, server.scene
        self._scene.set_up_direction("+z")
        self._replay: Replay | None = None
        self._from_part = False
        self._shown: ArmPose | None = None
        self._walls: list[viser.MeshHandle] = []  # the workpiece's triangles, if it has some

    @property
    def from_part(self) -> bool:
        """True if the part is drawn at rest; always True if it does not move."""
        return self._from_part or not self._replay.robot.part_moves

    @property
    def T_part(self) -> Float[np.ndarray, "4 4"]:
        """Pose at which the part, and all objects fixed to it, are drawn."""
        return seen(self._shown, self.from_part).T_root

    def look_from(self, part: bool) -> None:
        """Draw a moving part at rest (`part` True), or the world (False)."""
        self._from_part = part
        with self._server.atomic():
            self._add_floor()
            self.move(self._shown)

    def show(self, replay: Replay, opacity: float) -> None:
        """Draw a plan, with the arm at the first target and the workpiece not cut.

        Args:
            replay: The plan.
            opacity: Opacity of the arm, 0 to 1.
        """
        with self._server.atomic():
            self._scene.reset()
            self._replay, self._walls = replay, []
            self._part = self._scene.add_frame(PART, show_axes=False)
            self._arm = [self._body(k, opacity) for k in range(replay.shape.p.shape[1] + 1)]
            self._add_targets()
            self._marks = self._add_marks()
            self._add_floor()
            self._add_fixtures()
            points = np.zeros((2, 3), np.float32)
            self._pair = self._add_balls(f"{PART}/minimum distance/points", points, WITNESS_M, NEAREST)
            self._line = self._scene.add_line_segments(
                f"{PART}/minimum distance/line", points[None], rgb(NEAREST), thickness=4, thickness_units="screen"
            )
            look = {"point_size": AROUND_SIZE_M, "point_shape": "circle", "precision": "float32"}
            self._around = self._scene.add_point_cloud(f"{PART}/minimum distance/around", points, rgb(OUTSIDE), **look)
            self._label = self._scene.add_label(f"{PART}/minimum distance/label", "", anchor="bottom-left")
            here = trimesh.creation.icosphere(subdivisions=3, radius=HERE_M)
            self._here = self._scene.add_mesh_simple(
                f"{PART}/targets/here", here.vertices, here.faces, color=compensated(HERE), opacity=0.55,
                cast_shadow=False,
            )  # fmt: skip
            self.pose(0)

    def _add_fixtures(self) -> None:
        triangles, clouds, _ = self._replay.fixtures
        if len(triangles):
            faces = np.arange(3 * len(triangles)).reshape(-1, 3)
            look = {"color": compensated(FIXTURE), "opacity": 0.5, "flat_shading": True, "side": "double"}
            self._scene.add_mesh_simple(f"{PART}/fixtures", triangles.reshape(-1, 3), faces, **look)
        if len(clouds.points):
            look = {"point_size": float(np.median(clouds.radius)), "point_shape": "circle", "precision": "float32"}
            self._scene.add_point_cloud(f"{PART}/clouds", clouds.points, rgb(FIXTURE), **look)

    def pose(self, target: int) -> None:
        """Move the arm, the target's marker and the pair of nearest points to a target."""
        replay, self.target = self._replay, target
        with self._server.atomic():
            blocked = replay.obstruction if target == replay.failed else None
            self.move(pose_at(replay, target))
            colliding = replay.witness.body[target] if replay.clearance[target] <= 0 else None
            if blocked is not None:
                colliding = blocked.body if blocked.collides else None
            for k, (node, shown) in enumerate(zip(self._arm, self.arm_colours, strict=True)):
                if shown != (colour := tuple(compensated(self._colour(k, colliding)).tolist())):
                    node.color = colour
            self._here.position = replay.target[target]
            pair = np.stack([replay.witness.arm[target], replay.witness.cloud[target]]).astype(np.float32)
            self._pair.batched_positions = pair
            self._line.points = pair[None]
            self._label.position = pair[1]
            there = np.linalg.norm(replay.cloud - pair[1], axis=1) < AROUND_M
            self._around.points = replay.cloud[there].astype(np.float32)
            distance = 1e3 * replay.clearance[target]
            place = f"target {target}" if replay.file is None else replay.file.places[target]
            deep = " deep" if distance <= 0 else ""
            near = "" if np.isnan(distance) else f"{abs(distance):.4g} mm{deep} at {place}"
            self._label.text = near if blocked is None else blocked.description

    def move(self, pose: ArmPose) -> None:
        """Move the arm, and a moving part, to any pose."""
        self._shown, drawn = pose, seen(pose, self.from_part)
        p, q = drawn.arm.axes()
        rotation = np.empty(4)
        mujoco.mju_mat2Quat(rotation, drawn.T_root[:3, :3].ravel())
        rotations, positions = rotations_to(q - p), (p + q) / 2
        for k in self._replay.pieces:
            mujoco.mju_mat2Quat(rotations[k], drawn.links[k, :3, :3].ravel())
            positions[k] = drawn.links[k, :3, 3]
        with self._server.atomic():
            self._part.wxyz, self._part.position = rotation, drawn.T_root[:3, 3]
            for node, wxyz, position in zip(self._arm, rotations, positions, strict=True):
                node.wxyz, node.position = wxyz, position

    @property
    def arm_colours(self) -> list[tuple[int, int, int]]:
        """Colours of the capsules and of the bare tip, see `compensated`."""
        return [tuple(node.color) for node in self._arm]

    @property
    def label(self) -> str:
        """Text at the pair of nearest points."""
        return self._label.text

    def cut(self, share: float, near: Vector, size_m: float) -> None:
        """Draw what remains of the workpiece after a cut: its own triangles, or the points of a cloud.

        Args:
            share: Share of the workpiece's extent that is removed.
            near: Unit direction to the open side, from which the light comes.
            size_m: Size of a cloud's point.
        """
        replay = self._replay
        if len(replay.triangles):
            self._add_walls(cut_triangles(replay.triangles, near, cut_plane(replay, share, near)))
            return
        surface = replay.surface.only(kept_points(replay, share, near))
        light = near + np.array([0, 0, LIGHT_UP])
        slope = np.abs(surface.normals @ (light / np.linalg.norm(light)))[:, None]
        inside = (surface.normals @ light > 0)[:, None]  # True for points whose inner side faces the light
        colours = np.where(inside, rgb(WALL[1]), rgb(OUTSIDE)) * (0.55 + 0.45 * slope)
        self._scene.add_point_cloud(
            f"{PART}/cloud", surface.points, colours.astype(np.uint8), point_size=size_m, point_shape="circle",
            point_shading="flat", precision="float32",
        )  # fmt: skip

    def _add_walls(self, triangles: Float[np.ndarray, "F 3 3"]) -> None:
        """Draw triangles of the workpiece in place of the former ones: both of their sides."""
        for node in self._walls:
            node.remove()
        sides = (("outside", 1, WALL[1]), ("inside", -1, OUTSIDE)) if len(triangles) else ()
        meshes = [(name, flat_mesh(triangles, side), colour) for name, side, colour in sides]
        self._walls = [
            self._scene.add_mesh_simple(
                f"{PART}/walls/{name}", mesh.vertices, mesh.faces, color=compensated(colour), flat_shading=True
            )
            for name, mesh, colour in meshes
        ]

    def fade(self, opacity: float) -> None:
        """Set the opacity of the arm."""
        for node in self._arm:
            node.opacity = opacity

    def show_smallest_distance(self, visible: bool) -> None:
        """Show or hide the pair of nearest points."""
        for node in (self._pair, self._line, self._around, self._label):
            node.visible = visible

    def show_marks(self, visible: bool) -> None:
        """Show or hide the marks at the dwells and at the minimum of the guaranteed clearance."""
        for node in self._marks:
            node.visible = visible

    def _body(self, k: int, opacity: float) -> viser.MeshHandle:
        """Add capsule k along its own z axis, or its convex piece; an index after the last adds the tool's bare tip."""
        robot = self._replay.robot
        p, q = (ends[k] for ends in self._replay.arm_at(0).axes())
        last = k == len(robot.capsule_link)
        radius = TIP_M if last else float(robot.capsule_radius[k])
        capsule = trimesh.creation.capsule(height=float(np.linalg.norm(q - p)), radius=radius, count=ROUND)
        piece = self._replay.pieces.get(k)
        mesh = rounded_hull(*piece) if piece else (capsule.vertices, capsule.faces)
        name, colour = f"/arm/{'tip' if last else f'{k + 1} {robot.capsule_names[k]}'}", compensated(self._colour(k))
        return self._scene.add_mesh_simple(name, *mesh, color=colour, opacity=opacity, flat_shading=piece is not None)

    def _colour(self, k: int, colliding: str | None = None) -> str:
        """Return the colour of capsule k, highlighted if it is `colliding`; an index after the last is the bare tip."""
        robot = self._replay.robot
        if k == len(robot.capsule_names):
            return TOOL
        if robot.capsule_names[k] == colliding:
            return FAILED
        return TOOL if is_tool(robot)[k] else LINKS

    def _add_balls(
        self, name: str, places: Float[np.ndarray, "n 3"], radius: float, colour: str
    ) -> viser.BatchedMeshHandle:
        ball = trimesh.creation.icosphere(subdivisions=2, radius=radius)
        upright = np.tile([1.0, 0, 0, 0], (len(places), 1))
        look = {"batched_colors": compensated(colour), "lod": "off", "cast_shadow": False}
        return self._scene.add_batched_meshes_simple(name, ball.vertices, ball.faces, upright, places, **look)

    def _add_targets(self) -> None:
        replay = self._replay
        for style in replay.styles:
            if style.where.any():
                radius = FAILED_M if style.name == "failed" else BEAD_M
                self._add_balls(f"{PART}/targets/{style.name}", replay.target[style.where], radius, style.colour)
        legs = np.stack([replay.target[:-1], replay.target[1:]], axis=1)
        legs = np.delete(legs, [first - 1 for first in replay.summary.seam_begins if first <= len(legs)], axis=0)
        if len(legs):
            self._scene.add_line_segments(f"{PART}/targets/way", legs, rgb(INK), thickness=1, thickness_units="screen")
        if len(replay.normals):
            look = {"thickness": 2, "thickness_units": "screen"}
            self._scene.add_line_segments(f"{PART}/targets/normals", replay.normals, rgb(NORMAL), **look)

    def _add_marks(self) -> list[viser.SceneNodeHandle]:
        """Add a cube at every dwell and a ball at the minimum of the guaranteed clearance, with labels.

        Neighbouring dwells share a label.
        """
        replay, marks = self._replay, []
        for target in replay.summary.dwells:
            cube = {"dimensions": (DWELL_M,) * 3, "color": compensated(DWELL), "cast_shadow": False}
            marks.append(self._scene.add_box(f"{PART}/motion/dwell {target}", position=replay.target[target], **cube))
        for group in label_groups(replay.summary.dwells):
            words, place = f"dwell at {', '.join(map(str, group))}", replay.target[group[0]]
            look = {"position": place, "anchor": "bottom-left"}
            marks.append(self._scene.add_label(f"{PART}/motion/dwells from {group[0]}", words, **look))
        if (narrow := replay.narrow) is not None:
            words = f"minimum clearance, on the segment to target {narrow.target}: {replay.summary.proven} proven, "
            words += f"{1e3 * narrow.seen_m:.3g} mm sampled"
            words = words if replay.file is None else replay.file.mark
            label_at = narrow.cloud + np.array([0.0, 0.0, LEADER_M])
            leader, thin = np.stack([narrow.cloud, label_at])[None], {"thickness": 1, "thickness_units": "screen"}
            ball = {"radius": MINIMUM_M, "color": compensated(NEAREST), "cast_shadow": False}
            marks += [
                self._scene.add_icosphere(f"{PART}/motion/minimum", position=narrow.cloud, **ball),
                self._scene.add_label(f"{PART}/motion/minimum label", words, position=label_at, anchor="bottom-left"),
                self._scene.add_line_segments(f"{PART}/motion/minimum leader", leader, rgb(NEAREST), **thin),
            ]
        return marks

    def _add_floor(self) -> None:
        """Add a grid on the floor, see `floor_height`."""
        height = floor_height(self._replay, self.from_part)
        self._scene.add_grid(
            "/floor", infinite_grid=True, fade_distance=12, position=(0, 0, height), cell_color=rgb("#dfe3e6"),
            section_color=rgb("#c3cad0"), shadow_opacity=0.12,
        )  # fmt: skip


def label_groups(targets: Sequence[int]) -> list[list[int]]:
    """Return the targets, given in ascending order, in groups whose labels would overlap."""
    groups: list[list[int]] = []
    for target in targets:
        if groups and target - groups[-1][-1] <= LABEL_GAP:
            groups[-1].append(target)
        else:
            groups.append([target])
    return groups


def rotations_to(axes: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Return the shortest rotations from z to the axes, as quaternions wxyz; the identity for a zero vector."""
    quaternions = np.empty((len(axes), 4))
    for quaternion, axis in zip(quaternions, axes, strict=True):
        mujoco.mju_quatZ2Vec(quaternion, axis)
    return quaternions


def compensated(colour: str) -> np.ndarray:
    """Return a colour darkened to compensate viser's lights."""
    return (LIT * np.array(rgb(colour))).astype(np.uint8)
