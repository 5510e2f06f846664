"""Report of one plan, for somebody who was not there: one page with pictures, charts, tables and assumptions."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from jaxtyping import Float
from PIL import Image

from htcp_jax.clearance import Obstacles
from htcp_jax.errors import InputError
from htcp_jax.motion import motion
from htcp_jax.report import plan_notes, plan_tables, program_facts
from htcp_jax.report.charts.along_plan import AlongPlan, along_plan
from htcp_jax.report.document import Block, Heading, Picture, Table
from htcp_jax.report.plan_tables import fact_table
from htcp_jax.report.report import Report
from htcp_jax.runs import SeamOrder
from htcp_jax.spec import ToolAxisRow, tool_axis_row
from htcp_jax.trajectory import PlanProgram, ProgramFigures, program_figures, program_of_plans, requested_feeds
from htcp_jax.viewer import PlannedJob, Replay, Studio, replays_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIZE = 800, 600  # of a picture [pixels]; two are next to each other
GLANCE = "can be run", "seams", "guaranteed clearance", "clearance by phase", "transfer margin"
ANGLES = "work angle", "travel angle", "spin"
PROVENANCE = "device", "dtype", "commit"


class ReportedPlan(PlannedJob, Protocol):
    """Interface of a plan with its results, such as `api.Plan`."""

    obstacles: Obstacles
    order: SeamOrder | None
    complete: bool
    workpiece_place: str
    manipulability: Float[np.ndarray, "T"]
    tool_angles: Float[np.ndarray, "T 3"] | None
    tool_axis_rows: list[tuple[slice, ToolAxisRow]]

    def facts(self) -> dict[str, str]:
        """Return the results as text by label."""
        ...

    def failure(self) -> dict[str, str]:
        """Return the reasons of a failure as text by label; empty if the plan is complete."""
        ...

    def figure(self) -> "Figure":
        """Draw the plan."""
        ...


def report_of_plan(plan: ReportedPlan, folder: Path, made_by: Mapping[str, Any], feed: str | None = None) -> Report:
    """Make the report of one plan.

    Args:
        plan: The plan.
        folder: Its folder.
        made_by: Contents of its summary.json, for versions and files.
        feed: Feed rate of the TCP on the path; None: of the seams, or the job.

    Raises:
        InputError: If `feed` is not a valid feed rate.
    """
    names, facts = plan_tables.seam_names(plan.job), plan.facts()
    made, untimed = _program(plan, folder, feed)
    figures = None if made is None else program_figures(made.program, made.limits)
    timed = {} if figures is None else program_facts.facts_of(figures, made.seam_feeds)
    facts |= plan_notes.clearance_by_phase(plan.plans, int(plan.scenario.on_path))
    glance = {key: facts[key] for key in (*GLANCE, *ANGLES) if key in facts} | {
        key: text for key, text in plan.failure().items() if key != "next"
    }
    glance |= {key: timed[key] for key in ("duration", "feed") if key in timed}
    blocks: list[Block] = [Heading(1, f"Plan: {plan}"), fact_table("glance", glance, "result")]
    blocks += _pictures(plan, str(folder))
    blocks += [Heading(2, "Along the path"), *_along(plan, made, names)]
    blocks += [Heading(2, "Cycle time"), *([untimed] if made is None else _timing(plan, made, figures, names))]
    blocks += [Heading(2, "The program"), *([untimed] if made is None else _program_blocks(made, figures, timed))]
    blocks += [Heading(2, "What was assumed"), *_assumed(plan, made)]
    unchecked = plan_notes.not_checked(plan.job, plan.robot, plan.obstacles, made, facts, folder)
    blocks += [Heading(2, "What is not checked"), fact_table("not_checked", unchecked, "not checked")]
    others = {
        key: text
        for key, text in facts.items()
        if key not in (*glance, "planning time", "workpiece", "pairs not checked")
    }
    blocks += [Heading(2, "Other results"), fact_table("results", others)]
    blocks += [Heading(2, "What was run"), *_what_was_run(made_by)]
    return Report((), (), tuple(blocks), tuple(block for block in blocks if isinstance(block, Table)))


def _program(plan: ReportedPlan, folder: Path, feed: str | None) -> tuple[PlanProgram | None, str]:
    """Return the robot program, or None and the reason why there is none."""
    if not plan.complete:
        return None, "The plan does not lead to its last target, so there is no program."
    if feed is None and None in plan.job.stated_feeds:
        return None, "Not timed: no feed rate is known. Pass --feed 20mm/s, or set program.feed in the job."
    feeds = requested_feeds(feed, plan.job)
    try:
        return program_of_plans(str(folder), plan.plans, 0, plan.job, feeds, plan.job.method), ""
    except InputError as error:
        return None, f"Not timed: {error}."


class _Shown(NamedTuple):
    """The arm at a target, from a side."""

    replay: Replay
    side: int  # see `Studio`
    target: int
    seam: str  # name of the seam; empty if the job has a single one

    @property
    def at(self) -> str:
        """The target as text."""
        return f"target {self.target}" + (f", on the seam {self.seam}" if self.seam else "")

    @property
    def caption(self) -> str:
        """The target and the cut as text."""
        cut = self.replay.sides[self.side].cut_text
        return self.at + (f", with the part {cut}" if cut else "")


def _pictures(plan: ReportedPlan, name: str) -> list[Block]:
    """Return pictures of the whole arm, each next to one close up; without OpenGL, the picture of the plan."""
    replay = replays_of(name, plan).replay(0, plan.job.method)
    shown = _shown(plan, replay)
    try:
        pictures = [picture for number, each in enumerate(shown, 1) for picture in _side(each, number)]
    except InputError as error:
        return [f"No rendered pictures: {error}.", Picture("plan", plan.figure(), "The arm in the workpiece")]
    captions = "; ".join(f"{row}: {each.caption}" for row, each in zip(("above", "below"), shown, strict=True))
    sides = "" if shown[0].seam else " from two sides"
    note = f"The arm{sides}, with the path in blue. Of {len(replay.target)} targets, {captions}."
    return [f"{note} The purple ball is at the minimum guaranteed clearance.", *pictures]


def _shown(plan: ReportedPlan, replay: Replay) -> list[_Shown]:
    """Return the failed target, or the middle of the path, from two sides; of several seams, the first and the last."""
    begins = [0, *plan.plans.seam_begins, len(replay.target)]
    if replay.failed is None and len(begins) > 2:
        found = []
        for first, end in (begins[:2], begins[-2:]):
            middle, seam = (max(first, replay.path) + end - 1) // 2, slice(max(first, replay.path), end)
            name = plan.job.workpiece.seams[int(plan.plans.seam_of_targets[middle])].name
            found.append(_Shown(replay.seen_at([middle], seam), 0, middle, name))
        return found
    at = max((replay.path + replay.tracked - 1) // 2, 0) if replay.failed is None else replay.failed
    replay = replay.seen_at([at])
    return [_Shown(replay, side, at, "") for side in (0, 1)]


def _side(shown: _Shown, number: int) -> list[Picture]:
    """Return pictures of the whole arm and of the workpiece close up, which are next to each other."""
    pictures = []
    for name, close in (("arm", False), ("close", True)):
        with Studio(shown.replay, *SIZE, close=close, side=shown.side) as studio:
            image = Image.fromarray(studio.still(shown.target))
        what = "The workpiece close up" if close else "The arm"
        pictures.append(Picture(f"{name}-{number}", image, f"{what} at {shown.caption}", half=True))
    return pictures


def _along(plan: ReportedPlan, made: PlanProgram | None, names: list[str]) -> list[Block]:
    angles = None if plan.tool_angles is None else (plan.tool_axis_rows, plan.tool_angles)
    shown = AlongPlan(plan.plans, plan.scenario, () if plan.order is None else names, angles, made)
    blocks: list[Block] = [Picture("along-path", along_plan(shown), "Clearance, angles and speed over the targets")]
    if angles is not None:
        limited = [name for name, rows in zip(names, plan.job.tasks, strict=False) if tool_axis_row(rows) is not None]
        blocks.append(plan_tables.angle_table(*angles, limited))
    return blocks if plan.order is None else [*blocks, plan_tables.seam_table(plan.order, made)]


def _timing(plan: ReportedPlan, made: PlanProgram, found: ProgramFigures, names: list[str]) -> list[Block]:
    blocks: list[Block] = [plan_tables.phase_table(made, names)]
    if found.drops:
        table = program_facts.drop_table(found, plan.manipulability)
        blocks += ["Where the TCP is slower than the feed; stop: the arm starts or stops there.", table]
    return blocks


def _program_blocks(made: PlanProgram, found: ProgramFigures, timed: dict[str, str]) -> list[Block]:
    torque = program_facts.torque_text(made.peak_torque)
    facts = {
        **timed,
        **program_facts.near_part(made.job),
        **program_facts.way_back(made.job, made.program),
        "torque": torque,
    }
    return [fact_table("program", facts), plan_tables.format_table(made)]


def _assumed(plan: ReportedPlan, made: PlanProgram | None) -> list[Block]:
    known = plan_notes.assumptions(plan.job, plan.robot, plan.workpiece, plan.workpiece_place)
    if made is not None:
        feeds = ", ".join(f"{1e3 * feed:g} mm/s on {name}" for name, feed in made.seam_feeds.items())
        known["required feed"] = feeds or f"{1e3 * made.program.feed_m_s:g} mm/s"
    x = motion.motion(plan.plans, 0, int(plan.scenario.on_path)).x
    blocks: list[Block] = [fact_table("assumed", known, "assumption")]
    if not len(x):
        return blocks
    source = "Ranges of the joints." if made is None else plan_tables.limit_sources(made)
    return [*blocks, source, plan_tables.joint_table(plan.robot, x, made)]


def _what_was_run(made_by: Mapping[str, Any]) -> list[Block]:
    versions = ", ".join(f"{name} {version}" for name, version in (made_by.get("versions") or {}).items() if version)
    facts = {"method": str(made_by["method"]), "versions": versions}
    facts |= made_by.get("plugins", {})
    facts |= {key: str(made_by[key]) for key in PROVENANCE if made_by.get(key)}
    facts |= {f"SHA-256 of {Path(name).name}": str(known)[:16] for name, known in made_by["files"].items()}
    return [fact_table("what_was_run", facts)]
