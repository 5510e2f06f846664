"""Self-distances of arms and distances to a cell's shapes, compared with MuJoCo's and, for a ring, with trimesh's.

    python -m benchmarks cell-distances [--configurations N] [MODEL[:TCP] ...]

The arms are the GP50, and models that `htcp robot` can read. At random configurations within the joint limits, the
distances of every capsule from every shape and of every checked pair of capsules are measured. MuJoCo's distances use
MuJoCo's kinematics. mj_geomDistance is undefined if a capsule's axis crosses a box, so MuJoCo gets boxes as meshes.
Clearances to the ring, which is not convex, are lower bounds; their largest distance from trimesh's is measured at
every 100th configuration.
"""

import argparse
import tempfile
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import trimesh

from benchmarks import hardware
from htcp_jax.caching import cache_folder
from htcp_jax.clearance import minimum_clearance
from htcp_jax.clearance.obstacles.of_cell import PlacedCloud, make_fixtures
from htcp_jax.clearance.obstacles.self_collision import make_self_collision
from htcp_jax.clearance.obstacles.self_exclusions import distances
from htcp_jax.io.cell import load_cell
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.model import Robot
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.spec import GP50
from htcp_jax.validation.mujoco_arm import MujocoArm

WEDGE = "0 0 0  0.3 0 0  0 0.2 0  0 0 0.4  0.2 0.15 0.1  0.1 0.1 0.35"
BOX = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.3, 0.3) for z in (-0.2, 0.2))
SHAPES = {
    "plane": '<geom name="plane" type="plane" size="3 3 1" pos="0 0 -0.1" euler="3 2 0"/>',
    "sphere": '<geom name="sphere" type="sphere" size="0.2" pos="0.6 0.2 0.9"/>',
    "capsule": '<geom name="capsule" type="capsule" size="0.1 0.3" pos="0.2 -0.6 0.6" euler="20 30 40"/>',
    "box": '<geom name="box" type="{box}" pos="-0.2 0.5 0.6" euler="20 30 40"/>',
    "cylinder": '<geom name="cylinder" type="cylinder" size="0.15 0.3" pos="-0.5 -0.3 0.8" euler="20 30 40"/>',
    "piece": '<geom name="piece" type="mesh" mesh="wedge" pos="0.5 -0.3 0.3" euler="20 30 40"/>',
}
SOLID, AS_MESH = 'box" size="0.1 0.3 0.2', 'mesh" mesh="box'  # a box
RING_AT, EVERY, PLACES = (0.4, 0.0, 0.7), 100, 101  # ring's position, every N-th configuration, samples of an axis
FAR_M, CROSSING = 1e3, 0.99  # cut-off distance; share of the radii beyond which axes cross


class Compared(NamedTuple):
    """Comparison with MuJoCo for one kind of shape.

    The fields are the largest difference [m], the number of distances, of contacts, and of different verdicts.
    """

    kind: str
    off_m: float
    count: int
    touching: int
    others: int


class World(NamedTuple):
    """Placement without a workpiece."""

    T_world_workpiece: np.ndarray
    interior_plane: np.ndarray


class Ring(NamedTuple):
    """Comparison with trimesh for the ring.

    The fields are the largest differences below and above trimesh's clearance [m], the number of clearances, and the
    number of wrong "clear" verdicts.
    """

    below_m: float
    above_m: float
    count: int
    wrong: int


def main() -> None:
    """Compare the distances of every arm, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--configurations", type=int, default=10_000)
    parser.add_argument("models", nargs="*", metavar="MODEL[:TCP]")
    requested = parser.parse_args()
    cache_folder.enable()
    print(hardware.line())
    with tempfile.TemporaryDirectory() as scratch:
        for file in [GP50, *(read(model, Path(scratch)) for model in requested.models)]:
            print(f"{file.stem}: kind, distances, off at most [m], touching, other verdicts")
            for row in compare(file, Path(scratch), requested.configurations):
                print(f"  {row.kind:9} {row.count:9,} {row.off_m:8.1e} {row.touching:9,} {row.others}")
            ring = compare_ring(file, Path(scratch), max(1, requested.configurations // EVERY))
            off = f"from {-ring.below_m:.1e} to {ring.above_m:.1e}"
            print(f"  ring      {ring.count:9,} {off}, wrongly clear {ring.wrong}", flush=True)


def read(model: str, folder: Path) -> Path:
    """Convert a vendor's model to an arm of capsules, and return its file."""
    file, _, tcp = model.partition(":")
    arm = folder / f"{Path(file).stem}.xml"
    arm.write_text(arm_xml(import_robot(Path(file), tcp or None), file))
    return arm


def compare(file: Path, folder: Path, count: int) -> list[Compared]:
    """Compare every kind of shape, and pairs of the arm's capsules, at `count` configurations."""
    arm, robot = MujocoArm(file), load_robot(file)
    (fixed,), own = make_fixtures(robot, load_cell(write_cell(folder, SOLID))), make_self_collision(robot)
    x, named = drawn(robot, count), [k for k, name in enumerate(fixed.names) if name]  # the others are padding
    names = [fixed.names[k] for k in named]
    ours, pairs = np.asarray(shape_distances(robot, fixed, jnp.asarray(x)))[:, named], distances(robot, own.pairs, x)
    theirs, their_pairs = _theirs(arm, write_cell(folder, AS_MESH), names, own.pairs, x)
    rows = [compared(name, ours[:, k], theirs[:, k]) for k, name in enumerate(names)]
    apart = pairs > -CROSSING * arm.radius[np.array(own.pairs)].sum(axis=1)
    return [*rows, compared("itself", pairs[apart], their_pairs[apart])]


def compare_ring(file: Path, folder: Path, count: int) -> Ring:
    """Compare clearances to a ring with trimesh's distances from samples of the capsules' axes.

    MuJoCo is not used, as it replaces the ring by its hull.
    """
    robot, arm = load_robot(file), MujocoArm(file).moving
    ring = trimesh.creation.annulus(0.35, 0.4, 0.2)
    ring.export(folder / "ring.stl")
    (folder / "ring.xml").write_text(
        '<mujoco><asset><mesh name="ring" file="ring.stl"/></asset><worldbody>'
        f'<geom type="mesh" mesh="ring" pos="{" ".join(map(str, RING_AT))}"/></worldbody></mujoco>'
    )
    (hoop,) = make_fixtures(robot, load_cell(folder / "ring.xml"))
    assert isinstance(hoop, PlacedCloud)
    ring.apply_translation(RING_AT)
    x = drawn(robot, count)
    world = World(np.eye(4), np.zeros(4))
    D = partial(minimum_clearance, robot, (hoop,), world)
    ours = np.asarray(jax.jit(lambda x: jax.lax.map(D, x))(jnp.asarray(x)))
    _, p, q, *_ = arm.arm_poses(x)
    places = p[:, :, None] + np.linspace(0, 1, PLACES)[:, None] * (q - p)[:, :, None]
    apart = np.array([_to_triangles(ring, each) for each in places])
    theirs = (apart - arm.radius).min(axis=1)
    off = ours - theirs
    return Ring(-off.min(), off.max(), count, int(((ours > 0) & (theirs <= 0)).sum()))


def _to_triangles(mesh: trimesh.Trimesh, places: np.ndarray) -> np.ndarray:
    """Return the minimum distance of each axis's samples (K, m, 3) from the mesh [m]."""
    return trimesh.proximity.closest_point_naive(mesh, places.reshape(-1, 3))[1].reshape(places.shape[:2]).min(axis=1)


def drawn(robot: Robot, count: int) -> np.ndarray:
    """Return random configurations, uniform within the joint limits and within half a turn of zero."""
    lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
    return np.random.default_rng(0).uniform(lower, upper, (count, len(lower)))


def write_cell(folder: Path, box: str) -> Path:
    file = folder / ("solid.xml" if box == SOLID else "meshes.xml")
    asset = f'<asset><mesh name="wedge" vertex="{WEDGE}"/><mesh name="box" vertex="{BOX}"/></asset>'
    geoms = "".join(SHAPES.values()).replace("{box}", box)
    file.write_text(f"<mujoco>{asset}<worldbody>{geoms}</worldbody></mujoco>")
    return file


@jax.jit
def shape_distances(robot: Robot, fixed, x):
    """Return the arm's distances from every shape, by htcp_jax [m]."""
    return jax.lax.map(lambda x: fixed.distances(robot, *capsule_segments(robot, x)), x, batch_size=64)


def _theirs(arm: MujocoArm, cell: Path, names, pairs, x) -> tuple[np.ndarray, np.ndarray]:
    """Return the distances from every shape and of every pair, by mj_geomDistance and MuJoCo's kinematics [m]."""
    spec = mujoco.MjSpec.from_file(str(cell))
    for k, (radius, length) in enumerate(zip(arm.radius, arm.length, strict=True)):
        spec.worldbody.add_geom(
            name=f"body {k}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, length / 2 or 1e-12, 0]
        )
    spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-10, 500
    model = spec.compile()
    data, turn = mujoco.MjData(model), np.empty(4)
    mujoco.mj_kinematics(model, data)
    bodies, shapes = ([model.geom(name).id for name in each] for each in (_bodies(arm), names))
    distance = partial(mujoco.mj_geomDistance, model, data)
    _, p, q, *_ = arm.arm_poses(x)
    found, between = np.empty((len(x), len(shapes), len(bodies))), np.empty((len(x), len(pairs)))
    for k in range(len(x)):
        for geom, a, b in zip(bodies, p[k], q[k], strict=True):
            data.geom_xpos[geom] = (a + b) / 2
            if (a != b).any():
                mujoco.mju_quatZ2Vec(turn, (a - b) / np.linalg.norm(a - b))
                mujoco.mju_quat2Mat(data.geom_xmat[geom], turn)
        found[k] = [[distance(body, shape, FAR_M, None) for body in bodies] for shape in shapes]
        between[k] = [distance(bodies[a], bodies[b], FAR_M, None) for a, b in pairs]
    return found, between


def _bodies(arm: MujocoArm) -> list[str]:
    return [f"body {k}" for k in range(len(arm.radius))]


def compared(kind: str, ours: np.ndarray, theirs: np.ndarray) -> Compared:
    off = np.abs(ours - theirs).max()
    return Compared(kind, float(off), ours.size, int((theirs <= 0).sum()), int(((ours > 0) != (theirs > 0)).sum()))
