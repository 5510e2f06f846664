"""Relative poses, Jacobians and distances in cells whose part moves, compared with MuJoCo's in its own tree.

    python -m benchmarks moving-cells [--configurations N]

The cells are the GP50 next to the positioner in configs/positioner, the GP50 on a rail next to a turntable, and the
GP50 with the part in its hand at a fixed tool. The last two are composed by a job; for MuJoCo, the tree is written by
hand, with the world as its root. A box and a wedge stand in the world. Capsules enclose them, so clearances to these
are lower bounds on MuJoCo's to the shapes themselves. The shapes of cell_distances.py are fixed to the part.
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
from scipy.spatial.transform import Rotation

from benchmarks import cell_distances, hardware
from benchmarks.cell_distances import FAR_M, WEDGE, Compared, Ring, compared
from htcp_jax.caching import cache_folder
from htcp_jax.clearance import minimum_clearance
from htcp_jax.clearance.obstacles.of_cell import make_fixtures
from htcp_jax.clearance.obstacles.self_collision import make_self_collision
from htcp_jax.clearance.obstacles.self_exclusions import distances
from htcp_jax.io.cell import load_cell
from htcp_jax.jobs import build, load_config
from htcp_jax.model import Robot, kinematics
from htcp_jax.spec import GP50

POSITIONER = Path("configs/positioner/cell.xml")
STANDING = (  # shapes in the world; {} is the box's type
    '<geom name="crate" type="{}" pos="0.9 0.9 0.3" quat="0.9 0.1 0.2 0.3"/>'
    '<geom name="wedge" type="mesh" mesh="wedge" pos="0.7 -1 0.4" quat="0.8 -0.2 0.1 0.3"/>'
)
IN_WORLD = "crate", "wedge"  # their names
BASE, TURN = (0.1, 0.0, 0.5), (0.05, -0.1, 0.3)  # the arm's pose on the carriage: position [m], roll-pitch-yaw [rad]
AT, TILT = (1.4, 0.2, 0.4), (0.1, 0.2, -0.4)  # pose of the turntable [m, rad]
TOOL_AT, TOOL_TURN = (1.1, 0.3, 0.2), (-0.2, 0.3, 0.5)  # pose of the fixed tool [m, rad]
RAIL = (
    '<geom name="{0}beam" type="capsule" fromto="0 -2 0 0 2 0" size="0.1"/><body name="{0}car" pos="0 0 0.15">'
    '<joint name="slide" type="slide" axis="0 1 0.1" range="-1.5 1.5"/>'
    '<geom name="{0}carriage" type="capsule" fromto="-0.2 0 0.1 0.2 0 0.1" size="0.12"/>{1}</body>'
)
TABLE = (
    '<geom name="{0}post" type="capsule" fromto="0 0 -0.3 0 0 -0.1" size="0.1"/><body name="{0}table" pos="0 0 0.05">'
    '<joint name="turn" axis="0 0.1 1" pos="0.02 0.01 0" range="-3 3"/>'
    '<geom name="{0}plate" type="capsule" fromto="-0.3 0 0 0.3 0 0" size="0.05"/>{1}</body>'
)
GRINDER = (
    '<geom name="{0}stand" type="capsule" fromto="0 0 0 0 0 0.5" size="0.08"/>'
    '<geom name="{0}wheel" type="capsule" fromto="0.1 -0.1 0.6 0.1 0.1 0.6" size="0.1"/>'
    '<site name="tcp" pos="0.2 0 0.6" quat="0.7 0.1 0.6 0.2"/>'
)


class Cell(NamedTuple):
    """The job of a cell, and MuJoCo's tree of the same cell, in which the site `part` is the part's frame."""

    job: dict
    tree: str


def main() -> None:
    """Compare every cell, and print the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--configurations", type=int, default=10_000)
    count = parser.parse_args().configurations
    cache_folder.enable()
    print(hardware.line())
    with tempfile.TemporaryDirectory() as scratch:
        for name, cell in cells(Path(scratch)).items():
            print(f"{name}: kind, values, off at most [m or 1], touching, other verdicts")
            rows, ring = compare(cell, Path(scratch), count)
            for row in rows:
                print(f"  {row.kind:29} {row.count:9,} {row.off_m:8.1e} {row.touching:9,} {row.others}")
            off = f"from {-ring.below_m:.1e} to {ring.above_m:.1e}, wrongly clear {ring.wrong}"
            print(f"  {'shapes in the world':29} {ring.count:9,} {off}", flush=True)


def cells(folder: Path) -> dict[str, Cell]:
    """Return the three cells by name; the models of the composed ones are written to `folder`."""
    for name, xml in (("rail", RAIL), ("table", TABLE), ("grinder", GRINDER)):
        body = f"<mujoco><compiler angle='radian'/><worldbody>{xml.format('', '')}</worldbody></mujoco>"
        (folder / f"{name}.xml").write_text(body)
    asset = f'<asset><mesh name="wedge" vertex="{WEDGE}"/></asset>'
    standing = STANDING.format('box" size="0.1 0.3 0.2')
    (folder / "world.xml").write_text(f"<mujoco>{asset}<worldbody>{standing}</worldbody></mujoco>")
    job = {"cell": {"model": str(folder / "world.xml")}, "start_rad": "auto"}
    part = {"cloud": "none", "path": "path.csv"}  # neither is read
    head, arm, tail = GP50.read_text().replace("</worldbody>", "<worldbody>").split("<worldbody>")
    on_table = TABLE.format("positioner.", '<site name="part"/>')
    on_rail = RAIL.format("rail.", _placed(arm, BASE, TURN)) + _placed(on_table, AT, TILT)
    in_hand = arm.replace('name="tcp"', 'name="part"') + _placed(GRINDER.format("tool."), TOOL_AT, TOOL_TURN)
    plate = '<body name="faceplate" pos="0 0 0.1">'
    rail = {
        "robot": {"model": str(GP50), "parent": "rail.car", "base_m": BASE, "base_rpy_rad": TURN},
        "rail": {"model": str(folder / "rail.xml")},
        "positioner": {"model": str(folder / "table.xml"), "base_m": AT, "base_rpy_rad": TILT},
        "workpiece": part | {"parent": "positioner.table"},
    }
    hand = {
        "robot": {"model": str(GP50)},
        "tool": {"model": str(folder / "grinder.xml"), "base_m": TOOL_AT, "base_rpy_rad": TOOL_TURN},
        "workpiece": part | {"parent": "robot.tcp"},
    }
    of = f"{head}<worldbody>{{}}</worldbody>{tail}".format
    shipped = POSITIONER.read_text().replace(plate, plate + '<site name="part"/>')
    return {
        "positioner": Cell(job | {"robot": {"model": str(POSITIONER)}, "workpiece": part}, shipped),
        "rail": Cell(job | rail, of(on_rail)),
        "hand": Cell(job | hand, of(in_hand)),
    }


def compare(cell: Cell, folder: Path, count: int) -> tuple[list[Compared], Ring]:
    """Compare poses, Jacobians and every kind of distance at `count` configurations within the joint limits."""
    config = load_config(cell.job)
    robot = build.robot_of(config.robot, config.cell, config.tree)
    files = [cell_distances.write_cell(folder, box) for box in (cell_distances.SOLID, cell_distances.AS_MESH)]
    (fixed,), own = make_fixtures(robot, load_cell(files[0])), make_self_collision(robot)
    pairs, links = np.array(own.pairs), np.array(robot.capsule_link)
    is_standing = (links[pairs] == robot.world.link).any(axis=1)
    x = np.random.default_rng(0).uniform(robot.lower, robot.upper, (count, len(robot.slides)))
    *motion, shapes, between, to_world = _theirs(robot, cell.tree, files[1], fixed.names, pairs, x)
    both = zip(("pose", "Jacobian", "Jacobian of axes"), _motion(robot, jnp.asarray(x)), motion, strict=True)
    rows = [Compared(kind, float(np.abs(a - b).max()), len(x), 0, 0) for kind, a, b in both]
    ours = distances(robot, own.pairs, x)
    for kind, which in (("moving bodies", ~is_standing), ("bodies in the world", is_standing)):
        rows.append(compared(f"{kind}, {which.sum()} pairs", ours[:, which], between[:, which]))
    query = partial(minimum_clearance, robot, (own,), cell_distances.World(np.eye(4), np.zeros(4)))
    least = np.asarray(jax.jit(lambda x: jax.lax.map(query, x))(x))
    rows.append(compared("minimum clearance", least, between.min(axis=1)))
    at_part = np.asarray(cell_distances.shape_distances(robot, fixed, jnp.asarray(x)))
    rows += [compared(f"{name} on the part", at_part[:, k], shapes[:, k]) for k, name in enumerate(fixed.names)]
    return rows, _enclosed(robot, pairs, ours, to_world)


@jax.jit
def _motion(robot: Robot, x):
    """Return the TCP's poses in the part's frame, and the Jacobians of its position and of its axes."""

    def at(x):
        T, last = kinematics.tcp_pose(robot, x), len(robot.slides) - 1
        return T, kinematics.jacobian(robot, x), kinematics.direction_jacobians(robot, x, T[:3, :3].T, (last,) * 3)

    return jax.lax.map(at, x, batch_size=64)


def _theirs(robot: Robot, tree: str, shapes: Path, names, pairs, x) -> tuple[np.ndarray, ...]:
    """Return MuJoCo's poses, Jacobians, and distances to shapes on the part, of pairs, and to the shapes in the world.

    Fitted capsules of the shapes in the world are fixed to MuJoCo's world.
    """
    spec = mujoco.MjSpec.from_string(tree)
    asset = f'<asset><mesh name="wedge" vertex="{WEDGE}"/><mesh name="box" vertex="{cell_distances.BOX}"/></asset>'
    standing = f"<mujoco>{asset}<worldbody>{STANDING.format(cell_distances.AS_MESH)}</worldbody></mujoco>"
    spec.attach(mujoco.MjSpec.from_file(str(shapes)), prefix="part: ", frame=spec.worldbody.add_frame())
    spec.attach(mujoco.MjSpec.from_string(standing), prefix="world: ", frame=spec.worldbody.add_frame())
    columns, origin = np.array(robot.world.columns).T, np.array(robot.world.origin_m)
    for k in robot.attached:
        ends = [(np.asarray(end[k]) - origin) @ columns for end in (robot.capsule_p, robot.capsule_q)]
        size = [float(robot.capsule_radius[k]), 0, 0]
        name, kind = f"fit {robot.capsule_names[k]}", mujoco.mjtGeom.mjGEOM_CAPSULE
        spec.worldbody.add_geom(name=name, type=kind, fromto=np.concatenate(ends), size=size)
    spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-10, 500
    spec.compiler.boundmass = spec.compiler.boundinertia = 1e-9
    model = spec.compile()
    data, order = mujoco.MjData(model), [model.joint(name).id for name in robot.joint_names]
    assert model.nq == model.nv == model.njnt == len(order)
    mujoco.mj_kinematics(model, data)
    part, tcp, body = data.site("part"), data.site("tcp"), model.site("part").bodyid[0]
    on_part = [model.geom(f"part: {name}").id for name in names]
    rest_p, rest_R = data.geom_xpos[on_part].copy(), data.geom_xmat[on_part].reshape(-1, 3, 3).copy()
    fits = {robot.capsule_names[k] for k in robot.attached}
    bodies = [model.geom(f"fit {name}" if name in fits else name).id for name in robot.capsule_names]
    world = [model.geom(f"world: {name}").id for name in IN_WORLD]
    distance = partial(mujoco.mj_geomDistance, model, data)
    (vt, wt), (vp, wp) = np.zeros((2, 2, 3, model.nv))
    found = []
    for row in x:
        data.qpos[order] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        R, t, T = part.xmat.reshape(3, 3).copy(), part.xpos.copy(), np.eye(4)
        T[:3, :3], T[:3, 3] = R.T @ tcp.xmat.reshape(3, 3), R.T @ (tcp.xpos - t)
        mujoco.mj_jac(model, data, vt, wt, tcp.xpos, model.site("tcp").bodyid[0])
        mujoco.mj_jac(model, data, vp, wp, tcp.xpos, body)
        v, w = (R.T @ (a - b)[:, order] for a, b in ((vt, vp), (wt, wp)))
        data.geom_xpos[on_part], data.geom_xmat[on_part] = t + rest_p @ R.T, (R @ rest_R).reshape(-1, 9)
        turning = np.cross(w.T[None], T[:3, :3].T[:, None]).swapaxes(1, 2)
        of = [[[distance(a, b, FAR_M, None) for a in bodies] for b in others] for others in (on_part, world)]
        found.append((T, v, turning, of[0], [distance(bodies[a], bodies[b], FAR_M, None) for a, b in pairs], of[1]))
    return tuple(map(np.array, zip(*found, strict=True)))


def _enclosed(robot: Robot, pairs, ours: np.ndarray, theirs: np.ndarray) -> Ring:
    """Compare the clearances of the capsules about the shapes in the world with MuJoCo's to the shapes themselves."""
    off, wrong = [], 0
    for k, name in enumerate(IN_WORLD):
        fits = {a for a in robot.attached if robot.capsule_names[a].startswith(name)}
        for body in np.flatnonzero(np.array(robot.capsule_link) != robot.world.link):
            own = ours[:, [n for n, pair in enumerate(pairs) if body in pair and fits & set(pair)]].min(axis=1)
            exact = theirs[:, k, body]
            off.append((own - exact)[exact > 0])
            wrong += int(((own > 0) & (exact <= 0)).sum())
    off = np.concatenate(off)
    return Ring(float(-off.min()), float(off.max()), len(off), wrong)


def _placed(xml: str, position: tuple[float, ...], rpy: tuple[float, ...]) -> str:
    """Return elements in a frame of MJCF, turned about the parent's x, then y, then z."""
    turn = Rotation.from_euler("xyz", rpy).as_quat(scalar_first=True)
    return f'<frame pos="{" ".join(map(str, position))}" quat="{" ".join(map(str, turn))}">{xml}</frame>'
