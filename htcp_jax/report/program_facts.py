"""Facts of a robot program as text, and the table of its feed drops, for `htcp program` and the report of a plan."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from htcp_jax.report.document import Table
from htcp_jax.runs import columns
from htcp_jax.spec import PlanConfig
from htcp_jax.status import Kind
from htcp_jax.trajectory import PeakTorque, Program, ProgramFigures

STOP = "stop"  # reason for a feed drop to 0: the arm stops


def facts_of(found: ProgramFigures, seam_feeds: Mapping[str, float]) -> dict[str, str]:
    """Return the duration, the feed and the largest shares of the limits as text by label.

    Args:
        found: The program's figures.
        seam_feeds: Feed rate of each seam [m/s]; empty if all are equal.
    """
    parts = ", ".join(f"{kind} {seconds:.2f} s" for kind, seconds in found.seconds.items())
    held = f"held within 1 % over {100 * found.held_share:.2f} % of {1e3 * found.path_m:.1f} mm"
    if found.reason is not None:
        held += f"; {1e3 * found.reached_m_s:.3g} mm/s reached everywhere, limited by {found.reason}"
    feeds = ", ".join(f"{1e3 * feed:g} mm/s on {name}" for name, feed in seam_feeds.items())
    facts = {"duration": f"{found.duration_s:.2f} s: {parts}"}
    facts["feed"] = f"{feeds or f'{1e3 * found.feed_m_s:g} mm/s'}, {held}"
    for each in found.shares:
        facts[each.limit] = f"{100 * each.share:.1f} % of the limit at most, {each.joint} at {each.time_s:.2f} s"
    return facts


def drop_table(found: ProgramFigures, manipulability: Float[np.ndarray, "T"]) -> Table:
    """Return a table with one row per feed drop, with the smallest manipulability between its targets [m/rad].

    Args:
        found: The program's figures.
        manipulability: Manipulability at all targets [m/rad].
    """
    rows = []
    for drop in found.drops:
        low, high = sorted((drop.first_target, drop.last_target))
        own = float(np.fmin.reduce(manipulability[low : high + 1]))
        rows.append((1e3 * drop.begin_m, 1e3 * drop.end_m, 1e3 * drop.feed_m_s, drop.target, own, drop.reason))
    shown = columns.of("begin_mm", "end_mm", "feed_mm_s", "target", "manipulability_m_rad", "reason")
    return Table("feed_drops", shown, tuple(rows))


def torque_text(found: PeakTorque | None) -> str:
    """Return the largest joint torque as text.

    Args:
        found: The largest torque; None: unknown.
    """
    if found is None:
        return "omitted: the model has no inertias, or placeholders (all links have the same mass)"
    share, at = found.share, f"{found.joint} at {found.time_s:.2f} s"
    at = f"{abs(found.torque):.4g} N m (N if prismatic) at most, {at}"
    return f"{100 * share:.1f} % of the effort limit, {at}" if share else f"{at}; no effort limit"


def near_part(job: PlanConfig) -> dict[str, str]:
    """Return the speed near the part as text by label; empty at full speed."""
    program = job.program
    if program.near_part_speed == 1:
        return {}
    speed = f"at most {100 * program.near_part_speed:g} % of full joint speed"
    return {"near the part": f"{speed} within {1e3 * program.near_part_m:g} mm of it, before and after the path"}


def way_back(job: PlanConfig, program: Program) -> dict[str, str]:
    """Return a line if the program goes back through the configurations of the path; empty otherwise."""
    if len(job.workpiece.seams) > 1 or Kind.RETRACT not in program.motion.kind:
        return {}
    return {"way back": "the same configurations in reverse, over the path again; --one-way leaves it out"}
