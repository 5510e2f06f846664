"""Jobs with user-supplied files: an arm like the UR10e with a thin tool, and parts with thin walls.

    job = box_job(folder)         # an open box, its opening towards the arm
    job = small_box_job(folder)   # the same box, quicker to load and to plan
    job = cube_job(folder)        # a box of 0.2 m, its opening towards the arm, and three points of a seam
    job = tub_job(folder)         # the same box with its opening upwards; the seam in the corner nearest to the arm
    job = car_job(folder)         # a cavity with a window, and a rib plate of 2 mm in front of the seam

Each writes arm.xml, part.obj, seam.csv and job.yaml, and returns the path of the last.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

# The UR10e's published lengths, d1, a2, a3, d4, d5, d6, with capsules of about its links' size.
ARM = """
<mujoco model="ur10e">
  <compiler angle="radian"/>
  <worldbody>
    <body name="shoulder" pos="0 0 0.1807"><joint name="pan" axis="0 0 1" range="-6.28319 6.28319"/>
      <geom name="shoulder" type="capsule" size="0.078" fromto="0 0 -0.02 0 0.08 0"/>
      <body name="upper" pos="0 0.176 0"><joint name="lift" axis="0 1 0" range="-6.28319 6.28319"/>
        <geom name="upper" type="capsule" size="0.06" fromto="0 0 0 0.6127 0 0"/>
        <body name="fore" pos="0.6127 -0.137 0"><joint name="elbow" axis="0 1 0" range="-3.14159 3.14159"/>
          <geom name="elbow" type="capsule" size="0.06" fromto="0 0 0 0 0.137 0"/>
          <geom name="fore" type="capsule" size="0.05" fromto="0 0 0 0.57155 0 0"/>
          <body name="wrist1" pos="0.57155 0 0"><joint name="wrist1" axis="0 1 0" range="-6.28319 6.28319"/>
            <geom name="wrist1" type="capsule" size="0.05" fromto="0 0 0 0 0.13515 0"/>
            <body name="wrist2" pos="0 0.13515 0"><joint name="wrist2" axis="0 0 1" range="-6.28319 6.28319"/>
              <geom name="wrist2" type="capsule" size="0.045" fromto="0 0 0 0 0 -0.11985"/>
              <body name="wrist3" pos="0 0 -0.11985"><joint name="wrist3" axis="0 1 0" range="-6.28319 6.28319"/>
                <geom name="flange" type="capsule" size="0.035" fromto="0 0.08 0 0 0.12655 0"/>
                <geom name="motor" type="capsule" size="0.025" fromto="0 0.14655 0 0 0.21655 0"/>
                <geom name="spindle" type="capsule" size="0.008" fromto="0 0.23655 0 0 0.30855 0"/>
                <site name="tcp" pos="0 0.34655 0" zaxis="0 1 0"/>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
SPINDLE_M = 0.008
RIB = (0.45, 0.452)  # x of the rib's two faces, in the cavity's frame

Point = Sequence[float]


def box_job(folder: Path) -> Path:
    """Open box: seam along the far lower edge, 10 to 15 mm from the walls."""
    seam = np.column_stack([np.linspace(0.385, 0.39, 41), np.linspace(-0.12, 0.12, 41), np.full(41, -0.165)])
    faces = [face for face in _box((0, -0.18, -0.18), (0.4, 0.18, 0.18)) if np.ptp(face[:, 0]) or face[0, 0]]
    return _job(folder, faces, seam, inlet=(0, 0, 0), at=(0.6, 0, 0.6), start=(-1.03, -2.4, 2.18, 0.22, -0.54, 0))


def small_box_job(folder: Path, spacing_m: float = 0.01) -> Path:
    """The open box with every tenth point of its seam, and with points on its walls as sparse as the spindle allows."""
    job = box_job(folder)
    job.write_text(job.read_text().replace("workpiece:", f"workpiece:\n  mesh_spacing_m: {spacing_m}", 1))
    header, *rows = (folder / "seam.csv").read_text().splitlines()
    (folder / "seam.csv").write_text("\n".join([header, *rows[::10]]) + "\n")
    return job


def cube_job(folder: Path) -> Path:
    """Open box of 0.2 m: three points of a seam along the far lower edge, 15 mm from the walls."""
    seam = np.column_stack([np.full(3, 0.185), np.linspace(-0.02, 0.02, 3), np.full(3, -0.085)])
    faces = [face for face in _box((0, -0.1, -0.1), (0.2, 0.1, 0.1)) if np.ptp(face[:, 0]) or face[0, 0]]
    return _job(folder, faces, seam, inlet=(0, 0, 0), at=(0.7, 0, 0.6), start=(-1.03, -2.4, 2.18, 0.22, -0.54, 0))


def tub_job(folder: Path) -> Path:
    """Tub: seam along the lower edge on the arm's side, 15 mm from it."""
    seam = np.column_stack([np.full(41, -0.165), np.linspace(-0.12, 0.12, 41), np.full(41, -0.385)])
    faces = [face for face in _box((-0.18, -0.18, -0.4), (0.18, 0.18, 0)) if np.ptp(face[:, 2]) or face[0, 2]]
    return _job(folder, faces, seam, inlet=(0, 0, 0), at=(0.8, 0, 0.4), start=(-0.22, -0.99, 0.8, 1.75, -1.57, 0))


def car_job(folder: Path) -> Path:
    """Cavity with a rib: seam 60 mm behind the rib plate, as seen from the arm, and 200 mm lower than the rib's edge.

    The seam is at the height of the window.
    """
    seam = np.column_stack([np.full(21, RIB[1] + 0.06), np.linspace(-0.2, 0.2, 21), np.full(21, 0.6)])
    walls = [face for face in _box((0, -0.9, 0), (1.4, 0.9, 1.1)) if np.ptp(face[:, 0]) or face[0, 0]]
    pareto_front = [(-0.9, 0.9, 0, 0.4), (-0.9, 0.9, 1.0, 1.1), (-0.9, -0.4, 0.4, 1.0), (0.4, 0.9, 0.4, 1.0)]
    window = [_quad((0, y, z), (0, y2, z), (0, y2, z2), (0, y, z2)) for y, y2, z, z2 in pareto_front]
    rib = _box((RIB[0], -0.9, 0), (RIB[1], 0.9, 0.8))
    faces = [*walls, *window, *rib]
    start = (-0.5, -2.52, 2.43, 3.1, 1.44, 0)
    return _job(folder, faces, seam, inlet=(0, 0, 0.7), at=(0.5, 0, 0.0), start=start)


def _job(folder: Path, faces: list[np.ndarray], seam: np.ndarray, inlet: Point, at: Point, start: Point) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "arm.xml").write_text(ARM)
    np.savetxt(folder / "seam.csv", seam, delimiter=",", header="x,y,z", comments="", fmt="%.6f")
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for face in faces for x, y, z in face]
    for k in range(1, 4 * len(faces) + 1, 4):
        lines += [f"f {k} {k + 1} {k + 2}", f"f {k} {k + 2} {k + 3}"]
    (folder / "part.obj").write_text("\n".join(lines) + "\n")
    job = {
        "robot": {"model": "arm.xml", "limits": "model"},
        "workpiece": {
            "cloud": "part.obj",
            "path": "seam.csv",
            "inlet_m": list(inlet),
            "pivot_m": [0, 0, 0],
            "neutral_translation_m": list(at),
            "rotation_y_rad": 0,
            "rotation_z_rad": 0,
        },
        "start_rad": list(start),
        "settings": {"q_weights": [1] * 6},
    }
    (folder / "job.yaml").write_text(yaml.safe_dump(job, sort_keys=False))
    return folder / "job.yaml"


def _quad(*corners: Point) -> np.ndarray:
    return np.array(corners, float)


def _box(low: Point, high: Point) -> list[np.ndarray]:
    """The six faces of a box, four corners each."""
    faces = []
    for axis in range(3):
        for side in (low, high):
            u, v = (axis + 1) % 3, (axis + 2) % 3
            face = np.tile(np.array(side, float), (4, 1))
            face[:, u] = [low[u], high[u], high[u], low[u]]
            face[:, v] = [low[v], low[v], high[v], high[v]]
            faces.append(face)
    return faces
