"""The program of a plan on record, as it is asked for: a feed in words, limits by two times."""

import re

from htcp_jax.errors import InputError
from htcp_jax.jobs.build import scene
from htcp_jax.planner.motion import motion
from htcp_jax.program.limits import FULL_ACCELERATION_S, FULL_SPEED_S, joint_limits
from htcp_jax.program.program import Program, program
from htcp_jax.program.stretches import spare
from htcp_jax.runs.open import PlanSet
from htcp_jax.scene.scenario import with_own_tool

UNITS = {"mm/s": 1e-3, "m/s": 1.0, "mm/min": 1e-3 / 60, "m/min": 1 / 60}  # in m/s
_FEED = re.compile(r"\s*([0-9.]+(?:e[+-]?[0-9]+)?)\s*(\S+)\s*", re.IGNORECASE)


def feed_of(text: str) -> float:
    """A feed in words, "20mm/s", in m/s. Raises InputError for one that is not above 0, or without a unit."""
    found = _FEED.fullmatch(text)
    unit = UNITS.get(found[2]) if found else None
    try:
        feed = float(found[1]) * unit if unit else 0.0
    except ValueError:
        feed = 0.0
    if not feed > 0:
        raise InputError(f"feed {text!r} is no speed above 0 with a unit, as 20mm/s is; units: {', '.join(UNITS)}")
    return feed


def program_of(
    found: PlanSet,
    feed_m_s: float,
    method: str | None = None,
    scenario: int = 0,
    *,
    retract: bool = True,
    full_speed_s: float = FULL_SPEED_S,
    full_acceleration_s: float = FULL_ACCELERATION_S,
) -> Program:
    """That of one plan, from home or the start to the last target, and back if `retract`.

    feed_m_s: of the TCP on the path [m/s]; method: the first one of the set where None; full_speed_s,
    full_acceleration_s: see `joint_limits` [s]. Raises InputError for a plan that is not executable to its end, and as
    `program` and `joint_limits` do.
    """
    plans = found.plans(found.methods[0] if method is None else method)
    end, job = plans.outcome(scenario), found.jobs[scenario]
    if not end.can_be_driven:
        why = end.way.message if end.executable < end.tracked else "the next one is not tracked"
        raise InputError(f"{found.folder}: a motion leads to {end.executable} of {end.targets} targets; {why}")
    robot, _, placed = scene(job)
    robot, placed = with_own_tool(robot, placed)
    limits = joint_limits(robot, full_speed_s, full_acceleration_s)
    whole = motion(plans, scenario, int(placed.on_path), retract=retract)
    return program(robot, whole, spare(plans, scenario, whole, job.settings.tube_m), limits, feed_m_s)
