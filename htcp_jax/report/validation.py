"""Results of `htcp validate`, for the report and the terminal."""

from pathlib import Path
from typing import Any

from htcp_jax.errors import InputError
from htcp_jax.io import files
from htcp_jax.report.document import Block, Column, Heading, Table
from htcp_jax.runs import Run, plan_folder
from htcp_jax.validation import STEP_RAD

AT_TARGETS = (
    Column("method", "method"),
    Column("checked", "targets", "checked", ",d"),
    Column("refuted", "refuted", "", ",d"),
    Column("tcp_error_max_mm", "TCP error", "max mm", ".3f"),
    Column("clearance_min_mm", "clearance", "min mm", ".3g"),
    Column("clearance_min_at", "scenario:", "target"),
    Column("clearance_less_cover_min_mm", "less cover", "min mm", ".3g"),
    Column("clearance_off_max_mm", "differs from plan", "max mm", ".1e"),
)
BETWEEN_TARGETS = (
    Column("method", "method"),
    Column("paths", "joint paths", "", ",d"),
    Column("paths_touching", "collide", "", ",d"),
    Column("paths_blocked", "blocked", "in the plan", ",d"),
    Column("clearance_between_min_mm", "clearance", "min mm", ".3g"),
    Column("clearance_between_min_at", "scenario:", "target"),
    Column("line_deviation_max_mm", "path deviation", "max mm", ".2f"),
    Column("speed_ratio_max", "joint speed", "of limit", ".3f"),
    Column("speed_joint", "at"),
    Column("in_place_max_rad", "in place", "max rad", ".2f"),
)
ROWS = (
    Column("method", "method"),
    Column("row", "row of the task"),
    Column("off", "error", "max", ".4g"),
    Column("most", "allowed", "", ".4g"),
    Column("unit", "", ""),
    Column("at", "scenario:", "target"),
)
BETWEEN = ("clearance_between_min_at",)


def read_validation(run: Run) -> dict[str, Any] | None:
    """Read the validation in the run's folder; None if there is none, or if it is of other results.

    Raises:
        InputError: For a damaged file.
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
        raise InputError(f"{file} is damaged or no result of htcp validate: {files.cause(error, file)}") from None


def validated(found: dict[str, Any] | None) -> bool | None:
    """True if every tracked target is confirmed by a validation, see `read_validation`; None without one."""
    return None if found is None else bool(found["validated"])


def verdict(found: dict[str, Any] | None) -> str:
    """Sentence on a validation, see `read_validation`, or on its absence."""
    return "Not validated independently." if found is None else validation_summary(found)


def validation_section(found: dict[str, Any] | None, labels: dict[int, str], level: int) -> list[Block]:
    """Section of the report on the validation; empty if there is none.

    Args:
        found: The validation, see `read_validation`.
        labels: The varied parameters of the run's scenarios, by number.
        level: Level of the heading.
    """
    if found is None:
        return []
    about = f"By MuJoCo's kinematics and distances alone, for the complete run. {validation_summary(found)}"
    where = scenarios_named(found, labels)
    return [Heading(level, "Validation"), about, *validation_tables(found), *where, *notes(found)]


def validation_summary(found: dict[str, Any]) -> str:
    """Sentence on the result of a validation, in the form of validation.json."""
    checks = found["methods"].values()
    checked, touching, paths = (sum(check[k] or 0 for check in checks) for k in ("checked", "paths_touching", "paths"))
    refuted = int(found["refuted_count"])
    outcome = "Validated: MuJoCo refutes none" if found["validated"] else f"Not valid: MuJoCo refutes {refuted:,}"
    between = f"; {touching:,} of the {paths:,} joint paths between them collide" if found["between"] else ""
    return f"{outcome} of {checked:,} tracked targets{between}."


def validation_tables(found: dict[str, Any]) -> tuple[Table, ...]:
    """Tables of a validation by method: at the targets, on the joint paths between them, and of the task's rows."""
    rows = [{"method": method, **check} for method, check in found["methods"].items()]
    tables = _filled_table("validation", AT_TARGETS, rows), _filled_table("validation-paths", BETWEEN_TARGETS, rows)
    held = [{"method": check["method"], **row} for check in rows for row in check.get("rows", ())]
    return (*tables, _filled_table("validation-rows", ROWS, held)) if held else tables


def _filled_table(name: str, columns: tuple[Column, ...], rows: list[dict]) -> Table:
    def cell(value: Any) -> Any:
        return f"{value[0]}: {value[1]}" if isinstance(value, list | tuple) else value

    filled = tuple(column for column in columns if any(row.get(column.key) is not None for row in rows))
    return Table(name, filled, tuple(tuple(cell(row.get(column.key)) for column in filled) for row in rows))


def scenarios_named(found: dict[str, Any], labels: dict[int, str]) -> list[str]:
    """Sentence with the labels of the scenarios in a validation's tables."""
    at = [check.get(key) for check in found["methods"].values() for key in ("clearance_min_at", *BETWEEN)]
    numbers = sorted({place[0] for place in at if place is not None and labels.get(place[0])})
    return [f"Scenarios: {'; '.join(f'{number} is {labels[number]}' for number in numbers)}."] if numbers else []


def notes(found: dict[str, Any]) -> list[str]:
    """Explanations of the columns that a validation fills."""
    lines = []
    if any(check.get("clearance_off_max_mm") is not None for check in found["methods"].values()):
        lines.append("Differs from plan: the largest difference between a clearance in the plan and MuJoCo's.")
    lines += found.get("unchecked", ())
    if found.get("excluded"):
        lines.append(f"Deepest overlap of two capsules that are not checked against each other: {found['excluded']}.")
    if any(check.get("clearance_less_cover_min_mm") is not None for check in found["methods"].values()):
        lines.append(
            "Clearance is to the triangles of the mesh. Less cover: minus the covering radius of the planner's points "
            "on the mesh, which plans, sweeps and reports subtract from every clearance."
        )
    if found["between"]:
        lines.append(
            "Joint paths are the straight joint paths between tracked targets, and from the start to the first, with "
            f"{found['between']} or more samples each, at most {STEP_RAD:g} rad apart. Collisions on them refute no "
            'target; "blocked" counts those that the planner found itself. Path deviation: the TCP\'s distance from '
            "the straight line between its targets."
        )
    if any(check.get("speed_ratio_max") is not None for check in found["methods"].values()):
        lines.append(
            f"Joint speeds are for a feed rate of {found['feed_mm_s']:g} mm/s and proportional to it; the limits are "
            "the model file's, for the GP50 its data sheet's. In place: the joint change between targets that are "
            "closer together than the tolerance, and from the start to the first; the feed rate sets no time for it."
        )
    elif any(check["paths"] for check in found["methods"].values()):
        lines.append("There are no joint speeds, because the model states no limits.")
    return lines
