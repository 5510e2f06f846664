"""Cases of `prove` with scenes whose truth is known: Drake's shelf, planted collisions, and thin walls."""

import time
from pathlib import Path

import jax
import mujoco
import numpy as np

from benchmarks import prove_scenes as scenes
from benchmarks.prove_reference import chain_arm, smallest
from benchmarks.prove_table import Table, counted, named
from htcp_jax.clearance import Scene
from htcp_jax.clearance.proof.bisection import Proof, initial_state
from htcp_jax.clearance.proof.joint_path import StraightPath
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M
from htcp_jax.clearance.proof.motion_proof import DEEPEST, query_on
from htcp_jax.motion import Problem
from htcp_jax.proving import JointCurves, MotionProof, deepest_contact, polynomials, prove_curves, scene_of, straight
from htcp_jax.spec import GP50
from htcp_jax.status import SegmentStatus

COPIES, SAMPLES = 1000, 100_000
WIRE = {"name": "wire", "p_m": [0, 0, 0], "q_m": [0, 0, 0.4], "radius_m": 0.001}
TOOL = {"tip_m": [0, 0, 0.4], "bodies": [WIRE]}
THIN_M, SLOT_M, RADIUS_M = 0.001, 0.003, 0.001


# Drake's shelf


def shelf(data: Path, folder: Path) -> list[Table]:
    """Prove Drake's path into a shelf in its four tiers, an edge of it, and jittered copies."""
    data = data / "drake_ccd"
    file = scenes.without_meshes(data, folder)
    model, arm = scenes.imported(file, folder), scenes.reference_of(file)
    t, q = scenes.waypoints(data)
    C = scenes.quintics(t, q)
    curves, path = polynomials(C), scenes.along(C)
    own = smallest(path, arm.to_itself, SAMPLES)[0]
    rows, copies = [], []
    for tier in scenes.TIERS:
        boxes = scenes.shelf(data, tier)
        problem = _shelf_problem(model, scenes.box_cell(boxes, folder / f"shelf {tier}.xml"))
        true = smallest(path, lambda x, boxes=boxes: arm.to_boxes(x, *boxes[1:]), SAMPLES)[0]
        rows.append(_tier(f"{int(tier)} mm, quintic path", problem, curves, min(true, own)))
        if tier == "10":
            edge, ends = straight(q[:2]), lambda s: q[0] + s[:, None] * (q[1] - q[0])
            least = min(
                smallest(ends, measure, SAMPLES)[0]
                for measure in (lambda x, boxes=boxes: arm.to_boxes(x, *boxes[1:]), arm.to_itself)
            )
            rows.append(_tier("10 mm, straight edge 0 to 1", problem, edge, least))
            copies = _copies(problem, polynomials(scenes.quintics(t, scenes.jittered(q, COPIES)).reshape(-1, 6, 7)))
    head = "scene", "verdict", "guaranteed mm", "true mm", "deepest contact um", "queries", "ms"
    return [
        Table(f"Drake's shelf; the arm's own smallest distance on the path is {1e3 * own:.3f} mm", head, rows),
        Table(f"{COPIES:,} copies, waypoints changed by up to 0.02 rad, tier 10 mm", COPY_HEAD, copies),
    ]


COPY_HEAD = "kept share", "proven motions", "refuted", "undecided", "queries", "s", "processor s"


def _shelf_problem(model: Path, cell: str) -> Problem:
    return scene_of({"robot": {"model": str(model)}, "cell": {"model": cell, "self_collision": True}}).problem


def _tier(name: str, problem: Problem, curves: JointCurves, true_m: float) -> tuple[str, ...]:
    prove_curves(problem, curves)  # compiles
    began = time.perf_counter()
    proof = prove_curves(problem, curves)
    spent = time.perf_counter() - began
    least = [deepest_contact(problem, curves, int(k)).clearance_m for k in np.flatnonzero(proof.verdict)]
    contact = f"{1e6 * min(least):.3f}" if least else ""
    guaranteed = "" if least else f"{1e3 * float(proof.guaranteed_m):.3f}"
    queries = int(proof.queries.sum())
    return name, named(proof), guaranteed, f"{1e3 * true_m:.4f}", contact, str(queries), f"{1e3 * spent:.1f}"


def _copies(problem: Problem, curves: JointCurves) -> list[tuple[str, ...]]:
    rows = []
    for kept in (0.5, 0.0):
        began, used = time.perf_counter(), time.process_time()
        proof = prove_curves(problem, curves, kept=kept)
        spent, used = time.perf_counter() - began, time.process_time() - used
        motions = proof.verdict.reshape(COPIES, -1)
        found = counted(MotionProof(motions, *(each.reshape(motions.shape) for each in _rest(proof))))
        rows.append((str(kept), *map(str, found), f"{proof.queries.sum():,}", f"{spent:.2f}", f"{used:.2f}"))
    return rows


def _rest(proof: MotionProof) -> tuple[np.ndarray, ...]:
    return proof.clearance_m, proof.place, proof.queries, proof.cause


# Planted collisions


def planted(count: int, folder: Path) -> list[Table]:
    """Prove motions that collide with, or miss, a ball between two of 1,000 samples."""
    spec = mujoco.MjSpec.from_file(str(GP50))
    flange = [each for each in spec.bodies if not each.bodies][-1]
    flange.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=_wire(spec), size=[WIRE["radius_m"], 0, 0])
    arm = chain_arm(spec.compile())
    far = planted_problem(scenes.ball_cell(np.array([0, 0, 50.0]), 0.001, folder / "far.xml"))
    limits = np.asarray(far.robot.lower), np.asarray(far.robot.upper)
    rng, rows = np.random.default_rng(0), []
    for kind, sign in (("collide", 1), ("miss", -1)):
        proofs, true, spent = [], [], 0.0
        for k, depth in enumerate(sign * scenes.depths(count, rng)):
            one = scenes.plant(arm, limits, depth, rng)
            problem = planted_problem(scenes.ball_cell(one.centre, one.radius, folder / f"{kind} {k}.xml"))
            began = time.perf_counter()
            proofs.append(prove_curves(problem, straight(np.stack([one.a, one.b])), kept=0.0))
            spent += time.perf_counter() - began if k else 0.0
            true.append(abs(one.true_m))
        verdicts = np.concatenate([each.verdict for each in proofs])
        proven, refuted = (
            int((verdicts == SegmentStatus.VALID).sum()),
            int((verdicts == SegmentStatus.IN_COLLISION).sum()),
        )
        queries = np.mean([each.queries[0] for each in proofs]) if proven else np.nan
        by = f"{1e3 * min(true):.3f} to {1e3 * max(true):.3f}"
        numbers = str(count), by, str(refuted), str(proven), str(count - proven - refuted)
        rows.append((kind, *numbers, f"{queries:.0f}" if proven else "", f"{1e3 * spent / max(count - 1, 1):.1f}"))
    head = "motions that", "number", "by mm", "refuted", "proven", "undecided", "queries each", "ms each"
    return [Table("A ball of 1 to 12 mm between two of 1,000 samples, GP50 with a wire of 2 mm", head, rows)]


def _wire(spec: mujoco.MjSpec) -> np.ndarray:
    """Return the ends of the wire in the frame of the flange's body."""
    site = spec.sites[0]
    model = spec.compile()
    T = np.empty(9)
    mujoco.mju_quat2Mat(T, model.site_quat[0])
    return np.concatenate([model.site_pos[site.id], model.site_pos[site.id] + 0.4 * T.reshape(3, 3)[:, 2]])


def planted_problem(cell: str) -> Problem:
    """Return the scene of the GP50 with a wire, and a cell."""
    robot = {"model": "gp50", "tool": TOOL}
    return scene_of({"robot": robot, "cell": {"model": cell, "self_collision": False}}).problem


# Thin walls


def slot(folder: Path) -> list[Table]:
    """Move a tool of radius 1 mm through a plate of 1 mm, and through a slot of 3 mm in it; count all queries."""
    rows = []
    for name, axis in TOOLS.items():
        arm = folder / f"slide {axis[0]}.xml"
        arm.write_text(SLIDE.format(*axis), encoding="utf-8")
        for wall, half_gap in (("plate of 1 mm", 0.0), ("slot of 3 mm in it", SLOT_M / 2)):
            problem, (a, b) = slot_problem(arm, half_gap, folder), SLIDES
            raw = raw_proof(problem, a, b)
            proof = prove_curves(problem, straight(np.stack([a, b])), kept=0.0)
            true = f"{1e3 * (half_gap - RADIUS_M):.1f}"
            verdicts = SegmentStatus(int(raw.verdict)).name, SegmentStatus(int(proof.verdict[0])).name
            rows.append((f"{name} {wall}", true, *verdicts, str(int(raw.queries)), f"{float(raw.place):.6f}"))
    head = "motion", "true mm", "bisection", "prove_curves", "queries", "place"
    return [Table("A tool of radius 1 mm through thin walls; required: 60 queries", head, rows)]


TOOLS = {  # ends of the tool's axis
    "across, through the": (0.0, -0.15, 0.0, 0.15),
    "point first, 0.2 m deep into the": (-0.3, 0.0, 0.0, 0.0),
}
SLIDES = np.array([[-0.3, 0, 0], [0.413, 0, 0]])  # of a motion through the plate at x = 0.213 [m]
SLIDE = """<mujoco><worldbody><body><joint name="x" type="slide" axis="1 0 0" range="-1 1"/>
<body><joint name="z" type="slide" axis="0 0 1" range="-1 1"/><body><joint name="r" axis="0 1 0" range="-3 3"/>
<geom name="tool" type="capsule" fromto="{} {} 0 {} {} 0" size="0.001"/><site name="tcp"/>
</body></body></body></worldbody></mujoco>"""


def slot_problem(arm: Path, half_gap_m: float, folder: Path) -> Problem:
    """Return the scene of a sliding tool and a plate at x = 0.213 with a slot along y about z = 0; 0: no slot."""
    geoms = [
        f'<geom name="plate {k}" type="box" pos="0.213 0 {side * (0.5 + half_gap_m)}" size="{THIN_M / 2} 0.5 0.5"/>'
        for k, side in enumerate((-1, 1))
    ]
    cell = folder / f"plate {half_gap_m}.xml"
    cell.write_text(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>", encoding="utf-8")
    return scene_of({"robot": {"model": str(arm)}, "cell": {"model": str(cell), "self_collision": False}}).problem


def raw_proof(problem: Problem, a: np.ndarray, b: np.ndarray) -> Proof:
    """Return the bisection of a straight joint path, whose queries are counted also if it is refuted."""
    scene = Scene(problem.robot, problem.obstacles)
    where = jax.tree.map(lambda leaf: leaf[0], problem.scenarios)

    def run(a: np.ndarray, b: np.ndarray) -> Proof:
        query = query_on(scene, where, StraightPath(a, b), None, -ROUNDING_M, np.int64(DEEPEST), 0.0)
        return jax.lax.while_loop(
            lambda search: search.going, lambda search: query(search, None)[0], initial_state()
        ).proof

    return jax.device_get(jax.jit(run)(a, b))
