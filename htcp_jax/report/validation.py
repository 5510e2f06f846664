"""Tables and sentences on the results of `htcp validate`, for the report and the terminal."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.report.document import Block, Heading, Table
from htcp_jax.runs import Run, plan_folder
from htcp_jax.system import files
from htcp_jax.validation import STEP_RAD

AT_TARGETS = (
    "method", "checked", "refuted", "tcp_error_max_mm", "clearance_min_mm", "clearance_min_at",
    "clearance_less_cover_min_mm", "clearance_off_max_mm",
)  # fmt: skip
BETWEEN_TARGETS = (
    "method", "paths", "paths_touching", "paths_blocked", "clearance_between_min_mm", "clearance_between_min_at",
    "line_deviation_max_mm", "speed_ratio_max", "speed_joint", "in_place_max_rad",
)  # fmt: skip
ROWS = "method", "row", "off", "most", "unit", "at"
NOT_STORED = "No validation of these results is stored in this run: htcp validate RUN stores one."
PLACES = "clearance_min_at", "clearance_between_min_at", "at"  # columns of a scenario and a target


def read_validation(run: Run) -> dict[str, Any] | None:
    """Return the contents of validation.json in the run's folder.

    Returns:
        The contents; None if the file does not exist, or if the run's results have changed since the validation.

    Raises:
        InputError: If the file is damaged.
    """
    file = Path(run.folder) / plan_folder.VALIDATION
    try:
        found = files.read_json(file, file.parent)
        if found["files"] != run.result_files():
            return None
        validation_summary(found), validation_tables(found), notes(found)  # raises if a key is missing
        return found
    except FileNotFoundError:
        return None
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise InputError(f"{file} is damaged or not a result of htcp validate: {files.cause(error, file)}") from None


def validated(found: dict[str, Any] | None) -> bool | None:
    """Return True if the validation confirmed every tracked target; None if there is no validation.

    Args:
        found: Contents of validation.json, see `read_validation`.
    """
    return None if found is None else bool(found["validated"])


def verdict(found: dict[str, Any] | None) -> str:
    """Return the validation's result as a sentence; `found` is None if there is no validation."""
    return NOT_STORED if found is None else validation_summary(found)


def validation_section(found: dict[str, Any] | None, labels: dict[int, str], level: int) -> list[Block]:
    """Return the section of the report on the validation; empty if there is none.

    Args:
        found: Contents of validation.json, see `read_validation`; None: no validation.
        labels: Varied parameters as text, by scenario.
        level: Level of the heading.
    """
    if found is None:
        return []
    about = f"With MuJoCo's kinematics and distances only, for the complete run. {validation_summary(found)}"
    where = scenarios_named(found, labels)
    return [Heading(level, "Validation"), about, *validation_tables(found), *where, *notes(found)]


def validation_summary(found: dict[str, Any]) -> str:
    """Return a sentence on a validation: the number of refuted targets and of colliding joint paths.

    Args:
        found: Contents of validation.json.
    """
    checks = found["methods"].values()
    checked, touching, paths = (sum(check[k] or 0 for check in checks) for k in ("checked", "paths_touching", "paths"))
    refuted = int(found["refuted_count"])
    outcome = "Validated: MuJoCo refutes none" if found["validated"] else f"Not valid: MuJoCo refutes {refuted:,}"
    between = f"; {touching:,} of the {paths:,} joint paths between them collide" if found["between"] else ""
    return f"{outcome} of {checked:,} tracked targets{between}."


def plain_lines(found: dict[str, Any], is_sweep: bool) -> dict[str, str]:
    """Return a validation's results in a few facts: clearance, TCP, task, joint speeds; of several methods the worst.

    Args:
        found: Contents of validation.json.
        is_sweep: True to name scenarios and methods with the targets.
    """

    def place(check: dict, key: str) -> str:
        scenario, target = check[key]
        return f"target {target}" + (f" of scenario {scenario} by {check['method']}" if is_sweep else "")

    def most(check: dict, key: str) -> str:
        return f" ({place(check, key)})" if check.get(key) else ""

    facts, checks = {}, [{"method": method, **check} for method, check in found["methods"].items()]
    if at := _worst(checks, "clearance_min_mm", min):
        facts["minimum clearance"] = f"{at['clearance_min_mm']:.3g} mm, at {place(at, 'clearance_min_at')}"
        if between := _worst(checks, "clearance_between_min_mm", min):
            near = f"{between['clearance_between_min_mm']:.3g} mm, near {place(between, 'clearance_between_min_at')}"
            facts["minimum clearance"] += f"; between the targets {near}"
    if at := _worst(checks, "tcp_error_max_mm", max):
        facts["tool's tip"] = f"within {at['tcp_error_max_mm']:.3g} mm of each target{most(at, 'tcp_error_max_at')}"
        if line := _worst(checks, "line_deviation_max_mm", max):
            off = f"{line['line_deviation_max_mm']:.3g} mm of the line between them"
            facts["tool's tip"] += f", and, on proven segments, within {off}{most(line, 'line_deviation_max_at')}"
    rows = [row | {"method": check["method"]} for check in checks for row in check.get("rows", ())]
    if rows := [row for row in rows if row["unit"] != "mm"] or rows:
        row = max(rows, key=lambda each: each["off"] / each["most"] if each["most"] else each["off"])
        used = f"{row['off']:.3g} of {row['most']:.3g} {row['unit']} used, the most of all rows"
        facts["task"] = f"{row['row']}: {used if row['off'] else 'within its range everywhere, as all rows'}"
    if at := _worst(checks, "speed_ratio_max", max):
        speed = f"{100 * at['speed_ratio_max']:.2g} % of the limit of {at['speed_joint']}"
        facts["joint speeds"] = f"at most {speed}, for a feed rate of {found['feed_mm_s']:g} mm/s"
    if touching := sum(check["paths_touching"] or 0 for check in checks):
        facts["joint paths that collide"] = f"{touching:,} of {sum(check['paths'] or 0 for check in checks):,}"
    return facts


def _worst(checks: list[dict], key: str, best: Callable) -> dict | None:
    known = [check for check in checks if check.get(key) is not None]
    return best(known, key=lambda check: check[key]) if known else None


def validation_tables(found: dict[str, Any]) -> tuple[Table, ...]:
    """Return the tables of a validation by method: targets, joint paths between targets, and task rows."""
    rows = [{"method": method, **check} for method, check in found["methods"].items()]
    tables = _filled_table("validation", AT_TARGETS, rows), _filled_table("validation-paths", BETWEEN_TARGETS, rows)
    held = [{"method": check["method"], **row} for check in rows for row in check.get("rows", ())]
    return (*tables, _filled_table("validation-rows", ROWS, held)) if held else tables


def _filled_table(name: str, keys: tuple[str, ...], rows: list[dict]) -> Table:
    """Return the table without empty columns, with the columns in PLACES as text such as "3: 17"."""
    texts = [{key: "{}: {}".format(*row[key]) for key in PLACES if row.get(key) is not None} for row in rows]
    return Table.of(name, keys, [row | text for row, text in zip(rows, texts, strict=True)]).without_empty()


def scenarios_named(found: dict[str, Any], labels: dict[int, str]) -> list[str]:
    """Return a sentence with the labels of the scenarios in a validation's tables."""
    at = [check.get(key) for check in found["methods"].values() for key in PLACES]
    numbers = sorted({place[0] for place in at if place is not None and labels.get(place[0])})
    return [f"Scenarios: {'; '.join(f'{number} is {labels[number]}' for number in numbers)}."] if numbers else []


def notes(found: dict[str, Any]) -> list[str]:
    """Return explanations of the columns that have values in a validation's tables."""
    lines = []
    if any(check.get("clearance_off_max_mm") is not None for check in found["methods"].values()):
        lines.append(
            "Differs from plan: the largest difference between a target's clearance in the plan and MuJoCo's. Where "
            "the plan's is a lower bound, as for meshes and convex pieces, it counts only if MuJoCo's is smaller."
        )
    lines += found.get("unchecked", ())
    if found.get("excluded"):
        lines.append(f"Deepest overlap of two capsules that are not checked against each other: {found['excluded']}.")
    if any(check.get("clearance_less_cover_min_mm") is not None for check in found["methods"].values()):
        lines.append(
            "Clearance is the smallest distance of all checked pairs, from the part to its mesh's triangles. Less "
            "cover: distances from the part are smaller by the covering radius of the planner's points on the mesh, "
            "which plans, sweeps and reports also subtract."
        )
    if found["between"]:
        lines.append(
            "Joint paths are the straight joint paths between tracked targets, and from the start to the first, with "
            f"{found['between']} or more samples each, at most {STEP_RAD:g} rad apart. Their collisions refute no "
            'target; "blocked" counts the paths that the planner itself found to collide. Path deviation: the TCP\'s '
            "distance from the straight line between its targets, on segments with a proven motion."
        )
    if any(check.get("speed_ratio_max") is not None for check in found["methods"].values()):
        lines.append(
            f"Joint speeds are for a feed rate of {found['feed_mm_s']:g} mm/s and proportional to it. The limits are "
            "from the model file, for the GP50 from its data sheet. In place: the joint change from the start to the "
            "first target, and between targets closer together than the tolerance. The feed rate sets no time."
        )
    elif any(check["paths"] for check in found["methods"].values()):
        lines.append("There are no joint speeds, because the model file has no velocity limits.")
    return lines
