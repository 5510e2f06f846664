"""Check of a job's tool without its arm, for `htcp tool JOB.yaml`."""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path

import jax
import numpy as np

from htcp_jax.cli.output import print_facts, print_json, progress_bar
from htcp_jax.errors import InputError
from htcp_jax.jobs import load_sweep_or_job
from htcp_jax.model import Workpiece
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.reachability import ToolClearance, tool_clearances
from htcp_jax.report import reach_study
from htcp_jax.runs import failure_texts

LONGER_MM = 0, 3, 6, 10, 15, 20  # additional lengths of the wire that are tried
CLEAR, NOT_CLEAR = 0, 3  # exit codes


def check_job(file: Path, overrides: Sequence[str], as_json: bool) -> int:
    """Print where the tool of a job clears its part, for each seam.

    Args:
        file: The job.
        overrides: Changes to the job, each KEY=VALUE.
        as_json: True prints JSON.

    Returns:
        The exit code.
    """
    spec = load_sweep_or_job(file, None, overrides)
    if not spec.alone:
        raise InputError(f"{file} is a sweep; htcp tool checks one job")
    found, parts = [], []
    with progress_bar("seams", first="building the part") as progress:
        batch = spec.batch(None)
        names = reach_study.seam_names(batch) or [spec.name]
        for row, number in enumerate(batch.cell):
            cell, scenario = batch.cells[number], jax.tree.map(itemgetter(row), batch.scenarios)
            longer_m = 1e-3 * np.array(LONGER_MM, float)
            if not len(cell.workpiece.cloud):
                raise InputError(
                    f"{file}: workpiece.cloud is none; without a part there is nothing that the tool clears"
                )
            scenario = scenario_functions.with_goals_of(scenario, cell.task.numbers)

            def show(done: int, count: int, row: int = row) -> None:
                progress(row, len(names), f"; {names[row]}: {done} of {count} rounds")

            own = cell.robot, cell.workpiece, scenario, cell.settings, cell.task
            found.append(tool_clearances(*own, longer_m, show))
            parts.append(cell.workpiece)
    if as_json:
        print_json({"job": spec.name, "seams": [_record(*each) for each in zip(names, found, strict=True)]})
    else:
        for name, each, part in zip(names, found, parts, strict=True):
            print_facts(name, _facts(each, part))
    return CLEAR if all(each.clear[0].all() for each in found) else NOT_CLEAR


def _facts(found: ToolClearance, workpiece: Workpiece) -> dict[str, str]:
    clear = found.clear[0]
    facts = {"tool": f"clears the part at {clear.sum()} of {len(clear)} targets"}
    if not clear.all():
        facts["not clear"] = (
            f"targets {reach_study.ranges(found.target[~clear])}: no allowed orientation was found at which it is"
        )
    k = int(found.clearance_m[0].argmin())
    required = f"required: {1e3 * found.margin_m[k]:g} mm"
    if np.isfinite(found.clearance_m[0, k]):
        body = found.names[found.body[0, k]]
        least = f"{1e3 * found.clearance_m[0, k]:.2f} mm at target {found.target[k]}, by {body}; {required}"
        facts["minimum clearance"] = least
        if workpiece.covering_radius_m and clear.all():
            cost = failure_texts.subtracted(workpiece, float(found.clearance_m[0, k]))
            facts["points on the mesh"] = cost
    else:
        facts["minimum clearance"] = f"none at target {found.target[k]}: no orientation was found that the task allows"
    lack_m = float(found.margin_m[k] - found.clearance_m[0, k])
    if not clear.all():
        facts |= failure_texts.denser_mesh(workpiece, lack_m)
    facts["longer wire"] = _longer_text(found)
    if found.ignored:
        rows = ", ".join(f"task.{number}" for number in found.ignored)
        facts["not considered"] = f"{rows}: about other links than the tool's"
    facts["checked"] = "the last link's bodies against the part, without the arm and the cell"
    return facts


def _longer_text(found: ToolClearance) -> str:
    """Describe the shortest additional wire with which the tool is clear at every target, or the largest that fails."""
    complete = found.clear.all(axis=1)
    rows = np.flatnonzero(complete[1:]) + 1
    k = int(rows[0]) if len(rows) else int(found.clear.sum(axis=1).argmax())
    if not k:
        return f"up to {LONGER_MM[-1]} mm more would not help"
    count, clear = len(found.target), found.clear[k]
    where = "at every target" if complete[k] else f"at {clear.sum()} of {count} targets, the most of the lengths tried"
    least = 1e3 * found.clearance_m[k][clear].min()
    return f"{LONGER_MM[k]} mm more would clear the part {where}, by {least:.2f} mm or more"


def _record(name: str, found: ToolClearance) -> dict:
    lengths = [
        {
            "longer_mm": longer,
            "clear": int(clear.sum()),
            "clearance_mm": [1e3 * each if np.isfinite(each) else None for each in own.tolist()],
            "body": [found.names[each] for each in bodies],
        }
        for longer, clear, own, bodies in zip(LONGER_MM, found.clear, found.clearance_m, found.body, strict=True)
    ]
    targets = {"target": found.target.tolist(), "required_mm": (1e3 * found.margin_m).tolist()}
    return {"name": name, **targets, "lengths": lengths, "not_considered": list(found.ignored)}
