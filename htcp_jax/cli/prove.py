"""`htcp prove`: prove that the motion in a trajectory or program of any tool is clear, segment by segment."""

import math
import time
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.text import Text

from htcp_jax.clearance.obstacles import KEEP_OUT, THE_WORKPIECE
from htcp_jax.cli.motion_options import Format, Interpolation, Joints, Unit, joint_names
from htcp_jax.cli.output import (
    Device,
    Json,
    Overrides,
    claim_device,
    print_facts,
    print_json,
    print_table,
    progress_bar,
    stdout,
)
from htcp_jax.cli.quantities import ANGLES, LENGTHS, quantity
from htcp_jax.proving import FileProof, IndexedTravel, proof_record, prove_file, seams_text
from htcp_jax.report import Table, draw_proof
from htcp_jax.runs import failure_texts
from htcp_jax.status import UndecidedCause
from htcp_jax.system import output_files

LISTED = 10  # maximum number of groups of segments on the terminal
MOST_SEAMS = 8  # seams with their clearance, on the terminal
MOST_MISSED = 5  # names of points that are not visited, on the terminal
STYLES = {"proven": "bold green", "refuted": "bold red", "undecided": "bold yellow", "not proven": "bold yellow"}

File = Annotated[Path, typer.Argument(metavar="FILE", help="Trajectory or robot program.")]
Job = Annotated[Path, typer.Option(metavar="JOB.yaml", help="Job file or example: the robot, its tool and the cell.")]
Margin = Annotated[
    str | None,
    typer.Option(
        metavar="LENGTH",
        help="Required clearance on all of the motion, such as 1mm. By default any above 0; if a seam has a margin_m "
        "of its own, each seam's margin along the seam.",
    ),
]
Tracking = Annotated[
    str | None,
    typer.Option(
        metavar="ANGLE",
        help="Largest distance of each joint from the file's motion, at any time, such as 0.1deg: the servo's lag, or "
        "any other deviation. The arm is proven clear wherever the joints are within it. By default 0. With sliding "
        "joints an angle and a length: 0.1deg,0.2mm.",
    ),
]
Errors = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.yaml",
        help="Half-widths of errors of the part's pose, the tool, the joints and the cloud, in place of the job's "
        "section errors. Prints the largest factor by which all of them can be multiplied.",
    ),
]
Out = Annotated[Path, typer.Option(metavar="DIR", help="Output folder.")]


def prove(
    file: File,
    job: Job,
    format: Format = None,
    unit: Unit = None,
    joints: Joints = None,
    interpolation: Interpolation = None,
    margin: Margin = None,
    tracking: Tracking = None,
    errors: Errors = None,
    overrides: Overrides = None,
    out: Out = Path("out/prove"),
    device: Device = None,
    as_json: Json = False,
) -> int:
    """Prove or refute that the motion in a file of any tool is clear in the cell of a job, segment by segment.

    Reads trajectories (CSV, ROS, NumPy, MuJoCo key frames) and robot programs with joint targets (RAPID, KRL, LS,
    URScript, Yaskawa pulses), and moves between their configurations as their controllers do. A proof holds for every
    point of the motion, not for samples. Writes proof.json, segments.parquet (one row per segment) and proof.png.

    Also reported: joint limits, and where the job has a path, the distance of the TCP from it; for a job with several
    seams, the guaranteed clearance on each.

    Exit codes: 0 if all segments are proven, 1 if one is refuted, a joint limit is violated or an indexed axis moves
    along the path, 4 if none is refuted but some are undecided or cannot be proven, or the motion is not proven for the
    errors stated, 2 on bad input.

    \b
    Examples:
      htcp prove program.mod --job cell.yaml
      htcp prove trajectory.csv --job cell.yaml --unit deg --margin 1mm
      htcp prove trajectory.csv --job cell.yaml --joints J1,J2,J3,J4,J5,J6
      htcp prove trajectory.yaml --job cell.yaml --tracking 0.1deg --out out/proof
      htcp prove trajectory.csv --job cell.yaml --errors errors.yaml
    """
    began = time.perf_counter()
    margin_m = None if margin is None else quantity("--margin", margin, LENGTHS, "1mm")
    angle, length = _tracking(tracking)
    claim_device(device)
    with output_files.written_whole(out) as folder:
        with progress_bar("paths", first="reading the file and building the scene") as progress:

            def show(what: str, done: int, count: int) -> None:
                text = "" if what == "paths" else f" proven; {what}"
                progress(done, count, text if done else f"{text}; compiling")

            found = prove_file(
                file,
                job,
                format=format,
                unit=unit,
                joints=joint_names(joints),
                interpolation=interpolation,
                overrides=overrides or (),
                margin_m=margin_m,
                tracking_rad=angle,
                tracking_m=length,
                errors=errors,
                device=device,
                progress=show,
            )
            proof_record.write_proof(folder, found)
            if found.proof is not None:
                draw_proof(folder / proof_record.PICTURE, found)
    if as_json:
        print_json(proof_record.record_of(found))
    else:
        _print_proof(found, out, time.perf_counter() - began)
    return proof_record.exit_code(found)


def _tracking(text: str | None) -> tuple[float, float | None]:
    """Return the tracking error of revolute joints [rad], and of sliding joints [m]; None if it is not set.

    Raises:
        InputError: See `quantity`.
    """
    if text is None:
        return 0.0, 0.0
    angle, comma, length = text.partition(",")
    return (
        quantity("--tracking", angle, ANGLES, "0.1deg"),
        quantity("--tracking", length, LENGTHS, "0.1deg,0.2mm") if comma else None,
    )


def _print_proof(found: FileProof, out: Path, seconds: float) -> None:
    text = proof_record.headline(found)
    stdout().print(Text.assemble((found.verdict, STYLES[found.verdict]), text.removeprefix(found.verdict)))
    if deepest := proof_record.second_line(found):
        stdout().print(Text(deepest))
    if found.violated:
        names = ", ".join(f"{use.quantity} of {use.joint}" for use in found.violated)
        stdout().print(Text.assemble(("limit violated", "bold red"), f": {names}"))
    if found.moved_on_seams:
        stdout().print(Text.assemble(("indexed axis moves", "bold red"), f": {', '.join(found.moved_on_seams)}"))
    stdout().print()
    if (table := unproven_table(found)).rows:
        print_table(stdout(), table)
        if (more := len(proof_record.unproven_groups(found)) - LISTED) > 0:
            stdout().print(f"and {more:,} more; segments.parquet has all")
        stdout().print()
    print_facts(f"{found.robot}: {found.file.name}", _facts(found, seconds) | {"files": str(out)})


def _facts(found: FileProof, seconds: float) -> dict[str, str]:
    motion, tracking = found.motion, found.tracking
    facts = {
        "segments": f"{len(motion.line) - 1:,}: "
        + ", ".join(f"{n:,} {word}" for word, n in proof_record.counts(found).items()),
        "format": f"{motion.format}, {_motion_text(found)}",
    }
    notes = list(motion.notes)
    if motion.interpolation == "linear" and motion.velocity is not None and found.proof is not None:
        notes.append("The file has velocities; --interpolation cubic proves the curve that keeps them.")
    if notes:
        facts["notes"] = " ".join(notes)
    facts |= found.scene.checked
    has_own = any(each.margin_m for each in found.seams) and not found.margin_m
    facts["required"] = (
        f"clearance {'of' if found.margin_m else 'above'} {1e3 * found.margin_m:g} mm"
        f"{'; on each seam its margin' if has_own else ''}"
    )
    if found.most_recorded_m is not None:
        facts["recorded"] = f"the clearance of convex pieces up to {1e3 * found.most_recorded_m:g} mm"
    workpiece = found.scene.problem.workpiece
    if found.proof is not None and workpiece.covering_radius_m:
        least_m = float(found.guaranteed_m) if found.proof.proven else math.inf
        as_above = ";" if found.proof.proven else ", as the distances above; for a proof"
        facts["measured"] = f"to points on the part's mesh{as_above} {failure_texts.subtracted(workpiece, least_m)}"
    if any(each.other == KEEP_OUT for each in found.contacts.values()):
        facts["keep-out zone"] = (
            "outside the part's convex hull, deeper than interior_depth_m behind the inlet: a rule, not a wall; "
            "--set workpiece.interior=none leaves it out"
        )
    facts |= _denser_mesh(found)
    if found.seams:
        facts["on seams"] = seams_text(found.seams, MOST_SEAMS)
    if tracking.any():
        sizes = zip(tracking.tolist(), found.sliding, strict=True)
        texts = [f"{1e3 * off:.4g} mm" if slides else f"{math.degrees(off):.4g} deg" for off, slides in sizes]
        facts["tracking"] = f"joints within {' or '.join(dict.fromkeys(texts))} of the motion"
    if text := proof_record.errors_text(found):
        facts["errors"] = text
    for quantity_ in dict.fromkeys(use.quantity for use in found.limits):
        uses = [proof_record.limit_text(use) for use in found.limits if use.quantity == quantity_]
        facts[f"{quantity_} limits" if quantity_ == "position" else quantity_] = "; ".join(uses)
    facts |= _deviation_facts(found)
    queries = 0 if found.proof is None else int(found.proof.queries.sum())
    return facts | {"time": f"{seconds:.1f} s; {queries:,} intervals checked"}


def _denser_mesh(found: FileProof) -> dict[str, str]:
    """Return lines about denser points on the part's mesh, if these may decide a segment or the scale of the errors."""
    scale, proof, workpiece = found.error_scale, found.proof, found.scene.problem.workpiece
    if proof is None:
        return {}
    undecided = [found.contacts[k] for k in np.flatnonzero(proof.cause == UndecidedCause.MESH_POINTS).tolist()
                 if k in found.contacts and found.contacts[k].other == THE_WORKPIECE]  # fmt: skip
    if undecided:
        spare_m = min(each.clearance_m - found.required_m(each.segment) for each in undecided)
        return failure_texts.denser_mesh(workpiece, workpiece.covering_radius_m - spare_m)
    if scale is None or scale.segment is None or scale.scale >= 1 or not scale.cover_m:
        return {}
    spare_m = float(proof.clearance_m[scale.segment]) - found.margin_m
    return failure_texts.denser_mesh(workpiece, scale.lack_m(spare_m))


def _motion_text(found: FileProof) -> str:
    motion = found.motion
    if found.proof is None:
        return "poses of the TCP"
    rounded = motion.corner_m is not None and (motion.corner_m > 0).any()
    times = "no times" if motion.time_s is None else f"{motion.time_s[-1] - motion.time_s[0]:.4g} s"
    return f"{motion.interpolation} interpolation in the joints{', rounded corners' if rounded else ''}, {times}"


def _deviation_facts(found: FileProof) -> dict[str, str]:
    if (deviation := found.deviation) is None:
        if found.near_m is None:
            return {}
        return {"path": f"not compared: no configuration is within {1e3 * found.near_m:g} mm of the job's path"}
    if found.proof is None:  # the numbers are those of poses
        first, last, k = (int(found.motion.line[k]) for k in (deviation.first, deviation.last, deviation.segment))
        worst, compared = f"line {k}", f"lines {first} to {last}"
        places = "at the poses"
    else:
        worst = proof_record.lines_of(found, deviation.segment)
        compared, places = proof_record.lines_of(found, deviation.first, deviation.last), "at sampled places"
    facts = {
        "path deviation": f"{1e3 * deviation.distance_m:.3g} mm on {worst}, {places} "
        f"(tolerance {1e3 * deviation.tolerance_m:g} mm)",
    }
    if deviation.length_m:
        covered = 100 * deviation.covered_m / deviation.length_m
        facts["path covered"] = f"{covered:.1f} % of {1e3 * deviation.length_m:.4g} mm, compared on {compared}"
    if deviation.points:
        count = f"{deviation.points - len(deviation.missed)} of {deviation.points}"
        names = [found.scene.job.workpiece.seams[k].name for k in deviation.missed] if found.scene.job else []
        lacking = f"; not {', '.join(names[:MOST_MISSED])}" if names else ""
        more = f" and {len(names) - MOST_MISSED} more" if len(names) > MOST_MISSED else ""
        facts["points visited"] = f"{count}, within {1e3 * (found.near_m or 0.0):g} mm{lacking}{more}"
    if deviation.indexed:
        facts["indexed axes"] = "; ".join(_indexed_text(found, axis) for axis in deviation.indexed)
    rows = []
    for row in deviation.rows:
        size = f"{math.degrees(row.error):.3g} deg" if row.is_angle else f"{1e3 * row.error:.3g} mm"
        rows.append(f"{row.row}: {size}")
    return facts | ({"task rows": "; ".join(rows) + ", at sampled places"} if rows else {})


def _indexed_text(found: FileProof, axis: IndexedTravel) -> str:
    """Return the travel of an indexed axis as text."""
    if axis.segment is None:
        return f"{axis.joint} stands still along the path"
    size = f"{1e3 * axis.travel:.3g} mm" if axis.slides else f"{math.degrees(axis.travel):.3g} deg"
    return f"{axis.joint} moves by up to {size} on {proof_record.lines_of(found, axis.segment)}"


def unproven_table(found: FileProof) -> Table:
    """Return the table of refuted and undecided segments.

    Consecutive segments with the same result are one group, which has a row for each of its deepest pairs of bodies.
    """
    line, rows = found.motion.line, []
    groups = proof_record.unproven_groups(found)
    for group in groups[:LISTED]:
        row = {f"{found.counted}s": f"{line[group.first]} to {line[group.last + 1]}", "verdict": group.verdict.words}
        row |= {"cause": group.cause.words or None}
        pairs = proof_record.worst_pairs(found, group)
        for contact in pairs:
            time_s = found.time_at(contact.segment, contact.place)
            place = {"deepest": f"{line[contact.segment]} to {line[contact.segment + 1]}", "place_s": time_s}
            place |= {"place_percent": 100 * contact.place if time_s is None else None}
            rows.append(row | place | {"contact": contact.text})
        rows += [] if pairs else [row]
    keys = f"{found.counted}s", "verdict", "cause", "deepest", "place_percent", "place_s", "contact"
    return Table.of("unproven", keys, rows).without_empty()
