"""Assumptions of a plan, and facts that it does not check, for the report of one plan."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from htcp_jax.clearance import Obstacles
from htcp_jax.clearance.obstacles import SelfCollision
from htcp_jax.model import Robot, Workpiece
from htcp_jax.model import robot as robots
from htcp_jax.motion import Plans
from htcp_jax.report import program_facts
from htcp_jax.runs import plan_folder
from htcp_jax.spec import PlanConfig, label_of
from htcp_jax.trajectory import PlanProgram

MOST_PAIRS = 30  # more pairs are counted, not named


def assumptions(job: PlanConfig, robot: Robot, workpiece: Workpiece, place: str) -> dict[str, str]:
    """Return what the plan assumes, as text by label.

    Args:
        job: The job.
        robot: The robot.
        workpiece: The workpiece.
        place: Text with the workpiece's pose.
    """
    settings, between = job.settings, "and between them" if job.margin_on == "segments" else "only"
    seams = {f"margin on {each.name}": f"{1e3 * each.margin_m:g} mm" for each in job.workpiece.seams if each.margin_m}
    tool, source = job.robot.tool, job.tree or job.robot.file
    arm = "the built-in GP50" if source is None else label_of(source).name
    tip = "as in the model"
    if job.tool.model is not None:
        tip = f"mounted by the job: {job.tool.model}"
    elif tool is not None:
        tip = f"mounted by the job: tip at ({_numbers(tool.tip_m)}) m in the flange's frame"
    if job.robot.tool_extension_m:
        tip += f", longer by {1e3 * job.robot.tool_extension_m:g} mm"
    begin = {"home": job.home_rad, "start": job.start}
    return {
        "margin": f"{1e3 * job.margin_m:g} mm, at the targets {between}",
        **seams,
        "margin before the path": f"{1e3 * job.transfer_margin_m:g} mm where possible",
        "tolerance": f"TCP {1e3 * settings.tolerance_m:g} mm at a target, {1e3 * settings.tube_m:g} mm between "
        f"targets; angles {np.degrees(settings.tolerance_rad):.3g} deg",
        "task": _task(job.task),
        **{f"task on {each.name}": _task(each.task) for each in job.workpiece.seams if each.task},
        "arm": f"{robot.name}, from {arm}",
        "tool": tip,
        **{name: _angles(robot, x) for name, x in begin.items() if x},
        "workpiece": place,
        "walls": workpiece.walls,
        "random seed": str(settings.seed),
    }


def clearance_by_phase(plans: Plans, on_path: int) -> dict[str, str]:
    """Return the guaranteed clearance before the path, on it, between seams and on the way back, as text by label.

    Without a motion to the last target the result is empty.

    Args:
        plans: The plan.
        on_path: Index of the first target on the path.
    """
    if not plans.executable[0].all():
        return {}
    least, target = plans.segment_clearance[0], np.arange(plans.executable.shape[1])
    between = plans.begins_seam
    phases = {
        "before the path": least[(target <= on_path) & ~between],
        "on the path": least[(target > on_path) & ~between],
        "between seams": least[between],
        "on the way back": least if plans.retract is None else plans.retract.clearance,
    }
    known = {name: np.fmin.reduce(each) for name, each in phases.items() if np.isfinite(each).any()}
    return {"clearance by phase": ", ".join(f"{name} at least {1e3 * each:.3g} mm" for name, each in known.items())}


def not_checked(
    job: PlanConfig,
    robot: Robot,
    obstacles: Obstacles,
    made: PlanProgram | None,
    facts: Mapping[str, str],
    folder: Path,
) -> dict[str, str]:
    """Return what the plan does not check, as text by label.

    Args:
        job: The job.
        robot: The robot.
        obstacles: Obstacles in addition to the workpiece.
        made: The robot program; None: not timed.
        facts: Facts of the plan, see `build.checked_facts`.
        folder: Folder of the plan.
    """
    torque = "not timed" if made is None else program_facts.torque_text(made.peak_torque)
    known = {"bodies": facts["not checked"]} if "not checked" in facts else {}
    others = "" if obstacles else "the job has no cell: floor, table, fixtures and other machines are unknown"
    validation = (folder / plan_folder.VALIDATION).exists()
    return {
        **known,
        "arm against itself": _own_pairs(robot, obstacles),
        **({"surroundings": others} if others else {}),
        "process": "whether the weld, cut or coat is good; heat, spatter, distortion, the wire or jet from the tool",
        "cables": "hoses and cables are not in the model, unless they are bodies of the arm or the tool",
        "place of the part": f"the part, the tool and the arm are where the job says, within the errors: {errors}"
        if (errors := facts.get("errors"))
        else "the part, the tool and the arm are where the job says. The guaranteed clearance is the allowance for "
        "errors",
        "torque": torque,
        "controller": "how the controller interpolates, rounds corners, and follows; htcp program proves the motion of "
        "the file it writes",
        "independent check": "MuJoCo has checked this plan, see validation.json"
        if validation
        else "not done; htcp validate checks the plan by MuJoCo",
    }


def _own_pairs(robot: Robot, obstacles: Obstacles) -> str:
    """Return a text on the pairs of the arm's bodies that are not checked against each other."""
    own = next((each for each in obstacles if isinstance(each, SelfCollision)), None)
    if own is None:
        return "no pair of bodies is checked: cell.self_collision is false, or there is no pair"
    of_tool = [each for each in own.unchecked if {each.first, each.second} & {*robot.mounted}]
    parts = [
        f"{what}: {', '.join(_pairs(robot, pairs))}"
        for what, pairs in (
            ("of the tool and the arm", of_tool),
            ("of the arm", [p for p in own.unchecked if p not in of_tool]),
        )
        if pairs
    ]
    if not parts:
        return "every pair of bodies that can collide is checked"
    return f"not checked, as they overlap in nearly every configuration: pairs {'; '.join(parts)}"


def _pairs(robot: Robot, pairs: list[robots.Exclusion]) -> list[str]:
    names = [f"{robot.capsule_names[each.first]} and {robot.capsule_names[each.second]}" for each in pairs]
    return names if len(names) <= MOST_PAIRS else [*names[:MOST_PAIRS], f"{len(names) - MOST_PAIRS} more"]


def _task(rows: Sequence[object]) -> str:
    return "; ".join(map(_row, rows)) or "the TCP follows the path"


def _row(row: object) -> str:
    """Return a row of a task as in a job file, without keys that have their defaults."""
    if not dataclasses.is_dataclass(row):
        return str(row)
    given = [(each.name, getattr(row, each.name), each.default) for each in dataclasses.fields(row)]
    return ", ".join(f"{name}: {_value(value)}" for name, value, default in given if value != default)


def _value(value: object) -> str:
    return f"[{_numbers(value)}]" if isinstance(value, tuple) else f"{value}"


def _numbers(values: tuple) -> str:
    return ", ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def _angles(robot: Robot, x: tuple[float, ...]) -> str:
    """Return a configuration as text, in degrees, or millimetres of prismatic joints."""
    parts = zip(x, robot.sliding, strict=True)
    return ", ".join(f"{1e3 * value:.1f} mm" if slides else f"{np.degrees(value):.1f} deg" for value, slides in parts)
