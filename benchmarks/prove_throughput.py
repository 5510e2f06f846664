"""Case `throughput` of `prove`: thousands of motions at once, on a CPU or a GPU."""

import time
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks import prove_scenes as scenes
from benchmarks.prove_table import Table
from htcp_jax.motion import Problem
from htcp_jax.motion.start_cause import clearances_at
from htcp_jax.proving import JointCurves, prove_curves, scene_of, straight
from htcp_jax.status import SegmentStatus

SEGMENTS, STEP_RAD, CLEAR_M = 100, 0.05, 0.02  # of a motion; largest joint step of a segment; clearance of its goals
SOLIDS, SEED, RUNS = 20, 1, 3
GANTRY = """<mujoco><worldbody><geom name="beam" type="capsule" fromto="0 -2 -0.2 0 2 -0.2" size="0.1"/>
<body><joint name="x" type="slide" axis="1 0 0" range="-0.3 0.3"/>
<body name="carriage"><joint name="y" type="slide" axis="0 1 0" range="-0.3 0.3"/>
<geom name="carriage" type="capsule" fromto="-0.2 0 -0.1 0.2 0 -0.1" size="0.05"/>
</body></body></worldbody></mujoco>"""
KINDS = {"box": "0.08 0.1 0.12", "sphere": "0.1", "cylinder": "0.06 0.15", "capsule": "0.05 0.2"}


def throughput(data: Path, folder: Path, motions: int) -> list[Table]:
    """Prove random motions of the GP50 on a gantry (eight joints), in the duct and between 20 solids."""
    problem = _problem(data, folder)
    curves = _curves(_motions(problem, motions))
    prove_curves(problem, JointCurves(*(part[:200] for part in curves)))  # compiles
    rows = []
    for kept in (0.5, 0.0):
        spent = []
        for _ in range(RUNS):
            began = time.perf_counter()
            proof = prove_curves(problem, curves, kept=kept)
            spent.append(time.perf_counter() - began)
        count, seconds, proven = len(proof.verdict), min(spent), int((proof.verdict == SegmentStatus.VALID).sum())
        refuted = f"{int((proof.verdict == SegmentStatus.IN_COLLISION).sum()):,}"
        figures = f"{seconds:.2f}", f"{1e6 * seconds / count:.1f}", f"{count / seconds:,.0f}"
        rows.append((str(kept), f"{count:,}", f"{proven:,}", refuted, *figures))
    head = "kept share", "segments", "proven", "refuted", f"s, best of {RUNS}", "us a segment", "segments a second"
    points = f"{len(problem.workpiece.cloud):,} points"
    return [Table(f"{motions:,} motions of {SEGMENTS} segments, eight joints, {points}, {SOLIDS} solids", head, rows)]


def _problem(data: Path, folder: Path) -> Problem:
    rng = np.random.default_rng(SEED)
    (folder / "gantry.xml").write_text(GANTRY, encoding="utf-8")
    geoms = []
    for k in range(SOLIDS):
        kind = list(KINDS)[k % len(KINDS)]
        angle, away, height, *turns = rng.uniform([0, 1.4, -0.3, 0, 0], [2 * np.pi, 2.2, 2.0, 90, 90])
        place = scenes.row(np.array([away * np.cos(angle), away * np.sin(angle), height]))
        turned = f'euler="{scenes.row(np.array(turns))} 0"'
        geoms.append(f'<geom name="solid {k}" type="{kind}" size="{KINDS[kind]}" pos="{place}" {turned}/>')
    cell = {"model": scenes.cell(geoms, folder / "solids.xml"), "self_collision": True}
    job = {"rail.model": str(folder / "gantry.xml"), "robot.parent": "rail.carriage", "cell": cell}
    if (measured := data / "duct").exists():
        inlet = {"workpiece.inlet_m": [0, 0, 0.19138], "workpiece.path": str(measured / "weld.csv")}
        pose = {"pivot_m": [1.73205679, -0.0037799, 0.57539635], "rotation_y_rad": 0.4, "rotation_z_rad": 0.1}
        pose |= {"neutral_translation_m": [1.24549547, -0.0037799, 0.87525497]}
        job |= {"workpiece.cloud": str(measured / "cloud.xyz"), **inlet}
        job |= {f"workpiece.{key}": value for key, value in pose.items()}
    return scene_of(job).problem


def _motions(problem: Problem, motions: int) -> Float[np.ndarray, "M n N"]:
    """Return motions between random clear configurations, with equal steps of the joint that moves most."""
    rng = np.random.default_rng(SEED)
    lower, upper = np.maximum(problem.robot.lower, -3.1), np.minimum(problem.robot.upper, 3.1)
    drawn = rng.uniform(lower, upper, (8000, len(lower)))
    goals = drawn[clearances_at(problem, drawn) > CLEAR_M]
    x = np.empty((motions, SEGMENTS + 1, len(lower)))
    for motion in x:
        at, goal = goals[rng.integers(0, len(goals), 2)]
        for k in range(SEGMENTS + 1):
            motion[k] = at
            while (largest := np.abs(goal - at).max()) < STEP_RAD:
                goal = goals[rng.integers(len(goals))]
            at = at + STEP_RAD * (goal - at) / largest
    return x


def _curves(x: Float[np.ndarray, "M n N"]) -> JointCurves:
    """Return the straight joint paths of all motions."""
    paths = straight(x.reshape(-1, x.shape[-1]))
    inside = np.arange(len(paths.segment)) % x.shape[1] < x.shape[1] - 1  # without the steps between motions
    return JointCurves(*(part[inside] for part in paths))._replace(segment=np.arange(inside.sum()))
