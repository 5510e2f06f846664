"""Chapter of the report on one part of a run: sentences, tables and charts."""

import itertools
import math
from functools import cache
from pathlib import Path

import numpy as np

from htcp_jax.jobs import load_config
from htcp_jax.motion import motion
from htcp_jax.report import paper, tables
from htcp_jax.report.best import best_of_all, best_scenarios
from htcp_jax.report.document import Block, Heading, Picture, Table
from htcp_jax.report.groups import Part
from htcp_jax.report.motions import meaning, motion_table
from htcp_jax.report.part_charts import charts_of, numbered_values
from htcp_jax.report.spread import MEANING as RATES_MEANING
from htcp_jax.report.spread import meaning_of_spread, scenario_rates, spread
from htcp_jax.report.timing import TIMED, timing, timing_section
from htcp_jax.report.validation import validation_section, verdict
from htcp_jax.runs import columns, labels, summary
from htcp_jax.runs import manifest as manifests
from htcp_jax.spec import PlanConfig, config_file, examples
from htcp_jax.status import SegmentStatus

DEFAULT = "duct.yaml"  # the shipped configuration with the default job
UNITS = "rad", "m"
BLOCKED = (
    "A joint step is blocked if the straight joint path from the previous configuration collides; not every planner "
    "checks this. Tracked before it: the tracked targets before each scenario's first blocked step."
)
PAIRED = (
    "Each criterion is compared scenario by scenario. Executable targets: scenarios in which the method has more or "
    "fewer of them than the other one, or as many; sign test. Complete, and executable to the last target: scenarios "
    "in which only the method succeeds (more), only the other one (fewer), or both or neither (equal); McNemar's exact "
    "test. p: probability of a split at least as uneven if neither method is better. Many small differences in targets "
    "may have a small p although both methods complete equally many scenarios. Both tests assume independent "
    "scenarios. Neighbours in a fine grid are not: confirm a small difference with other seeds and poses."
)
MANIPULABILITY = (
    "Manipulability is the smallest singular value of the task's Jacobian: the lowest tool speed at a joint velocity "
    "of norm 1. It is 0 where the arm is singular; where it is low, joints must move fast to hold the feed."
)
CAUSE = "Cause: the colliding body at the failed target, or, if no body collides there, why the search ended."
BUILT_IN = {config_file.BUILT_IN_ARM: "GP50", config_file.DUCT: "the generated duct", "weld": "its weld"}


TABLES = (
    tables.results,
    scenario_rates,
    tables.pairs,
    tables.paper,
    spread,
    best_scenarios,
    tables.reachability_table,
    tables.reach_table,
    motion_table,
    tables.motion_ends,
    timing,
    tables.stop_table,
    tables.steps,
    tables.times,
    tables.scenarios,
)


def tables_of(part: Part) -> dict[str, Table]:
    """Return a part's tables by name."""
    return {table.name: table for table in (make(part) for make in TABLES)}


def chapter(part: Part, made: dict[str, Table], prefix: str, level: int) -> list[Block]:
    """Return the chapter on one part of a run.

    Args:
        part: The part.
        made: The part's tables by name, see `tables_of`.
        prefix: Prefix of the pictures' names.
        level: Level of the headings.
    """
    drawn = charts_of(part)

    def picture(name: str) -> Picture:
        return drawn[name].picture(f"{prefix}{name}")

    return [
        answer(part),
        *part_facts(part),
        Heading(level, "Results"),
        made["results"],
        *_notes_on_results(part),
        made["scenario-rates"],
        RATES_MEANING,
        *_next_to_the_best(made["pairs"]),
        *_next_to_the_paper(part, made["paper"], level + 1),
        *_reachability_blocks(part, made["reachability"]),
        *_reach_blocks(part, made["reach"], prefix),
        picture("success"),
        *numbered_values(part),
        *(each.picture(f"{prefix}{name}") for name, each in drawn.items() if each.over_grid),
        *(() if part.axes else ["The scenarios do not differ in any parameter."]),
        made["spread"],
        meaning_of_spread(part),
        Heading(level, "Best scenarios"),
        *best_of_all(part, made["best"], prefix),
        Heading(level, "Motions"),
        made["motions"],
        meaning(part),
        *_motion_ends(made["motion-ends"]),
        *timing_section(part, made["timing"], level),
        *(picture(name) for name in TIMED if name in drawn),
        Heading(level, "Failures"),
        picture("survival"),
        *(picture(name) for name in ("stops",) if name in drawn),
        *_end_blocks(part, made["stops"]),
        Heading(level, "Clearance and joint motion"),
        picture("clearance"),
        *((picture("manipulability"), MANIPULABILITY) if "manipulability" in drawn else ()),
        made["joint-steps"],
        BLOCKED,
        picture("joint-motion"),
        picture("joints"),
        *validation_section(part.validation, part.run.labels(), level),
        Heading(level, "Time"),
        f"For the complete run, on {_device(part)}.",
        made["times"],
    ]


def answer(part: Part) -> str:
    """Return a sentence with the number of scenarios in which a proven motion leads to the last target, by method."""
    found = []
    for method, plans in part.plans.items():
        done = plans.outcomes.can_be_driven
        known = 1e3 * summary.reduced(np.min, part.motions[method].segment_clearance_min_m[done])
        after = 1e3 * summary.reduced(np.min, motion.narrowest_segment(plans, without_transfer=True)[1][done])
        least = None if math.isnan(known) else f"{known:.3g} mm"
        if after > known:
            least = f"{after:.3g} mm, in transfers {least}"
        found.append((int(done.sum()), method, least))
    found.sort(key=lambda each: -each[0])
    planned = int(part.plans[found[0][1]].outcomes.planned.sum())
    of, at_least = f" of {planned:,} scenarios", "guaranteed clearance at least "
    words = []
    for (count, least), alike in itertools.groupby(found, lambda each: (each[0], each[2])):
        *others, last = [method for _, method, _ in alike]
        by = f"{', '.join(others)} and {last}" if others else last
        words.append(f"{count:,}{of} by {by}" + (f" ({at_least}{least})" if least else ""))
        of = at_least = ""
    return f"A proven motion leads to the last target in {', '.join(words)}."


def part_facts(part: Part) -> list[str]:
    """Return paragraphs on the part: scenarios, robot, workpiece, job."""
    manifest = part.run.manifest
    grid = " x ".join(f"{len(values)}" for values in part.axes.values())
    drawn = _drawn(part)
    each = [
        f"{columns.column(name).heading}{drawn.get(name) or _axis_range(name, values)}"
        for name, values in part.varied.items()
    ]
    full = len(part.axes) > 1 and math.prod(map(len, part.axes.values())) == len(part.numbers)
    once = "an independent draw" if drawn.keys() == part.varied.keys() else "one value"
    jointly = f", {once} of each in every scenario" if len(part.varied) > len(part.axes) == 1 else ""
    is_part = bool(manifest.part) and len(manifest.grid) == 1
    over = f"{', with' if is_part else ' over'} {labels.listed(each)}{jointly}" if each else ""
    over = f", a grid of {grid}{over}" if full and not is_part else over
    of = f" of {manifest.full:,}" if is_part else ""
    lines = [f"{len(part.numbers):,}{of} scenarios{over}; up to {part.targets} targets each; seed {manifest.seed}."]
    scene = part.run.config
    path = scene.workpiece.path_label if scene.workpiece.seams else scene.workpiece.path
    named = {"robot.model": scene.robot.model, "workpiece.cloud": scene.workpiece.cloud, "path": path}
    named_files = {key: BUILT_IN.get(name, Path(name).name) for key, name in named.items()}
    for key in (named.keys() - {"path"} if scene.workpiece.seams else named.keys()) & part.parameters.keys():
        named_files[key] = ", ".join(BUILT_IN.get(name, name) for name in dict.fromkeys(part.parameters[key].tolist()))
    robot, cloud, path = named_files.values()
    lines.append(f"Robot {robot}; workpiece {cloud}; path {path}.")
    packages = manifests.plugins_for(manifest.plugins, part.plans)
    lines += [f"From other packages: {', '.join(f'{added} ({p})' for added, p in packages.items())}."] * bool(packages)
    lines.append(f"Configuration: {choice(part)}. {verdict(part.validation)}")
    if manifest.part:
        lines.append(f"Planned part of the grid: {manifest.part}.")
    unfinished = {m: sum(map(len, part.run.missing(m))) for m in part.run.methods}
    if any(unfinished.values()):
        text = ", ".join(f"{method}: {count:,}" for method, count in unfinished.items() if count)
        lines.append(f"The run is not finished. Scenarios still to plan: {text}.")
    return lines


def _axis_range(name: str, values: np.ndarray) -> str:
    """Return an axis's range as text, with the unit, angles also in degrees; empty if the values are not numbers."""
    unit = name.rpartition("_")[2]
    if unit not in UNITS or values.dtype.kind not in "if":  # the values are texts or lists
        return ""
    low, high = float(values.min()), float(values.max())
    degrees = f", {np.degrees(low):.3g} to {np.degrees(high):.3g} degrees" if unit == "rad" else ""
    return f" ({low:.3g} to {high:.3g} {unit}{degrees})"


def _drawn(part: Part) -> dict[str, str]:
    """Return the distributions of the part's random parameters as text in brackets, by column."""
    found = {}
    for axis in part.run.manifest.drawn:
        column = part.keys.get(axis.parameter)
        if column is not None and part.name == (f"{part.run_name}: {axis.group}" if axis.group else part.run_name):
            unit = column.rpartition("_")[2]
            found[column] = f" ({axis.distribution_text}{f' {unit}' if unit in UNITS else ''})"
    return found


def choice(part: Part) -> str:
    """Return the job as text: the most similar shipped configuration, and every key that differs from it.

    For a job with its own scene, the text contains only the margin and the settings that are not defaults.
    """
    ran = part.run.config
    if not fits_presets(part):
        changed = tables.config_differences(ran, PlanConfig())
        own = ", ".join(f"{key} {value}" for key, value in changed.items() if key.startswith("settings."))
        return f"margin {1e3 * ran.margin_m:g} mm, {own or 'default settings'}"
    differ = {name: tables.config_differences(ran, preset) for name, preset in presets().items()}
    nearest = min(differ, key=lambda name: len(differ[name]))
    text = ", ".join(f"{key} {value}" for key, value in differ[nearest].items())
    return f"{nearest}, apart from {text}" if text else nearest


def fits_presets(part: Part) -> bool:
    """Return True if the part can be compared with the shipped configurations.

    This requires the built-in scene, or the grid of one of the paper's tables.
    """
    scene = part.run.config
    names = scene.robot.model, scene.workpiece.cloud, scene.workpiece.path
    return all(name in BUILT_IN for name in names) or part.paper_table is not None


@cache
def presets() -> dict[str, PlanConfig]:
    """Return the shipped configurations for the default scene, by name."""
    return {f"{name}.yaml": load_config(examples.examples()[name]) for name in ("duct", "paper", "port")}


def _end_blocks(part: Part, table: Table) -> list[Block]:
    if not table.rows:
        return ["No scenario failed."]
    found = sorted({reason for plans in part.plans.values() for reason in tables.reasons(plans)})
    lines = (f"{reason.words}: {reason.message}." for reason in found)
    meaning = " ".join(text[0].upper() + text[1:] for text in lines)
    return [table, f"{CAUSE} {meaning}" if "cause" in (column.key for column in table.columns) else meaning]


def _motion_ends(table: Table) -> list[Block]:
    """Return the section on tracked targets that are not executable; empty if there are none."""
    if not table.rows:
        return []
    shown = [status for status in SegmentStatus if any(row["reason"] == status.words for row in table.records())]
    meaning = "; ".join(f"{status.words}: {status.message}" for status in shown)
    text = "Why tracked targets are not executable: the motion ends at one of them, so that no later one is"
    return [table, f"{text}. {meaning[0].upper()}{meaning[1:]}."]


def _notes_on_results(part: Part) -> list[str]:
    names = ", ".join(dict.fromkeys(row.name for row in part.run.config.task_rows if row.sampled))
    sampled = f"The task row {names} has no rate, so proven motions in this report are only sampled along the path."
    return [
        *([sampled] if names else []),
        "Targets tracked: tracked targets in percent of all targets of all scenarios; a scenario ends at its first "
        "failure. Scenarios complete: percentage of scenarios with all targets tracked.",
        "A target is executable if a proven motion leads to it from the given start, with the arm clear of "
        "collisions and the tool on its path. Tracked targets after the end of this motion are not executable. "
        + _unchecked_sentence(part),
        "Means and the minimum clearance are over the tracked targets: a method that tracks more targets "
        "also passes narrower places. Time/target: planning time / attempted targets, over the complete run.",
    ]


def _next_to_the_best(table: Table) -> list[Block]:
    """Return the table that compares each method with the best one, and its explanation; empty for a single method."""
    return [table, PAIRED] if table.rows else []


def _next_to_the_paper(part: Part, table: Table, level: int) -> list[Block]:
    """Return the section that compares our results with the paper's table; empty if the grid is not the paper's."""
    if not table.rows:
        return []
    return [
        Heading(level, f"Next to the paper, table {part.paper_table.number}"),
        table,
        f"{_paper_part(part)}Columns named paper: {part.paper_table.source}; {paper.MACHINE}. Time/target: planning "
        "time / attempted targets. TCP distance: mean over the tracked targets. Clearance: mean of D over them, which "
        "the paper calls safe distance. The paper does not specify its averages, the start configuration or the "
        "workpiece's pose. Deviations are explained in docs/reproduction.md, and benchmarks/PAPER.md compares other "
        "definitions.",
    ]


def _paper_part(part: Part) -> str:
    """Return a sentence on the planned part of the paper's scenarios; empty if all are planned."""
    of, planned = part.paper_table.scenarios, len(part.numbers)
    return f"The paper's values are for all {of} scenarios, ours for {planned} of them. " if planned < of else ""


def _unchecked_sentence(part: Part) -> str:
    """Return a sentence with the number of unchecked joint paths; empty if there are none."""
    count = sum(int((plans.tracked & (plans.path_clear < 0)).sum()) for plans in part.plans.values())
    return f"The joint paths of {count:,} steps were not checked; they count as clear." if count else ""


def _reachability_blocks(part: Part, table: Table) -> list[Block]:
    if part.reachability is None:
        return []
    what = (
        "Reachable: number of consecutive targets with a clear configuration, as found by a search (a lower bound). "
        "Not excluded: number of consecutive targets without a proof that none exists (an upper bound)."
    )
    return [table, " ".join([what, *_beaten_sentences(part)])]


def _reach_blocks(part: Part, table: Table, prefix: str) -> list[Block]:
    if part.reach is None:
        return []
    what = "Every target on the path is classified by itself. Excluded: a proof shows that no configuration reaches it."
    figure = part.scene.reach_picture(part.numbers, part.reach, part.name)
    if figure is None:
        return [what, table]
    return [what, table, Picture(f"{prefix}reach", figure, f"The workpiece of {part.name}; targets coloured by reach")]


def _beaten_sentences(part: Part) -> list[str]:
    """Return a sentence on scenarios in which a method tracked more targets than the search; [] if there are none."""
    beaten = []
    for method, plans in part.plans.items():
        further = part.numbers[plans.outcomes.tracked > part.reachability]
        if further.size:
            beaten.append(
                f"{method} in {further.size} ({', '.join(map(str, further[:8]))}{', ...' * (further.size > 8)})"
            )
    return [f"Scenarios with more tracked than reachable targets: {'; '.join(beaten)}."] if beaten else []


def _device(part: Part) -> str:
    devices = dict.fromkeys(str(entry.get("device", "?")) for entry in part.run.manifest.planned_by)
    return " and ".join(name.removeprefix("cpu: ") for name in devices) or "an unknown device"
