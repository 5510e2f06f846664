"""Proof of the files that `htcp program` writes: they are read back by the readers of other programs, and proven."""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from htcp_jax.device import devices
from htcp_jax.errors import InputError
from htcp_jax.io.motions import MotionFile, controller_of, read_motion
from htcp_jax.proving.file_proof import motion_curves
from htcp_jax.proving.prove import MotionProof, prove_curves, tighten
from htcp_jax.proving.scene import scene_of
from htcp_jax.proving.worst import Contact, deepest_contact
from htcp_jax.status import SegmentStatus, UndecidedCause
from htcp_jax.system import output_files, temporary_folder
from htcp_jax.trajectory import FileMotion, PlanProgram, ProgramFile

ROUNDS = 4  # maximum number of times that corners are made exact
SHARE = 0.5  # share of the job's margin that a rounded corner must leave
Progress = Callable[[str], None]


class ProgramProof(NamedTuple):
    """Proof of a program's files."""

    motion: MotionFile  # the motion of all files, in order
    proof: MotionProof | None  # None: the format has poses only
    contact: Contact | None  # the deepest one on the first unproven segment; None if all is proven
    seconds: float  # time of reading, building the scene and proving

    @property
    def is_refuted(self) -> bool:
        """True if the motion collides."""
        return self.proof is not None and bool(self.proof.refuted)

    @property
    def is_undecided(self) -> bool:
        """True if the motion is neither proven nor refuted."""
        return self.proof is not None and not self.proof.proven and not self.proof.refuted

    @property
    def cause(self) -> UndecidedCause:
        """Cause for which the segment of the contact is undecided."""
        return UndecidedCause(int(self.proof.cause[self.contact.segment]) if self.is_undecided else 0)


def prove_program(
    made: PlanProgram,
    format: str,
    files: Sequence[ProgramFile],
    device: str | None = None,
    progress: Progress = lambda text: None,
) -> ProgramProof:
    """Prove or refute that the motion in a program's files is clear, as the controller runs it.

    Args:
        made: The program.
        format: Name of the format in `trajectory.FORMATS`.
        files: The texts of its files.
        device: The device; None: a GPU if there is one.
        progress: Function that is called with the current step as text.

    Raises:
        InputError: If a file cannot be read back.
    """
    began = time.perf_counter()
    progress("reading the file back")
    motion = read_back(made, format, files)
    if motion.poses is not None or len(motion.x) < 2:
        return ProgramProof(motion, None, None, time.perf_counter() - began)
    progress("building the scene of the proof")
    problem = scene_of(made.job, device=device).problem
    with devices.on(problem.devices[0]):
        curves = motion_curves(problem, motion)
        progress(f"proving the file's motion: 0 of {len(curves.segment):,} paths")
        proof = prove_curves(
            problem,
            curves,
            progress=lambda done, count: progress(f"proving the file's motion: {done:,} of {count:,} paths"),
        )
        progress("proving the guaranteed clearance more tightly")
        proof = tighten(problem, curves, proof)
        unproven = np.flatnonzero(proof.verdict != SegmentStatus.VALID)
        refuted = unproven[proof.verdict[unproven] != SegmentStatus.UNDECIDED]
        first = (refuted if len(refuted) else unproven)[:1].tolist()
        contact = deepest_contact(problem.without_covering_radius, curves, first[0]) if first else None
    return ProgramProof(motion, proof, contact, time.perf_counter() - began)


def prove_with_exact_corners(
    made: PlanProgram,
    format: str,
    name: str,
    file: FileMotion,
    files: Sequence[ProgramFile],
    device: str | None = None,
    progress: Progress = lambda text: None,
) -> tuple[list[ProgramFile], ProgramProof]:
    """Return a program's files and their proof; corners that need it are exact instead of rounded.

    These are corners that cannot be proven, and those with a guaranteed clearance of less than half of the job's
    margin. Only formats that round corners in shares of their legs (krl, ls) can be changed in this way.

    Args:
        made: The program.
        format: Name of the format in `trajectory.FORMATS`.
        name: Name of the program.
        file: The configurations, see `PlanProgram.in_file`.
        files: The files of these configurations, see `PlanProgram.files`.
        device: The device; None: a GPU if there is one.
        progress: Function that is called with the current step as text.

    Raises:
        InputError: If `PlanProgram.files` or `prove_program` raises it.
    """
    files, found = list(files), prove_program(made, format, files, device, progress)
    for _ in range(ROUNDS):
        if not len(corners := _corners_to_make_exact(made, found)):
            break
        blended = np.ones(len(file.timed.x)) if file.timed.blended is None else file.timed.blended.copy()
        blended[corners] = 0.0
        file = file._replace(timed=file.timed._replace(blended=blended))
        files = made.files(format, name, file)
        found = prove_program(made, format, files, device, progress)
    return files, found


def _corners_to_make_exact(made: PlanProgram, found: ProgramProof) -> Int[np.ndarray, "k"]:
    """Return the rows of rounded corners that cannot be proven, or only with less than half of the job's margin."""
    if found.proof is None or found.is_refuted or found.motion.corner_share is None:
        return np.zeros(0, int)
    narrow = found.proof.clearance_m < SHARE * made.job.segment_margin_m
    corners = np.flatnonzero((found.proof.cause == UndecidedCause.CORNER) | narrow) + 1
    return corners[(found.motion.corner_share[corners] > 0).any(axis=1)]


def read_back(made: PlanProgram, format: str, files: Sequence[ProgramFile]) -> MotionFile:
    """Return the motion that the readers of programs find in a program's files.

    Args:
        made: The program.
        format: Name of the format in `trajectory.FORMATS`.
        files: The texts of its files; parts are read in order, and a main file that only calls them is not read.
    """
    controller = controller_of(made.job, made.robot, of_model=format == "keyframes")
    parts = []
    with temporary_folder() as folder:
        for number, each in enumerate(each for each in files if len(each.rows)):
            path = folder / f"part{number}"
            output_files.write_text(path, each.text)
            parts.append(read_motion(path, made.robot, controller, format=format))
    return joined(parts)


def joined(parts: Sequence[MotionFile]) -> MotionFile:
    """Return the motion of parts that are run one after the other.

    Raises:
        InputError: If a part states other things than the first one.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    if any((each.interpolation, each.format) != (first.interpolation, first.format) for each in parts):
        raise InputError("the parts of the program differ in their format, so they cannot be read back")

    def stacked(name: str):
        found = [getattr(each, name) for each in parts]
        return None if any(each is None for each in found) else np.concatenate(found)

    names = ("x", "velocity", "acceleration", "corner_m", "line", "poses", "corner_share")
    return first._replace(**{name: stacked(name) for name in names}, time_s=None, kind=None)
