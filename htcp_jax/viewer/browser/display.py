"""Display options: camera, cut of the workpiece, opacity of the arm."""

import threading
from collections.abc import Sequence

import numpy as np
import viser
from jaxtyping import Float

from htcp_jax.viewer.arm_pose import ArmPose, moved
from htcp_jax.viewer.browser.scene import BrowserScene
from htcp_jax.viewer.camera import CameraPose, camera_pose, open_side, viewpoint_of
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.viewpoints import View

FOVY_RAD, ASPECT = np.radians(40.0), 0.83  # vertical field of view, and width / height, of the initial camera
NARROW, PANEL = 576, 388  # largest width of a window whose panel is in front of the picture; the panel's width [pixel]
CLOSER_M = 0.25  # distance of the camera from the pair of nearest points
SIDES = "open side", "above", "front", "nothing"  # sides from which the workpiece can be cut


class DisplayOptions:
    """Display options in the lower part of the panel.

    Args:
        server: The server.
        stage: The 3D scene.
        lock: Lock that serialises the callbacks.
    """

    def __init__(self, server: viser.ViserServer, stage: BrowserScene, lock: threading.RLock):
        self._server, self._stage, self._lock = server, stage, lock
        self._replay: Replay | None = None
        gui = server.gui
        closer = gui.add_button("Look at the minimum distance", icon=viser.Icon.ZOOM_IN)
        closer.on_click(self._look_closer)
        back = gui.add_button("Show everything", icon=viser.Icon.ZOOM_OUT)
        back.on_click(self._look_back)
        # visible if the part moves
        self._from_part = gui.add_checkbox("View relative to the part", False, visible=False)
        self._from_part.on_update(lambda _: self._turn())
        self._folder = gui.add_folder("Workpiece")
        with self._folder:
            self._side = gui.add_dropdown("Cut from", SIDES, initial_value=SIDES[0])
            self._share = gui.add_slider("Cut off [%]", 0, 100, 1, 50)
            self._size = gui.add_slider("Point size [mm]", 1.0, 20.0, 0.5, 7.0)
        for element in (self._side, self._share, self._size):
            element.on_update(lambda _: self._cut())
        with gui.add_folder("Arm"):
            self._opacity = gui.add_slider("Opacity [%]", 5, 100, 5, 100)
            self._pair = gui.add_checkbox("Minimum distance", True)
            self._marks = gui.add_checkbox("Dwells, minimum clearance", True)
        self._opacity.on_update(lambda _: self._stage.fade(self._opacity.value / 100))
        self._marks.on_update(lambda _: self._stage.show_marks(self._marks.value))
        self._pair.on_update(lambda _: self._stage.show_smallest_distance(self._pair.value))
        server.on_client_connect(self._welcome)

    def show(self, replay: Replay, poses: Sequence[ArmPose]) -> None:
        """Show a plan with the panel's settings.

        The initial camera, which new browsers and a reset of the view use, has the workpiece and the arm in all poses
        in view. At first, a moving part is not cut, and another one only if its walls would hide the path.

        Args:
            replay: The plan.
            poses: The arm's poses during the motion.
        """
        is_first, self._replay, self._poses = self._replay is None, replay, poses
        self._folder.visible = replay.file is None or replay.file.has_part
        self._stage.show(replay, self._opacity.value / 100)
        moves_now = replay.robot.part_moves and not self._from_part.visible
        if moves_now or (is_first and not replay.sides[0].cut):
            self._side.value = "nothing"
        self._size.visible = not len(replay.triangles)
        self._from_part.visible = replay.robot.part_moves
        self._stage.show_smallest_distance(self._pair.value)
        self._stage.show_marks(self._marks.value)
        self._cut()
        self._set_camera()

    def _turn(self) -> None:
        """Draw the moving part or the world at rest, as the option says, and reset the camera of every browser."""
        with self._lock:
            self._stage.look_from(self._from_part.value)
            self._set_camera()
            clients = self._server.get_clients().values()
        for client in clients:
            self._fit(client, client.camera.aspect)

    def _welcome(self, client: viser.ClientHandle) -> None:
        """Fit the view of a new browser, whose picture has the panel beside it soon."""
        width = client.camera.image_width
        self._fit(client, (width - PANEL if width > NARROW else width) / client.camera.image_height)

    def _fit(self, client: viser.ClientHandle, aspect: float) -> None:
        """Move a browser's camera so that everything is in a picture of an aspect, width / height."""
        with self._lock:
            _move_camera(client, *self._camera_pose(min(aspect, ASPECT)))

    def _camera_pose(self, aspect: float) -> CameraPose:
        return camera_pose(self._replay, self._poses, FOVY_RAD, aspect, from_part=self._stage.from_part)

    def _set_camera(self) -> None:
        eye, look_at = self._camera_pose(ASPECT)
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = eye, look_at, FOVY_RAD

    def _cut(self) -> None:
        with self._lock:
            replay, directions = self._replay, {"above": np.array([0.0, 0, 1]), "front": -ahead(self._replay)}
            near = directions.get(self._side.value, viewpoint_of(replay).axis.direction)
            share = 0.0 if self._side.value == "nothing" else self._share.value / 100
            self._stage.cut(share, near, self._size.value / 1e3)

    def _look_closer(self, event: viser.GuiEvent) -> None:
        with self._lock:
            witness, target = self._replay.witness, self._stage.target
            side = open_side(self._replay, self._stage.from_part)
            arm, cloud = (moved(points[target], self._stage.T_part) for points in (witness.arm, witness.cloud))
        _move_camera(event.client, cloud + CLOSER_M * grazing(arm - cloud, side), cloud)

    def _look_back(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._fit(event.client, event.client.camera.aspect)


def _move_camera(client: viser.ClientHandle | None, position: np.ndarray, look_at: np.ndarray) -> None:
    """Move a browser's camera.

    Position and look-at point are both set, because in viser a new position also shifts the look-at point.
    """
    if client is not None:
        with client.atomic():
            client.camera.position = position
            client.camera.look_at = look_at


def grazing(gap: Float[np.ndarray, "3"], side: View) -> Float[np.ndarray, "3"]:
    """Return the unit direction to a camera that sees a gap in full length.

    The direction is perpendicular to the gap, and as close as possible to the open side's.
    """
    length = np.linalg.norm(gap)
    across = gap / length if length > 0 else side.up
    for wish in (side.near, side.up):
        direction = wish - (wish @ across) * across
        if np.linalg.norm(direction) > 0.1:
            break
    return direction / np.linalg.norm(direction)


def ahead(replay: Replay) -> np.ndarray:
    """Return the unit direction to the right in the view from the open side."""
    side = open_side(replay)
    return np.cross(side.near, side.up) * -1
