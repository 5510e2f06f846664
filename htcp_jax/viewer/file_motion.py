"""Replays of motions in files: the motion is displayed like a plan, whose targets are the TCP's positions."""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.errors import InputError
from htcp_jax.io.parts import NoCloud, load_workpiece
from htcp_jax.model import Robot, Scenario, Workpiece
from htcp_jax.model import robot as robots
from htcp_jax.motion import Plans, start_cause
from htcp_jax.proving import FileProof, proof_record
from htcp_jax.spec import PlanConfig
from htcp_jax.status import SegmentStatus, Status
from htcp_jax.trajectory import tcp_at
from htcp_jax.viewer.replay import Replays, ShownFile, replays_of

BETWEEN = 4  # displayed configurations between the ends of a curved segment
METHOD = "file"  # in place of the planning method's name


class _PlayedFile(NamedTuple):
    """A motion as `replay.PlannedJob` requires it."""

    job: PlanConfig
    robot: Robot
    workpiece: Workpiece
    scenario: Scenario
    plans: Plans


def replays_of_file(found: FileProof) -> Replays:
    """Return the replays of a file's motion; each row has the clearance there and the verdict on the segment to it.

    Args:
        found: The proof of the file.

    Raises:
        InputError: If the file has only poses, or if it was proven for a robot without a job.
    """
    scene = found.scene
    if found.proof is None or found.curves is None:
        raise InputError(f"{found.file} has poses only; a file with joint values can be played")
    if scene.job is None:
        raise InputError(f"{found.file} can be played in the cell of a job, not for a robot alone")
    rows, segment, share = _configurations(found)
    verdict, bound = found.proof.verdict[segment], found.proof.clearance_m[segment]
    verdict[0], bound[0] = SegmentStatus.VALID, np.inf
    problem = scene.problem
    scenario = jax.tree.map(lambda leaf: leaf[0], problem.scenarios)
    tcp = tcp_at(robots.lengthen_tool(problem.robot, float(scenario.tool_extension_m)), rows)[0]
    plans = Plans.empty(rows[:1], tcp[None])
    for name, values in {
        "x": rows,
        "tcp": tcp,
        "status": int(Status.TRACKED),
        "clearance": start_cause.clearances_at(problem, rows),
        "residual": 0.0,
        "joint_step": np.append(0.0, np.linalg.norm(np.diff(rows, axis=0), axis=1)),
        "segment_status": verdict,
        "segment_clearance": bound,
    }.items():
        getattr(plans, name)[0] = values
    job = scene.job.model_copy(update={"method": METHOD, "start_rad": "auto"})  # without targets before the path
    part = problem.workpiece if scene.has_part else _dots(tcp)
    played = _PlayedFile(job, problem.robot, part, scenario, plans)
    return replays_of(found.file.name, played, _shown(found, segment, share))


def _configurations(
    found: FileProof,
) -> tuple[Float[np.ndarray, "T N"], Int[np.ndarray, "T"], Float[np.ndarray, "T"]]:
    """Return the configurations to display: those of the file, some of curves, and those of the deepest contacts.

    Returns:
        The configurations, the segment that leads to each, and its place there as a share of the segment; the first
        one is at the begin of segment 0.
    """
    motion, proof, curves = found.motion, found.proof, found.curves
    assert proof is not None and curves is not None
    inner = [] if motion.interpolation == "linear" else (np.arange(1, BETWEEN + 1) / (BETWEEN + 1)).tolist()
    rows = [(motion.x[0], 0, 0.0)]
    for k, verdict in enumerate(proof.verdict.tolist()):
        more = [(np.polynomial.polynomial.polyval(s, curves.coefficients[k]), k, s) for s in inner]
        if verdict != SegmentStatus.VALID and (contact := found.contacts.get(k)) is not None and 0 < contact.place < 1:
            more.append((contact.x, k, contact.place))
        rows += [*sorted(more, key=lambda row: row[2]), (motion.x[k + 1], k, 1.0)]
    x, segment, share = zip(*rows, strict=True)
    return np.stack(x), np.array(segment), np.array(share)


def _shown(found: FileProof, segment: Int[np.ndarray, "T"], share: Float[np.ndarray, "T"]) -> ShownFile:
    """Return the proof as texts for the displayed configurations."""
    line, places, segments = found.motion.line.tolist(), [], []
    for k, s in zip(segment.tolist(), share.tolist(), strict=True):
        lines = proof_record.lines_of(found, k)
        is_end = s in (0, 1)
        places.append(f"{found.counted} {line[k + int(s)]}" if is_end else f"{lines}, {100 * s:.0f} % of the way")
        segments.append(f"{lines.capitalize()}: {proof_record.segment_text(found, k)}.")
    segments[0] = "The motion begins here."
    decisive, first, mark = proof_record.decisive_segment(found), 0, ""
    contact = None if decisive is None else found.contacts.get(decisive)
    if decisive is not None and contact is not None:
        clear = f"{1e3 * contact.clearance_m:.3g} mm clear"
        mark = f"{proof_record.lines_of(found, decisive)}: "
        mark += clear if contact.clearance_m > 0 else f"{contact.depth} deep"
        if found.verdict != "proven":
            first = int(np.abs(segment + share - (decisive + contact.place)).argmin())
    nearest = None if contact is None else contact.x
    headline = "; ".join(filter(None, (proof_record.headline(found), proof_record.second_line(found))))
    texts = headline, tuple(places), tuple(segments)
    return ShownFile(*texts, first, nearest, mark, found.scene.has_part)


def _dots(points: Float[np.ndarray, "n 3"]) -> Workpiece:
    """Return a workpiece of no walls whose path consists of points, world [m]."""
    home = {"pivot": np.zeros(3), "neutral_translation": np.zeros(3), "origin": (0.0, 0.0, 0.0)}
    return load_workpiece(NoCloud(), points, **home)
