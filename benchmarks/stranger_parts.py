"""Parts, seams and small models of the strangers' jobs, made from the data in stranger_jobs.yaml.

All lengths are in metres, in the part's frame. Each shape is a mapping with one key:

    box: {low, high}                        closed box
    sheet: {corner, edges}                  parallelogram without thickness
    plate: {at, half, hole, thickness}      square plate across x, with a round hole; `at` is the hole's middle
    pipe: {from_to, inner, outer, axis}     pipe along axis x, y or z, about the origin
    wire: {from, to, radius}                rod with rounded ends
"""

from pathlib import Path
from typing import Any

import numpy as np
import trimesh

SIDES = 64  # of a round hole; also those of its square rim
RAIL = """<mujoco model="rail"><worldbody>
  <body name="carriage"><joint name="slide" type="slide" axis="0 1 0" range="{range}"/>
    <geom name="carriage" type="capsule" fromto="0 -0.05 -0.1 0 0.05 -0.1" size="0.06"/></body>
</worldbody></mujoco>
"""
TABLE = """<mujoco model="table"><compiler angle="radian"/><worldbody>
  <body name="stand"><geom name="post" type="capsule" fromto="0 0 -0.3 0 0 -0.1" size="0.05"/>
    <body name="table"><joint name="turn" axis="0 0 1" range="{range}"/>
      <geom name="plate" type="capsule" fromto="-0.06 0 -0.05 0.06 0 -0.05" size="0.03"/></body></body>
</worldbody></mujoco>
"""
GRINDER = """<mujoco model="grinder"><worldbody>
  <body name="grinder"><geom name="spindle" type="capsule" fromto="0 0 0.1 0 0 -0.012" size="{radius}"/>
    <geom name="motor" type="capsule" fromto="0 0 0.14 0 0 0.25" size="0.04"/>
    <site name="tcp" pos="0 0 -0.04" quat="0 1 0 0"/></body>
</worldbody></mujoco>
"""
MODELS = {"rail": RAIL, "positioner": TABLE, "tool": GRINDER}


def mesh(shapes: list[dict[str, dict[str, Any]]]) -> trimesh.Trimesh:
    """Return one mesh of all shapes."""
    return trimesh.util.concatenate([MAKERS[kind](**data) for each in shapes for kind, data in each.items()])


def box(low: list[float], high: list[float]) -> trimesh.Trimesh:
    """Return a closed box."""
    return trimesh.creation.box(bounds=[low, high])


def sheet(corner: list[float], edges: list[list[float]]) -> trimesh.Trimesh:
    """Return a parallelogram of two triangles."""
    p, (u, v) = np.array(corner, float), np.array(edges, float)
    return trimesh.Trimesh([p, p + u, p + u + v, p + v], [[0, 1, 2], [0, 2, 3]], process=False)


def plate(at: list[float], half: float, hole: float, thickness: float) -> trimesh.Trimesh:
    """Return a square plate across x with a round hole."""
    turn = np.linspace(0, 2 * np.pi, SIDES, endpoint=False) + np.pi / SIDES
    ring = np.column_stack([np.cos(turn), np.sin(turn)])
    inner, outer = hole / np.cos(np.pi / SIDES) * ring, half * ring / np.abs(ring).max(axis=1, keepdims=True)
    loops = [(0.0, inner), (0.0, outer), (thickness, outer), (thickness, inner)]
    vertices = np.concatenate([np.column_stack([np.full(SIDES, x), loop]) for x, loop in loops]) + np.array(at)
    faces = []
    for k in range(4):
        for i in range(SIDES):
            a, b = k * SIDES + i, k * SIDES + (i + 1) % SIDES
            c, d = ((k + 1) % 4) * SIDES + i, ((k + 1) % 4) * SIDES + (i + 1) % SIDES
            faces += [[a, b, d], [a, d, c]]
    return trimesh.Trimesh(vertices, faces, process=False)


def pipe(from_to: list[float], inner: float, outer: float, axis: str = "x") -> trimesh.Trimesh:
    """Return a pipe about the origin."""
    low, high = from_to
    made = trimesh.creation.annulus(inner, outer, high - low, sections=96)
    made.apply_translation([0, 0, (low + high) / 2 - made.bounds[:, 2].mean()])
    to = {"x": [1, 0, 0], "y": [0, 1, 0], "z": [0, 0, 1]}[axis]
    return made.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], to))


def wire(radius: float, to: list[float], **ends: list[float]) -> trimesh.Trimesh:
    """Return a rod with rounded ends."""
    p, q = np.array(ends["from"], float), np.array(to, float)
    length = float(np.linalg.norm(q - p))
    made = trimesh.creation.capsule(length, radius, count=[8, 16])
    made.apply_translation([0, 0, -made.bounds[:, 2].mean()])
    made.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], (q - p) / length))
    return made.apply_translation((p + q) / 2)


MAKERS = {"box": box, "sheet": sheet, "plate": plate, "pipe": pipe, "wire": wire}


def seam(data: dict[str, Any]) -> np.ndarray:
    """Return points and normals, (n, 6): of a line {from, to, count, normal}, or of an arc.

    An arc {centre, radius, degrees, count, axis} turns about an axis; normals point to its middle, or with
    `outwards: true` away from it; with `normal` all are the same.
    """
    count = data["count"]
    if "from" in data:
        points = np.linspace(data["from"], data["to"], count)
        normals = np.tile(np.array(data["normal"], float), (count, 1))
        return np.hstack([points, normals])
    turn = np.deg2rad(np.linspace(*data["degrees"], count))
    u, v = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[data["axis"]]
    ring = np.zeros((count, 3))
    ring[:, u], ring[:, v] = np.cos(turn), np.sin(turn)
    inwards = np.tile(np.array(data["normal"], float), (count, 1)) if "normal" in data else -ring
    return np.hstack([np.array(data["centre"]) + data["radius"] * ring, -inwards if data.get("outwards") else inwards])


def cell_model(shapes: list[dict[str, dict[str, Any]]]) -> str:
    """Return fixed bodies in the world as MJCF: boxes {low, high} and planes {height}."""
    geoms = []
    for k, each in enumerate(shapes):
        if "plane" in each:
            geoms.append(f'<geom name="plane{k}" type="plane" size="0 0 1" pos="0 0 {each["plane"]["height"]}"/>')
        else:
            low, high = (np.array(each["box"][end], float) for end in ("low", "high"))
            half, middle = (" ".join(f"{x:g}" for x in row) for row in ((high - low) / 2, (high + low) / 2))
            geoms.append(f'<geom name="box{k}" type="box" size="{half}" pos="{middle}"/>')
    return f'<mujoco model="cell"><worldbody>{"".join(geoms)}</worldbody></mujoco>\n'


def write(folder: Path, entry: dict[str, Any]) -> dict[str, Any]:
    """Write part, seam and models of a job into a folder, and return the job's keys for them."""
    mesh(entry["part"]).export(folder / "part.obj", include_normals=False)
    rows = seam(entry["seam"])
    np.savetxt(folder / "seam.csv", rows, delimiter=",", header="x,y,z,nx,ny,nz", comments="", fmt="%.9g")
    job: dict[str, Any] = {}
    for kind, text in MODELS.items():
        if kind in entry.get("models", {}):
            (folder / f"{kind}.xml").write_text(text.format(**entry["models"][kind]), encoding="utf-8")
            job[kind] = {"model": f"{kind}.xml"}
    if "fixed" in entry:
        (folder / "cell.xml").write_text(cell_model(entry["fixed"]), encoding="utf-8")
        job["cell"] = {"model": "cell.xml"}
    return job
