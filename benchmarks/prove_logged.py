"""Case `logged` of `prove`: production paths of two cells, as their planner logged them.

The paths have waypoints of six joints, without times and without a model of the cell (valstad-shipworks/deke, commit
6152e2a, `deke-bench-retimers`, Apache-2.0). Of the arm the source states the chain of joints, used for both cells;
bodies and joint ranges are not published. Therefore a body here is the line from each joint's origin to the next one's,
as a capsule of 1 mm, and ranges are one turn to either side. The guaranteed clearance holds for any bodies: those that
stay within half of it around the lines do not touch each other, if their links are not adjacent.

A comment in the source describes a corrupted waypoint, joint 4 at about 16 rad. No published path has it, so it is
planted.
"""

import json
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np

from benchmarks.prove_reference import ChainArm, chain_arm, smallest
from benchmarks.prove_scenes import row
from benchmarks.prove_table import Table
from htcp_jax.errors import InputError
from htcp_jax.proving import prove_curves, prove_file, scene_of, straight
from htcp_jax.proving.prove import TIGHT
from htcp_jax.status import SegmentStatus

JOINTS = (  # origins [m] and roll, pitch, yaw [rad] in the frame of the joint before
    ((0, 0, 0.152), (0, 0, 0)),
    ((0.075, -0.105, 0.273), (-1.5708, 0, 0)),
    ((0, -0.84, 0.04028), (-3.14159, 0, 0)),
    ((0.295618, 0.215, -0.0642), (-3.14159, 1.5708, 0)),
    ((-0.0501976, 0.000491285, -1.0445), (-3.13181, 1.5708, 0)),
    ((0.075182, 0, -0.0507), (3.14159, 1.5708, 0)),
)
RADIUS_M, SAMPLES = 0.001, 2000
INERTIA = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'  # of the last link, which has no body
CORRUPTED, CORRUPTED_RAD = 3, 16.0  # number of the joint, and its value


def logged(data: Path, folder: Path) -> list[Table]:
    """Prove logged paths of six joints against the arm itself, and with a corrupted waypoint."""
    paths = json.loads((data / "deke_logged/logged_paths.json").read_text(encoding="utf-8"))["paths"]
    model = _arm(folder / "logged.xml")
    reference = chain_arm(mujoco.MjModel.from_xml_path(str(model)))
    job = {"robot": {"model": str(model)}, "cell": {"self_collision": True}}
    problem = scene_of(job).problem
    rows = []
    for cell in dict.fromkeys(path["robot"] for path in paths):
        chosen = [np.array(path["waypoints_rad"]) for path in paths if path["robot"] == cell]
        proofs = [prove_curves(problem, straight(x), kept=TIGHT) for x in chosen]
        verdicts = np.concatenate([proof.verdict for proof in proofs])
        proven = int((verdicts == SegmentStatus.VALID).sum())
        guaranteed = min(float(proof.guaranteed_m) for proof in proofs) + 2 * RADIUS_M
        true = min(_smallest(reference, x) for x in chosen) + 2 * RADIUS_M
        queries = sum(int(proof.queries.sum()) for proof in proofs)
        counts = str(len(chosen)), str(len(verdicts)), str(proven)
        rows.append((cell, *counts, f"{1e3 * guaranteed:.3f}", f"{1e3 * true:.3f}", f"{queries:,}"))
    head = "cell", "paths", "segments", "proven", "guaranteed mm", "true mm", "queries"
    corrupted = _corrupted_table([np.array(path["waypoints_rad"]) for path in paths], job, folder)
    title = "Logged paths; the distance between lines through the joints of links that are not adjacent"
    return [Table(title, head, rows), corrupted]


def _smallest(arm: ChainArm, x: np.ndarray) -> float:
    """Return the smallest distance between the arm's bodies on straight joint paths, by samples [m]."""
    return min(
        smallest(lambda s, a=a, b=b: a + s[:, None] * (b - a), arm.capsules_apart, SAMPLES)[0] for a, b in pairwise(x)
    )


def _corrupted_table(paths: list[np.ndarray], job: dict, folder: Path) -> Table:
    """Write every path with a corrupted waypoint in the middle, and count what becomes of it."""
    rows = []
    for title, suffix, header in (
        ("table whose header states rad", "csv", "_rad"),
        ("table without units", "csv", ""),
        ("array without units", "npy", None),
    ):
        results: dict[str, int] = {}
        for k, x in enumerate(paths):
            x, file = x.copy(), folder / f"path {k}{header or ''}.{suffix}"
            x[len(x) // 2, CORRUPTED] = CORRUPTED_RAD
            if header is None:
                np.save(file, x)
            else:
                names = [f"j{joint}{header}" for joint in range(1, x.shape[1] + 1)]
                np.savetxt(file, x, delimiter=",", header=",".join(names), comments="")
            try:
                found = prove_file(file, job)
                result = "position limit violated, exit code 1" if found.violated else found.verdict
            except InputError:
                result = "refused, exit code 2"
            results[result] = results.get(result, 0) + 1
        rows.append((title, str(len(paths)), "; ".join(f"{count}: {result}" for result, count in results.items())))
    return Table("Joint 4 of a waypoint at 16 rad", ("file", "files", "result"), rows)


def _arm(file: Path) -> Path:
    """Write the chain of joints, with lines as bodies, as an MJCF file."""
    origins = [origin for origin, _ in JOINTS]
    text, ends = _line("base", origins[0]), ""
    for k, (origin, angles) in enumerate(JOINTS, start=1):
        text += f'<body name="link{k}" pos="{row(origin)}" euler="{row(angles)}">'
        text += f'<joint name="j{k}" axis="0 0 1" range="{row((-2 * np.pi, 2 * np.pi))}"/>'
        text += _line(f"line{k}", origins[k]) if k < len(JOINTS) else '<site name="tcp"/>' + INERTIA
        ends += "</body>"
    compiler = '<compiler angle="radian" eulerseq="XYZ"/>'  # about fixed axes, as in a URDF
    file.write_text(f"<mujoco>{compiler}<worldbody>{text}{ends}</worldbody></mujoco>", encoding="utf-8")
    return file


def _line(name: str, end: tuple[float, ...]) -> str:
    return f'<geom name="{name}" type="capsule" size="{RADIUS_M}" fromto="0 0 0 {row(end)}"/>'
