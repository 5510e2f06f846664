"""Display options: camera, cut of the workpiece, opacity of the arm."""

import threading

import numpy as np
import viser
from jaxtyping import Float

from htcp_jax.model import kinematics
from htcp_jax.viewer.browser.scene import BrowserScene
from htcp_jax.viewer.camera import camera_pose, kept_points, open_side
from htcp_jax.viewer.replay import Replay
from htcp_jax.viewer.viewpoints import View

FOVY_RAD, ASPECT = np.radians(40.0), 1.05  # of the initial camera
CLOSER_M = 0.25  # camera's distance from the minimum distance
SIDES = "open side", "above", "front", "nothing"  # from which the workpiece is cut


class DisplayOptions:
    """Display options in the lower part of the panel.

    Args:
        server: The server.
        stage: The 3D scene.
        lock: Lock that serialises the callbacks.
    """

    def __init__(self, server: viser.ViserServer, stage: BrowserScene, lock: threading.RLock):
        self._server, self._stage, self._lock = server, stage, lock
        gui = server.gui
        closer = gui.add_button("Look at the minimum distance", icon=viser.Icon.ZOOM_IN)
        closer.on_click(self._look_closer)
        back = gui.add_button("Show everything", icon=viser.Icon.ZOOM_OUT)
        back.on_click(self._look_back)
        with gui.add_folder("Workpiece"):
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

    def show(self, replay: Replay, arms: kinematics.ArmShape) -> None:
        """Show a plan with the panel's settings.

        The camera of new browsers, and of every reset of the view, is set to show all of the arms and the workpiece.
        """
        self._replay = replay
        self._stage.show(replay, self._opacity.value / 100)
        self._stage.show_smallest_distance(self._pair.value)
        self._stage.show_marks(self._marks.value)
        self._cut()
        eye, look_at = camera_pose(replay, arms, FOVY_RAD, ASPECT)
        camera = self._server.initial_camera
        camera.position, camera.look_at, camera.fov = eye, look_at, FOVY_RAD

    def _cut(self) -> None:
        with self._lock:
            replay, directions = self._replay, {"above": np.array([0.0, 0, 1]), "front": -ahead(self._replay)}
            near = directions.get(self._side.value, open_side(replay).near)
            share = 0.0 if self._side.value == "nothing" else self._share.value / 100
            self._stage.cut(replay.surface.only(kept_points(replay, share, near)), near, self._size.value / 1e3)

    def _look_closer(self, event: viser.GuiEvent) -> None:
        with self._lock:
            witness, target = self._replay.witness, self._stage.target
            arm, cloud, side = witness.arm[target], witness.cloud[target], open_side(self._replay)
        _move_camera(event, cloud + CLOSER_M * grazing(arm - cloud, side), cloud)

    def _look_back(self, event: viser.GuiEvent) -> None:
        _move_camera(event, self._server.initial_camera.position, self._server.initial_camera.look_at)


def _move_camera(event: viser.GuiEvent, position: np.ndarray, look_at: np.ndarray) -> None:
    """Move the camera of the browser that triggered the event.

    Both points are set, as in viser a new position also shifts the look-at point.
    """
    if event.client is not None:
        with event.client.atomic():
            event.client.camera.position = position
            event.client.camera.look_at = look_at


def grazing(gap: Float[np.ndarray, "3"], side: View) -> Float[np.ndarray, "3"]:
    """Unit direction from which a gap is seen in full length.

    It is perpendicular to the gap, and nearest to the open side.
    """
    length = np.linalg.norm(gap)
    across = gap / length if length > 0 else side.up
    for wish in (side.near, side.up):
        direction = wish - (wish @ across) * across
        if np.linalg.norm(direction) > 0.1:
            break
    return direction / np.linalg.norm(direction)


def ahead(replay: Replay) -> np.ndarray:
    """Direction to the right in the view from the open side."""
    side = open_side(replay)
    return np.cross(side.near, side.up) * -1
