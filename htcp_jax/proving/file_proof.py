"""Prove the motion in a file: `htcp_jax.prove_file("motion.csv", "cell.yaml")`.

The file is read by `io.motions`, which also determines how the controller moves between its configurations. The result,
a `FileProof`, has one verdict per segment, the deepest contacts, the use of the joints' limits, and the deviation from
the job's path.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from htcp_jax.clearance import Obstacle
from htcp_jax.clearance.obstacles import CLOSE_M
from htcp_jax.device import devices
from htcp_jax.errors import InputError
from htcp_jax.io.motions import MotionFile, controller_of, read_motion
from htcp_jax.io.motions import polynomials as polynomials_of
from htcp_jax.model import Robot
from htcp_jax.motion import Problem, start_cause
from htcp_jax.proving.curves import JointCurves, corners, corners_in_shares, polynomials
from htcp_jax.proving.motion_limits import LimitUse, limit_uses
from htcp_jax.proving.path_deviation import (
    PathDeviation,
    has_path,
    near_path_m,
    path_deviation,
    pose_deviation,
    tcp_positions,
)
from htcp_jax.proving.prove import KEPT, MotionProof, check_margin, prove_within, tighten, tracking_of, with_margin
from htcp_jax.proving.scaled_errors import ErrorScale, error_scale
from htcp_jax.proving.scene import Cell, ProofScene, build_scene, inputs_of
from htcp_jax.proving.seam_proofs import SeamProof, SeamSegments, seam_segments
from htcp_jax.proving.stated_errors import Errors, error_set, read_errors
from htcp_jax.proving.worst import Contact, deepest_contacts, first_contact
from htcp_jax.spec import ErrorsConfig, ObstacleKind, TaskRowKind
from htcp_jax.status import SegmentStatus

MOST_CONTACTS = 200  # refuted and undecided segments of which the deepest contact is measured
MOST_MEASURED = 2000  # paths at whose begin the clearance is measured
WITHOUT_LIMITS = "the joint limits are not checked, as the file has no joint values"
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class FileProof:
    """Proof of the motion in a file; m segments lead from each of its configurations to the next."""

    file: Path
    scene: ProofScene  # where it is proven
    motion: MotionFile
    robot: str  # its name
    joints: tuple[str, ...]  # names of its N coordinates
    sliding: tuple[bool, ...]  # True for sliding joints
    margin_m: float  # required clearance, except on seams with their own
    tracking: Float[np.ndarray, "N"]  # largest distance of each joint from the motion [rad or m]
    curves: JointCurves | None  # joint paths; None: the file has no joint values
    proof: MotionProof | None  # verdicts of the m segments; None: the file has no joint values
    contacts: Mapping[int, Contact]  # deepest contact found, by segment
    limits: tuple[LimitUse, ...]
    deviation: PathDeviation | None  # None: no path, or no configuration near it
    near_m: float | None  # distance within which configurations count as on the job's path [m]; None: no path
    seconds: float  # time of reading, building the scene and proving [s]
    errors: ErrorsConfig | None = None  # errors of which the largest proven scale is stated; None: none
    error_scale: ErrorScale | None = None  # it; None: no errors, or the motion is not proven
    seam_segments: SeamSegments | None = None  # seams of the segments; None: one seam, or no joint values
    # where a refuted motion first collides or, if it never does, is first below the margin; None: it is not refuted
    first: Contact | None = None
    # D at the begin of each of the p paths of `curves`, and at the end of the last one, to the points on meshes [m];
    # NaN: not measured; None: no joint values
    measured_m: Float[np.ndarray, "p+1"] | None = None

    @property
    def seams(self) -> tuple[SeamProof, ...]:
        """Proof of each seam that the motion follows, of a job with several seams."""
        known = self.seam_segments is not None and self.proof is not None
        return self.seam_segments.proofs(self.proof) if known else ()

    def required_m(self, segment: int) -> float:
        """Return the required clearance on a segment [m]; 0: any above 0."""
        own = 0.0 if self.seam_segments is None else float(self.seam_segments.required_m[segment])
        return max(self.margin_m, own)

    @property
    def most_recorded_m(self) -> float | None:
        """Largest clearance that is recorded for convex pieces [m]; None for an arm without pieces."""
        own = [] if self.seam_segments is None else self.seam_segments.required_m.tolist()
        problem = self.scene.problem
        margin_m = max(self.margin_m, float(problem.scenarios.margin_m[0]), *own)
        return None if problem.robot.pieces is None else margin_m + CLOSE_M

    @property
    def verdict(self) -> str:
        """The verdict on the motion: "proven", "refuted", "undecided" or "not proven"."""
        if self.proof is None:
            return "not proven"
        return "proven" if self.proof.proven else "refuted" if self.proof.refuted else "undecided"

    @property
    def guaranteed_m(self) -> float:
        """Guaranteed clearance of the motion [m]; NaN if it is not proven, infinite without obstacles."""
        return float("nan") if self.proof is None else float(self.proof.guaranteed_m)

    @property
    def violated(self) -> tuple[LimitUse, ...]:
        """Violated limits."""
        return tuple(use for use in self.limits if use.is_violated)

    @property
    def moved_on_seams(self) -> tuple[str, ...]:
        """Names of indexed axes that move along the path, where they must stand still."""
        axes = () if self.deviation is None else self.deviation.indexed
        return tuple(axis.joint for axis in axes if axis.segment is not None)

    @property
    def counted(self) -> str:
        """Unit of `motion.line`: "line", "row", "point" or "key"."""
        return self.motion.counted

    def time_at(self, segment: int, share: float) -> float | None:
        """Return the time at a share of a segment [s]; None if the file has no times."""
        if (times := self.motion.time_s) is None:
            return None
        return float(times[segment] + share * (times[segment + 1] - times[segment]))


def prove_file(
    file: str | Path,
    cell: Cell = None,
    *,
    format: str | None = None,
    unit: str | None = None,
    joints: Sequence[str] = (),
    interpolation: str | None = None,
    obstacles: Sequence[Obstacle | ObstacleKind | Mapping[str, Any]] = (),
    task: Sequence[TaskRowKind | Mapping[str, Any]] | None = None,
    overrides: Sequence[str] | Mapping[str, Any] = (),
    margin_m: float | None = None,
    tracking_rad: float | Sequence[float] = 0.0,
    tracking_m: float | None = None,
    errors: Errors | None = None,
    kept: float = KEPT,
    device: str | None = None,
    progress: Progress = lambda what, done, count: None,
) -> FileProof:
    """Prove or refute that the motion in a file is clear, as its controller runs it.

    Args:
        file: A trajectory or a robot program; `htcp_jax.io.motions.MOTION_FORMATS` lists the formats.
        cell: A robot, or a job: a file, the name of an example, a mapping; None: the default job.
        format: Name of the format; None: by the file's ending and content.
        unit: Unit of angles, "deg" or "rad"; None: as the file or its format states.
        joints: Names in the file of the robot's joints, in the order of `robot.joint_names`; empty: the robot's names.
        interpolation: "linear", "cubic" or "quintic"; None: as the format's controller interpolates.
        obstacles: Obstacles in addition to the job's.
        task: Task rows that replace the job's.
        overrides: Changes to the job, see `htcp_jax.plan`.
        margin_m: Required clearance, on all of the motion [m]. None: any above 0; if a seam of the job has a margin of
            its own, each seam's own, or else the job's, along the seams.
        tracking_rad: Largest distance of each joint from the motion, as by a servo's lag [rad or m]; one value, or one
            per joint.
        tracking_m: The same for prismatic joints [m]; required if there are any and `tracking_rad` is one value.
        errors: Half-widths of errors, in place of the job's: a YAML file, or a mapping with its keys. The proof
            then also has the largest factor by which all of them can be multiplied while the motion stays proven.
        kept: Share of the clearance that the proof guarantees, see `htcp_jax.prove`.
        device: The device; None: a GPU if there is one.
        progress: Function that is called with the current step as text, and the numbers of finished and all parts.

    Returns:
        Verdicts, contacts, limits and deviation from the path.

    Raises:
        InputError: If the file, the job or an argument is invalid.
    """
    began, file = time.perf_counter(), Path(file)
    least_m = 0.0 if margin_m is None else margin_m
    check_margin(least_m)
    stated = None if errors is None else read_errors(errors)
    inputs = inputs_of(cell, overrides, obstacles=obstacles, task=task, device=device)
    job, robot = inputs.job, inputs.robot
    # The file is read first, as building the scene can take minutes.
    data = () if job is None else (controller_of(job, robot, of_model=format in (None, "keyframes")),)
    how = {"format": format, "unit": unit, "interpolation": interpolation, "joints": joints}
    found = read_motion(file, robot, *data, **how)
    if found.poses is None and len(found.x) < 2:
        raise InputError(f"{file} has one configuration; a motion has two or more")
    lag = _tracking(robot, tracking_rad, tracking_m)
    scene = build_scene(inputs, device)
    problem = scene.problem
    stated = job.errors if stated is None and job is not None else stated
    numbers = None if stated is None else error_set(problem, job, stated)
    about = {
        "file": file,
        "scene": scene,
        "motion": found,
        "robot": problem.robot.name,
        "joints": problem.robot.joint_names,
    }
    about["near_m"] = near_path_m(problem) if scene.has_part and has_path(problem) else None
    about |= {"sliding": problem.robot.sliding, "margin_m": least_m, "tracking": lag, "errors": stated}
    with devices.on(problem.devices[0]):
        if found.poses is not None:
            deviation = pose_deviation(problem, found.poses[:, :3, 3]) if scene.has_part else None
            seconds = time.perf_counter() - began
            return FileProof(
                **about, curves=None, proof=None, contacts={}, limits=(), deviation=deviation, seconds=seconds
            )
        curves = motion_curves(problem, found)
        by_seam = seam_segments(scene, found, margin_m)
        margins = least_m if by_seam is None else np.maximum(by_seam.required_m, least_m)
        problem = with_margin(problem, np.max(margins))
        progress("paths", 0, len(curves.segment))
        proof = prove_within(
            problem,
            curves,
            lag,
            margin_m=margins,
            kept=kept,
            progress=lambda done, count: progress("paths", done, count),
        )
        proof = tighten(problem, curves.within(lag), proof, margin_m=margins, kept=kept)
        scale = None
        if numbers is not None and proof.proven:
            scale = error_scale(
                problem,
                curves.within(lag),
                numbers,
                margin_m=least_m,
                progress=lambda done, count: progress("intervals with errors", done, count),
            )
        unproven = np.flatnonzero(proof.verdict != SegmentStatus.VALID)
        # Refuted segments come before undecided ones.
        unproven = unproven[np.argsort(proof.verdict[unproven] == SegmentStatus.UNDECIDED, kind="stable")]
        # Of a proven motion, the bodies at its guaranteed clearance are named.
        smallest = [int(proof.clearance_m.argmin())] if proof.proven and np.isfinite(proof.guaranteed_m) else []
        of_points = problem.without_covering_radius
        start, measured = _first_refuted(proof), problem if proof.proven else of_points
        chosen = smallest or sorted({*unproven[:MOST_CONTACTS].tolist(), *([] if start is None else [start])})
        contacts = deepest_contacts(measured, curves, chosen, lambda done, count: progress("contacts", done, count))
        contacts_by = {each.segment: each for each in contacts}
        first = None
        if start is not None:
            required = float(np.broadcast_to(margins, len(proof.verdict))[start])
            limit_m = 0.0 if proof.verdict[start] == SegmentStatus.IN_COLLISION else required
            first = first_contact(measured, curves, start, limit_m) or contacts_by[start]
        x = np.vstack([curves.coefficients[:, 0], curves.coefficients[-1].sum(axis=0)])
        measured_m = np.full(len(x), np.nan)
        rows = np.unique(np.linspace(0, len(x) - 1, min(len(x), MOST_MEASURED)).round().astype(int))
        measured_m[rows] = start_cause.clearances_at(of_points, x[rows])
        limits = limit_uses(problem.robot, polynomials_of(found), found.time_s, job)
        deviation = _deviation(scene, curves, found)
    return FileProof(
        **about,
        curves=curves,
        proof=proof,
        contacts=contacts_by,
        limits=limits,
        deviation=deviation,
        seconds=time.perf_counter() - began,
        error_scale=scale,
        seam_segments=by_seam,
        first=first,
        measured_m=measured_m,
    )


def _first_refuted(proof: MotionProof) -> int | None:
    """Return the first segment in collision or, if there is none, below the margin; None without such segments."""
    for status in (SegmentStatus.IN_COLLISION, SegmentStatus.BELOW_MARGIN):
        if (proof.verdict == status).any():
            return int((proof.verdict == status).argmax())
    return None


def _tracking(robot: Robot, tracking_rad: float | Sequence[float], tracking_m: float | None) -> Float[np.ndarray, "N"]:
    """Return the largest distance of each joint from the motion [rad or m].

    Raises:
        InputError: For invalid values, and if the one for sliding joints is missing.
    """
    lag, slides = tracking_of(tracking_rad, robot.dof), np.asarray(robot.sliding, bool)
    if np.ndim(tracking_rad) or not slides.any() or not lag.any():
        return lag
    if tracking_m is None:
        names = ", ".join(name for name, slide in zip(robot.joint_names, slides, strict=True) if slide)
        raise InputError(f"tracking of the sliding joints {names} is missing: pass a length, too, as in 0.1deg,0.2mm")
    return np.where(slides, tracking_of(tracking_m, robot.dof), lag)


def motion_curves(problem: Problem, motion: MotionFile) -> JointCurves:
    """Return the joint paths that a motion's controller may take.

    Args:
        problem: The problem, see `scene_of`.
        motion: The motion; its configurations are joint values, not poses.
    """
    if motion.corner_share is not None:
        return corners_in_shares(motion.x, motion.corner_share)
    if motion.corner_m is not None and (motion.corner_m > 0).any():
        return corners(motion.x, motion.corner_m, lambda x: tcp_positions(problem, x))
    return polynomials(polynomials_of(motion))


def _deviation(scene: ProofScene, curves: JointCurves, motion: MotionFile) -> PathDeviation | None:
    if not scene.has_part:
        return None
    return path_deviation(scene.problem, curves, motion.x, motion.kind, scene.tasks)
