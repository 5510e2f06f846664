"""The files of `htcp program`: their deviation from the program's motion, known limits of controllers, and writing."""

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from htcp_jax.errors import InputError, Note, mm_text
from htcp_jax.proving import ProgramProof
from htcp_jax.system import output_files
from htcp_jax.trajectory import (
    Deviation,
    FileMotion,
    PlanProgram,
    ProgramFile,
    exceeded_limits,
    points_needed,
    worst_deviation,
)

JOINED = {  # how players join configurations, see `trajectory.deviation`
    "linear": "joined linearly",
    "quintic": "joined by quintic splines",
    "straight": "joined on the proven straight joint paths",
}


def check_deviation(
    made: PlanProgram, format: str, file: FileMotion, found: list[Deviation], *, is_chosen: bool, is_allowed: bool
) -> None:
    """Check a file's deviation from the program's motion against the path's tolerance, `Settings.tube_m`.

    Args:
        made: The program.
        format: Name of the format.
        file: The configurations in the file.
        found: The file's deviations.
        is_chosen: True to warn of deviations off the path, too: the user chose the number of configurations.
        is_allowed: True to warn instead of raising InputError.

    Raises:
        InputError: If the deviation on the path exceeds the tolerance. The message names a sufficient --max-points.
    """
    tolerance_m = made.job.settings.tube_m
    if not found:
        return
    on_path, anywhere = worst_deviation(found), max(found, key=lambda each: each.tcp_m)
    if on_path.path_m > tolerance_m and not is_allowed:
        number = points_needed(made.robot, made.program, made.job, format)
        enough = "" if number is None else f"--max-points {number} or more, or "
        raise InputError(
            f"the {len(file.timed.x):,} configurations of the file, {JOINED[on_path.joined]}, deviate from the program "
            f"by {1e3 * on_path.path_m:.3g} mm on the path at {on_path.path_time_s:.2f} s; the path's tolerance "
            f"(settings.path_tolerance_m) is {1e3 * tolerance_m:g} mm; pass {enough}--allow-deviation"
        )
    if on_path.path_m > tolerance_m or (is_chosen and anywhere.tcp_m > tolerance_m):
        warnings.warn(
            f"the file deviates from the program by {1e3 * anywhere.tcp_m:.3g} mm at {anywhere.time_s:.2f} s, and by "
            f"{1e3 * on_path.path_m:.3g} mm on the path; the path's tolerance is {1e3 * tolerance_m:g} mm",
            stacklevel=1,
        )


def deviation_facts(made: PlanProgram, format: str, file: FileMotion, found: list[Deviation]) -> dict[str, str]:
    """Return the number of configurations in a file and its deviations as rows of a table of facts."""
    more = "; MOVL, which moves the TCP straight, is not measured" if format == "jbi" else ""
    facts = {"configurations": f"{len(file.timed.x):,} in the file"}
    for each in found:
        unit = "m" if made.robot.sliding[made.robot.joint_names.index(each.joint)] else "rad"
        tcp = f"{1e3 * each.tcp_m:.3g} mm of the TCP at {each.time_s:.2f} s, {1e3 * each.path_m:.3g} mm on the path"
        name = "deviation" if each is found[0] else f"deviation, {each.joined}"
        facts[name] = f"{tcp}; {each.joint_deviation:.3g} {unit} of {each.joint}; {JOINED[each.joined]}{more}"
    return facts


def deviation_records(found: list[Deviation]) -> dict[str, dict[str, float | str]]:
    """Return a file's deviations for JSON, by how its configurations are joined."""
    return {
        each.joined: {
            "tcp_mm": 1e3 * each.tcp_m,
            "time_s": each.time_s,
            "path_mm": 1e3 * each.path_m,
            "path_time_s": each.path_time_s,
            "joint": each.joint,
            "joint_deviation": each.joint_deviation,
        }
        for each in found
    }


def write_files(out: Path, files: list[ProgramFile]) -> dict[Path, range]:
    """Write a program's files, the main file last, and return their paths with the rows of their configurations."""
    paths = {out.with_name(f"{out.stem}{each.suffix}{out.suffix}"): each for each in reversed(files)}
    with output_files.made_folder(out.parent):
        for path, each in paths.items():
            output_files.write_text(path, each.text)
    return {path: each.rows for path, each in reversed(paths.items())}


def part_facts(written: dict[Path, range]) -> dict[str, str]:
    """Return the parts of a program as rows of a table of facts; nothing for a single file."""
    return {
        path.name: f"configurations {rows.start:,} to {rows.stop - 1:,}, called by the program in this order"
        for path, rows in written.items()
        if len(written) > 1 and len(rows)
    }


def note_limits(format: str, configurations: int, parts: int) -> None:
    """Warn in one line if a program is split, or exceeds publicly known limits of what reads its format."""
    if parts:
        what = f"the program has {configurations:,} configurations, more than one file of {format} may have"
        warnings.warn(f"{what}: it calls {parts} parts, which are files next to it", Note, stacklevel=1)
    if known := exceeded_limits(format, configurations):
        limits = ", ".join(f"{each.most:,} ({each.whose})" for each in known)
        what = f"{configurations:,} {known[0].what}; known limits: {limits}"
        warnings.warn(f"the file has {what}; pass --max-points if your controller has one", Note, stacklevel=1)


def refusal(proof: ProgramProof) -> str:
    """Return where a program's file is not proven to be clear, as one line."""
    contact, motion = proof.contact, proof.motion
    where = f"lines {motion.line[contact.segment]} to {motion.line[contact.segment + 1]}"
    moves = f"the motion of the file, {motion.interpolation} between its configurations"
    if proof.is_refuted:
        return f"{moves}, collides at {where}: {contact.text}"
    return f"{moves}, is undecided at {where}: {contact.text}; {proof.cause.message}"


def proof_facts(proof: ProgramProof) -> dict[str, str]:
    """Return the proof of a program's file as a row of a table of facts."""
    if proof.proof is None:
        return {"file's motion": "not proven: the file has poses; the motion between them is the controller's own"}
    count, took = len(proof.proof.verdict), f"read back and proven in {proof.seconds:.1f} s"
    if proof.is_undecided:
        return {"file's motion": f"undecided, {proof.cause.message}; {took}"}
    clear = f"guaranteed clearance {mm_text(float(proof.proof.guaranteed_m))}"
    between = f"{proof.motion.interpolation} between the configurations"
    return {"file's motion": f"proven, {clear} on {count:,} segments, {between}; {took}"}


def proof_record(proof: ProgramProof) -> dict[str, Any]:
    """Return the proof of a program's file for JSON."""
    found = proof.proof
    guaranteed_mm = np.nan if found is None else 1e3 * float(found.guaranteed_m)
    return {
        "verdict": "not proven" if found is None else "undecided" if proof.is_undecided else "proven",
        "interpolation": None if found is None else proof.motion.interpolation,
        "segments": 0 if found is None else len(found.verdict),
        "guaranteed_mm": guaranteed_mm if np.isfinite(guaranteed_mm) else None,
        "seconds": proof.seconds,
    }
