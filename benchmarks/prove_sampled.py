"""Case `sampled` of `prove`: motions that sampled checks call valid, and proofs refute.

Resolutions are the documented defaults of the tools. OMPL tests motions at 1 % of the space's extent
(`longest_valid_segment_fraction` 0.01); MoveIt's Setup Assistant writes 0.005 into `ompl_planning.yaml` (moveit pull
request 337), of an extent that is the sum of the joints' ranges. Tesseract's `CollisionCheckConfig` has the type
DISCRETE, which tests a program's own states alone, and a `longest_valid_segment_length` of 0.005 for its LVS types. Its
profile of Descartes tests no edges either (`enable_edge_collision`); planners with `path_check=none` do the same. The
geometry is the same for all, so that the differences are those of the resolutions. Drake has no default step. OMPL's
own motions are planned by RRTConnect and simplified, see `prove_ompl`.
"""

import json
import subprocess
import time
from collections.abc import Callable, Sequence
from itertools import product
from pathlib import Path

import fcl
import numpy as np
from jaxtyping import Bool, Float, Int

import htcp_jax
from benchmarks import prove_scenes as scenes
from benchmarks.prove_reference import ChainArm, smallest
from benchmarks.prove_table import Table
from htcp_jax.model import Robot
from htcp_jax.motion import Problem
from htcp_jax.motion.start_cause import clearances_at
from htcp_jax.proving import deepest_contact, prove_curves, scene_of, straight
from htcp_jax.status import SegmentStatus

POSES = tuple(product((0.2, 0.5, 0.8), (-0.3, 0.0, 0.3)))
METHODS = "baseline", "cspace-sample"
EDGES, LONGEST_RAD, SEED = 2000, 1.0, 3
DRAKE_STEPS = 0.05, 0.01
EXTENT_RAD = 2 * np.pi  # largest range of a joint that counts
ROOT = Path(__file__).resolve().parents[1]


def samples_of(robot: Robot, step: Float[np.ndarray, "m N"]) -> dict[str, Int[np.ndarray, "m"]]:
    """Return the numbers of equal parts between whose ends each tool tests segments, by its name."""
    ranges = np.minimum(np.asarray(robot.upper) - np.asarray(robot.lower), EXTENT_RAD)
    length, summed = np.linalg.norm(step, axis=1), np.abs(step).sum(axis=1)
    parts = {
        "ends alone (Tesseract DISCRETE)": 0 * length,
        "OMPL 1 %": length / (0.01 * np.linalg.norm(ranges)),
        "MoveIt 0.5 %": summed / (0.005 * ranges.sum()),
        "0.05 rad": length / 0.05,
        "Tesseract LVS 0.005": length / 0.005,
    }
    return {name: np.maximum(np.ceil(count), 1).astype(int) for name, count in parts.items()}


def sampled(data: Path, folder: Path, drake: str | None, ompl: str | None) -> list[Table]:
    """Compare sampled checks with proofs; without data, only on our own planners' motions."""
    tables = [_planned()]
    if (data / "drake_ccd").exists():
        tables += _shelf_tables(data / "drake_ccd", folder, drake, ompl)
    return tables


HEAD = "motions", "segments", "refuted", "resolution", "called valid", "refuted among them", "share %", "deepest mm"


def _rows(name: str, parts: Sequence[tuple[Problem, np.ndarray, np.ndarray]]) -> list[tuple[str, ...]]:
    """Return one row per resolution, for segments from a to b in some problems."""
    total, refuted, called, wrong, deepest = 0, 0, {}, {}, {}
    for problem, a, b in parts:
        curves = straight(np.stack([a, b], axis=1).reshape(-1, a.shape[1]))
        pairs = curves.segment[::2]  # without the steps from one segment's end to the next one's start
        curves = type(curves)(*(each[pairs] for each in curves))._replace(segment=np.arange(len(a)))
        bad = prove_curves(problem, curves, kept=0.0).verdict == SegmentStatus.IN_COLLISION
        depths: dict[int, float] = {}
        total, refuted = total + len(a), refuted + int(bad.sum())
        for tool, count in samples_of(problem.robot, b - a).items():
            valid = _valid(problem, a, b, count)
            missed = np.flatnonzero(valid & bad)
            for k in missed[:MEASURED].tolist():
                depths.setdefault(k, -deepest_contact(problem, curves, k).clearance_m)
            called[tool] = called.get(tool, 0) + int(valid.sum())
            wrong[tool] = wrong.get(tool, 0) + len(missed)
            deepest[tool] = max([deepest.get(tool, 0.0), *(depths[k] for k in missed[:MEASURED].tolist())])
    rows = []
    for tool, number in called.items():
        depth = f"{1e3 * deepest[tool]:.3f}" if wrong[tool] else ""
        share = f"{100 * wrong[tool] / max(number, 1):.2f}"
        rows.append((name, f"{total:,}", f"{refuted:,}", tool, f"{number:,}", f"{wrong[tool]:,}", share, depth))
    return rows


MEASURED = 100  # segments whose deepest contact is measured


def _valid(problem: Problem, a: np.ndarray, b: np.ndarray, parts: Int[np.ndarray, "m"]) -> Bool[np.ndarray, "m"]:
    """Return True for segments whose configurations at the ends of the equal parts are clear."""
    segment = np.repeat(np.arange(len(a)), parts + 1)
    number = np.arange(len(segment)) - np.repeat(np.cumsum(parts + 1) - parts - 1, parts + 1)
    s = number / parts[segment]
    clear = clearances_at(problem, a[segment] + s[:, None] * (b - a)[segment]) > 0
    found = np.ones(len(a), bool)
    np.logical_and.at(found, segment, clear)
    return found


# Our own planners


def _planned() -> Table:
    """Compare on motions of our own planners whose segments are tested at 20 samples, or at their ends alone."""
    rows = []
    for method, path_check in product(METHODS, ("all", "none")):
        parts = []
        for y, z in POSES:
            changes = {"workpiece.rotation_y_rad": y, "workpiece.rotation_z_rad": z, "method": method}
            changes |= {"settings.path_test": "samples", "settings.path_check": path_check}
            job = ROOT / "configs/paper.yaml"
            plans = htcp_jax.plan(job, changes).plans
            x = plans.x[0][plans.tracked[0]]
            if len(x) > 1:
                parts.append((scene_of(job, changes).problem, x[:-1], x[1:]))
        rows += _rows(f"`{method}`, path_check={path_check}", parts)
    return Table("Generated duct, nine poses, configs/paper.yaml with path_test=samples", HEAD, rows)


# Drake's arm


def _shelf_tables(data: Path, folder: Path, drake: str | None, ompl: str | None) -> list[Table]:
    file = scenes.without_meshes(data, folder)
    model, arm = scenes.imported(file, folder), scenes.reference_of(file)
    boxes = scenes.shelf(data, "10")
    cell = {"model": scenes.box_cell(boxes, folder / "shelf.xml"), "self_collision": True}
    problem = scene_of({"robot": {"model": str(model)}, "cell": cell}).problem
    edges = _edges(problem)
    rows = _rows("random edges of up to 1 rad, shelf", [(problem, *edges)])
    tables = [Table("iiwa 14 with 46 spheres", HEAD, rows), *_others(data, folder, file, arm, boxes, edges, drake)]
    return tables if ompl is None else [*tables, _ompl(ompl, data, folder, arm, boxes, problem)]


def _edges(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Return random edges between clear configurations, as a roadmap has them."""
    rng, lower, upper = np.random.default_rng(SEED), np.asarray(problem.robot.lower), np.asarray(problem.robot.upper)
    a = rng.uniform(lower, upper, (8 * EDGES, len(lower)))
    step = rng.normal(size=a.shape)
    step *= LONGEST_RAD * rng.uniform(0.1, 1, (len(a), 1)) / np.linalg.norm(step, axis=1, keepdims=True)
    b = np.clip(a + step, lower, upper)
    good = np.flatnonzero((clearances_at(problem, a) > 0) & (clearances_at(problem, b) > 0))[:EDGES]
    return a[good], b[good]


def _others(
    data: Path,
    folder: Path,
    file: Path,
    arm: ChainArm,
    shelf: scenes.Boxes,
    edges: tuple[np.ndarray, np.ndarray],
    drake: str | None,
) -> list[Table]:
    """Return sampled checks of FCL and Drake on the path into the shelf, and of Drake on random edges."""
    path = scenes.along(scenes.quintics(*scenes.waypoints(data)))
    shelves = {tier: scenes.shelf(data, tier) for tier in ("02", "00")}
    on_path = []
    for tier, boxes in shelves.items():
        shapes = [(fcl.Box(*(2 * half)), centre) for centre, half in zip(*boxes[1:], strict=True)]
        for number in PATH_SAMPLES:
            began = time.perf_counter()
            hits = _fcl_hits(arm, path(np.linspace(0, 1, number)), shapes)
            spent = 1e3 * (time.perf_counter() - began)
            on_path.append((f"{int(tier)} mm", "python-fcl", f"{number:,}", str(hits), f"{spent:.0f}"))
    on_edges = []
    if drake is not None:
        found = _drake(drake, folder, file, shelves, path, shelf, edges)
        name, count = f"Drake {found['version']}", len(edges[0])
        for key, one in found["paths"].items():
            tier = f"{int(key.split()[0])} mm"
            on_path.append((tier, name, f"{one['samples']:,}", str(one["collide"]), f"{one['ms']:.0f}"))
        for step, one in found["edges"].items():
            on_edges.append((name, f"edge_step_size {step} rad", f"{one['free']:,} of {count:,}", f"{one['ms']:.2f}"))
    tables = [Table("Path into the shelf by samples", ("tier", "checker", "samples", "in collision", "ms"), on_path)]
    head = "checker", "resolution", "called free", "ms each"
    return tables + ([Table("Random edges by samples", head, on_edges)] if on_edges else [])


PATH_SAMPLES = 601, 6001


def _fcl_hits(arm: ChainArm, x: np.ndarray, shapes: list[tuple[object, np.ndarray]]) -> int:
    """Return the number of configurations in which a moving sphere touches a shape, by FCL."""
    still = [fcl.CollisionObject(shape, fcl.Transform(np.asarray(place))) for shape, place in shapes]
    world = fcl.DynamicAABBTreeCollisionManager()
    world.registerObjects(still)
    world.setup()
    moving = np.flatnonzero(arm.link > 0)
    spheres = [fcl.CollisionObject(fcl.Sphere(arm.radius[k]), fcl.Transform()) for k in moving]
    bodies = fcl.DynamicAABBTreeCollisionManager()
    bodies.registerObjects(spheres)
    bodies.setup()
    hits = 0
    for at in arm.ends(x)[0][:, moving]:
        for sphere, centre in zip(spheres, at, strict=True):
            sphere.setTranslation(centre)
        bodies.update()
        found = fcl.CollisionData()
        bodies.collide(world, found, fcl.defaultCollisionCallback)
        hits += found.result.is_collision
    return hits


def _drake(
    python: str,
    folder: Path,
    file: Path,
    shelves: dict[str, scenes.Boxes],
    path: Callable[[np.ndarray], np.ndarray],
    shelf: scenes.Boxes,
    edges: tuple[np.ndarray, np.ndarray],
) -> dict:
    """Return the results of `prove_drake`, run by another interpreter."""
    paths = {
        f"{tier} {number}": {"x": path(np.linspace(0, 1, number)).tolist(), "boxes": _listed(boxes)}
        for tier, boxes in shelves.items()
        for number in PATH_SAMPLES
    }
    asked = {"a": edges[0].tolist(), "b": edges[1].tolist(), "boxes": _listed(shelf)}
    request = {"arm": str(file), "paths": paths, "edges": asked, "steps_rad": DRAKE_STEPS}
    return _run(python, "prove_drake.py", folder, request)


def _run(python: str, script: str, folder: Path, request: dict) -> dict:
    """Return the results of a script in another environment."""
    (folder / "request.json").write_text(json.dumps(request), encoding="utf-8")
    command = [python, str(Path(__file__).with_name(script)), str(folder / "request.json")]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def _listed(boxes: scenes.Boxes) -> list[list]:
    return [boxes.centre.tolist(), boxes.half.tolist()]


# OMPL


def _ompl(python: str, data: Path, folder: Path, arm: ChainArm, boxes: scenes.Boxes, problem: Problem) -> Table:
    """Plan by OMPL between random configurations, and from them into the shelf; prove the motions."""
    lower, upper = np.asarray(problem.robot.lower), np.asarray(problem.robot.upper)
    rng, (_, path) = np.random.default_rng(SEED), scenes.waypoints(data)
    draws = rng.uniform(lower, upper, (32 * MOTIONS, len(lower)))
    inside = path[rng.integers(len(path), size=32 * MOTIONS)]
    inside = np.clip(inside + rng.uniform(-JITTER_RAD, JITTER_RAD, inside.shape), lower, upper)
    draws, inside = (x[clearances_at(problem, x) > 0] for x in (draws, inside))
    ends = {
        "random to random": draws[: 2 * MOTIONS].reshape(MOTIONS, 2, -1),
        "random into the shelf": np.stack([draws[2 * MOTIONS : 3 * MOTIONS], inside[:MOTIONS]], axis=1),
    }
    request = {
        "links": [{**link._asdict(), "T": link.T.tolist(), "axis": link.axis.tolist()} for link in arm.links],
        "sphere_link": arm.link.tolist(),
        "sphere_centre": arm.p.tolist(),
        "sphere_radius": arm.radius.tolist(),
        "pairs": [each.tolist() for each in arm.pairs()],
        "box_centre": boxes.centre.tolist(),
        "box_half": boxes.half.tolist(),
        "ranges": [lower.tolist(), upper.tolist()],
        "ends": np.concatenate(list(ends.values())).tolist(),
    }
    found, rows = _run(python, "prove_ompl.py", folder, request), []
    for tool, motions in found["motions"].items():
        for k, name in enumerate(ends):
            planned = [np.array(x) for x in motions[k * MOTIONS : (k + 1) * MOTIONS] if x is not None]
            refuted, undecided, depths = 0, 0, []
            for x in planned:
                proof = prove_curves(problem, straight(x), kept=0.0)
                refuted, undecided = refuted + bool(proof.refuted), undecided + (not proof.proven and not proof.refuted)
                bad = np.flatnonzero(proof.verdict == SegmentStatus.IN_COLLISION).tolist()
                depths += [_depth(arm, boxes, x[segment], x[segment + 1]) for segment in bad]
            segments, share = sum(len(x) - 1 for x in planned), f"{100 * refuted / max(len(planned), 1):.1f}"
            depth = f"{1e3 * min(depths):.4f} to {1e3 * max(depths):.3f}" if depths else ""
            counts = f"{len(planned)} of {MOTIONS}", str(segments), str(refuted), share, str(undecided), depth
            rows.append((tool, name, *counts))
    head = "resolution", "motions", "planned and valid", "segments", "refuted", "share %", "undecided", "deep by mm"
    return Table(f"Motions of OMPL {found['version']}, RRTConnect and simplification, 10 mm tier", head, rows)


MOTIONS = 500
JITTER_RAD = 0.1


def _depth(arm: ChainArm, boxes: scenes.Boxes, a: np.ndarray, b: np.ndarray) -> float:
    """Return the depth of a straight motion's deepest contact by the reference [m]."""
    measures = lambda x: arm.to_boxes(x, *boxes[1:]), arm.to_itself
    return -min(smallest(lambda s: a + s[:, None] * (b - a), measure, 20_000)[0] for measure in measures)
