"""Tables of the report of one plan: phases of the cycle, angles, seams, joint limits, and program formats."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from htcp_jax.errors import InputError
from htcp_jax.model import Robot
from htcp_jax.report.document import Table
from htcp_jax.runs import Column, SeamOrder, columns
from htcp_jax.spec import TOOL_ANGLES, PlanConfig, ToolAxisRow
from htcp_jax.status import Kind
from htcp_jax.trajectory import FORMATS, UNCOUPLED, PlanProgram, limits_of_job, stated_limits

PLAIN = ".2f"
RATES = "velocity", "acceleration", "jerk"


def fact_table(name: str, facts: dict[str, str], heading: str = "") -> Table:
    """Return a table with a row for each fact, its label and its text."""
    return Table(
        name,
        (columns.column("fact")._replace(heading=heading or "item"), columns.column("value")),
        tuple(facts.items()),
    )


def phase_table(made: PlanProgram, names: Sequence[str]) -> Table:
    """Return the table of the phases of the cycle, in the order in which they begin; the last row is their sum.

    Args:
        made: The robot program.
        names: Names of the seams, in the order of work.
    """
    time, row = made.program.passes()
    kind, target = (each[row][1:] for each in (made.program.motion.kind, made.program.motion.target))
    seam = np.searchsorted(made.seam_begins, target, "right")
    begins, lasts = dict[str, float](), dict[str, float]()
    for k, seconds in enumerate(np.diff(time).tolist()):
        phase = _phase(Kind(kind[k]), int(target[k]), f"{'seam ' if len(names) > 1 else ''}{names[seam[k]]}")
        begins.setdefault(phase, float(time[k]))
        lasts[phase] = lasts.get(phase, 0.0) + seconds
    whole = made.program.duration_s
    rows = [(name, begins[name], last, 100 * last / whole) for name, last in lasts.items()]
    shown = columns.of("phase", "begin_s", "duration_s", "percent")
    return Table("phases", shown, (*rows, ("cycle", 0.0, whole, 100.0)))


def _phase(kind: Kind, target: int, seam: str) -> str:
    if kind == Kind.TRANSFER:
        return f"air move to {seam}" if target else "transfer to the first configuration"
    if kind == Kind.DWELL:
        return f"dwells on {seam}"
    return seam if kind == Kind.PROCESS else kind.words


def angle_table(
    rows: Sequence[tuple[slice, ToolAxisRow]], angles: Float[np.ndarray, "T 3"], names: Sequence[str]
) -> Table:
    """Return the table of the tool's angles, with their ranges over each seam, and what the task allows.

    Args:
        rows: Targets of each seam that limits the angles, and the row that limits them.
        angles: Work angle, travel angle and spin at each target [degrees]; NaN where unknown.
        names: Names of these seams, in the order of work.
    """
    made = []
    for name, (here, row) in zip(names, rows, strict=False):
        for k, key in enumerate(TOOL_ANGLES):
            known = angles[here, k]
            least, most = (float(reduce(known)) for reduce in (np.fmin.reduce, np.fmax.reduce))
            allowed = "free" if getattr(row, key) == "free" else " to ".join(f"{v:g}" for v in row.bounds_deg(key))
            made.append((name, key.removesuffix("_deg").replace("_", " "), least, most, allowed))
    shown = columns.of("seam", "angle", "smallest_deg", "largest_deg", "allowed")
    return Table("angles", shown, tuple(made))


def seam_table(order: SeamOrder, made: PlanProgram | None) -> Table:
    """Return the table of the seams in their order of work.

    Args:
        order: The order.
        made: The robot program; None: the feed is the job's.
    """
    feeds = {each.name: each.feed or "-" for each in order.visits}
    if made is not None:
        whole = made.program.feed_m_s
        feeds = {name: f"{1e3 * made.seam_feeds.get(name, whole):g} mm/s" for name in feeds}
    rows = [
        (
            each.name,
            each.direction,
            each.first,
            each.last,
            1e3 * each.clearance_m,
            1e3 * each.margin_m,
            feeds[each.name],
        )
        for each in order.visits
    ]
    shown = columns.of("seam", "direction", "first_target", "last_target", "guaranteed_mm", "margin_mm", "program_feed")
    return Table("seams", shown, tuple(rows))


def joint_table(robot: Robot, x: Float[np.ndarray, "n N"], made: PlanProgram | None) -> Table:
    """Return the table of the joints: range, range that the motion uses, and limits of the program.

    Args:
        robot: The robot.
        x: Configurations of the motion [rad or m].
        made: The robot program; None: no limits.
    """
    slides = np.asarray(robot.sliding)
    scale = np.where(slides, 1e3, np.degrees(1.0))
    ends = np.asarray(robot.lower), np.asarray(robot.upper), x.min(axis=0), x.max(axis=0)
    limits = [] if made is None else [np.broadcast_to(each, len(scale)) for each in made.limits]
    values = [np.where(np.isfinite(each), each, np.nan) * scale for each in (*ends, *limits)]
    units = ["mm" if slide else "deg" for slide in slides]
    rows = [(name, unit, *map(float, own)) for name, unit, *own in zip(robot.joint_names, units, *values, strict=True)]
    names = ["from", "to", "used from", "used to", *(RATES[: len(limits)])]
    per = ["", "", "", "", "per s", "per s2", "per s3"]
    shown = [Column(name.replace(" ", "_"), name, unit, ".1f") for name, unit in zip(names, per, strict=False)]
    return Table("joints", (*columns.of("joint", "measured_in"), *shown), tuple(rows))


def limit_sources(made: PlanProgram) -> str:
    """Return a sentence on the origin of the velocity, acceleration and jerk limits."""
    job = made.job.program
    stated = stated_limits(made.robot, job, limits_of_job(made.job, made.robot))
    assumed = {"acceleration": f"full speed in {job.full_speed_s:g} s"}
    assumed["jerk"] = f"full acceleration in {job.full_acceleration_s:g} s"
    file = made.job.robot.limits_file or "the arm's model"
    parts = []
    for kind in RATES:
        known = np.isfinite(getattr(stated, kind)).all()
        source = "the job" if getattr(job, kind) is not None else f"{file}" if known else f"assumed, {assumed[kind]}"
        parts.append(f"{kind}: {source}")
    return f"Limits that the program keeps; {'; '.join(parts)}."


def format_table(made: PlanProgram) -> Table:
    """Return the table of the program formats: configurations in the file, or the reason why there is none.

    The formats that a job with `program.coupled` cannot have are one row.
    """
    rows, uncoupled = [], made.job.program.coupled and [name for name in FORMATS if name in UNCOUPLED]
    for name, format in FORMATS.items():
        if uncoupled and name in uncoupled:
            continue
        step_ms = None if format.step_s is None else 1e3 * format.step_s
        try:
            timed = made.timed(name)
            made.controller(name, "plan", timed)
            if format.step_s is None:
                made.files(name, "plan", made.in_file(name))
            rows.append((name, step_ms, len(timed.x), f"htcp program --format {name}"))
        except InputError as error:
            rows.append((name, step_ms, None, f"not from this job: {error}"))
    if uncoupled:
        rows.append((", ".join(uncoupled), None, None, "not with program.coupled"))
    shown = (*columns.of("format", "interval_ms", "configurations", "written_by"),)
    return Table("formats", shown, tuple(rows))


def seam_names(job: PlanConfig) -> list[str]:
    """Return the names of a job's seams; of a single path, "the path"."""
    return [seam.name for seam in job.workpiece.seams] or ["the path"]
