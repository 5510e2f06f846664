"""Off-screen OpenGL for MuJoCo's renderer, by EGL if available, else by OSMesa.

MuJoCo selects its platform by MUJOCO_GL when it is imported, which is too early here, and PyOpenGL selects its
platform only once per process. So each platform is tried in a separate process, and the first that works is used.
"""

import os
import subprocess
import sys
from functools import cache

import mujoco
import numpy as np
from jaxtyping import UInt8

from htcp_jax.errors import InputError

PLATFORMS = "egl", "osmesa"
NEEDED = "install libegl1, libopengl0 and libgl1-mesa-dri (EGL), or libosmesa6 (OSMesa); these are Debian's names"
TRIAL = """
import mujoco
from mujoco.{platform} import GLContext
context = GLContext(8, 8)
context.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), 100)
"""


class Camera:
    """Off-screen renderer of a model, to be used as a context manager.

    Args:
        model: The model; `model.vis.global_.offwidth` and `offheight` are the size of the pictures [pixels].
        most_geoms: Maximum number of geoms in the scene.

    Raises:
        InputError: If neither EGL nor OSMesa works.
    """

    def __init__(self, model: mujoco.MjModel, most_geoms: int = 10_000):
        size = model.vis.global_.offwidth, model.vis.global_.offheight
        self._gl = _context_class(platform())(*size)
        self._gl.make_current()
        self._model, self._rectangle = model, mujoco.MjrRect(0, 0, *size)
        self._renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._renderer)
        self._scene, self._option = mujoco.MjvScene(model, most_geoms), mujoco.MjvOption()

    def __enter__(self) -> "Camera":
        return self

    def __exit__(self, *_) -> None:
        self._gl.make_current()
        self._renderer.free()
        self._gl.free()

    def shoot(self, data: mujoco.MjData, view: mujoco.MjvCamera) -> UInt8[np.ndarray, "H W 3"]:
        """Return a picture of a state of the model, taken by a camera."""
        self._gl.make_current()
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._option, None, view, everything, self._scene)
        mujoco.mjr_render(self._rectangle, self._scene, self._renderer)
        pixels = np.empty((self._rectangle.height, self._rectangle.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, self._rectangle, self._renderer)
        return pixels[::-1]  # OpenGL's first row is the lowest


@cache
def platform() -> str:
    """Return the name of the first OpenGL platform that works; if MUJOCO_GL is set, only its platform is tried.

    Raises:
        InputError: If no platform works.
    """
    wish = os.environ.get("MUJOCO_GL", "").strip().lower()
    tried = (wish,) if wish in PLATFORMS else PLATFORMS
    for name in tried:
        if _works(name):
            return name
    raise InputError(f"no off-screen OpenGL ({' or '.join(tried)}): {NEEDED}")


def _works(name: str) -> bool:
    environment = {**os.environ, "MUJOCO_GL": name}
    trial = [sys.executable, "-c", TRIAL.format(platform=name)]
    try:
        return subprocess.run(trial, env=environment, capture_output=True, timeout=120).returncode == 0
    except subprocess.TimeoutExpired:
        return False


def _context_class(name: str) -> type:
    if name == "egl":
        from mujoco.egl import GLContext  # this import selects PyOpenGL's platform
    else:
        from mujoco.osmesa import GLContext
    return GLContext
