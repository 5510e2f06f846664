"""Agreement of a run's files: manifest, grid, table of targets and table of scenarios.

The table of scenarios follows from the grid and from the table of targets. It is computed again and compared, so that
neither an easier scenario in place of a hard one nor an edited count passes as a better result.
"""

from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa

from htcp_jax.motion import Plans
from htcp_jax.runs import Run, labels, tables
from htcp_jax.validation.result import RECORD_M, ROUNDING_M

PRECISION = 1e-9  # relative and absolute tolerance of numbers that are computed again, maybe on another processor


def manifest_faults(run: Run) -> list[str]:
    """Return one sentence per value of a run's manifest that contradicts its configuration or its grid.

    Raises:
        InputError: If the grid cannot be read.
    """
    manifest, faults = run.manifest, []
    grid = manifest.model_copy(
        update={"count": manifest.full + 1, "scenarios": None}
    )  # one scenario more than stated, if there is one
    full = len(Run(run.folder, grid).points())
    chosen, seed = manifest.scenarios, run.config.settings.seed
    count = min(x for x in (manifest.limit, full if chosen is None else len(chosen), full) if x is not None)
    if manifest.is_sample and not manifest.is_drawn_from(full):
        faults.append(f"the manifest states another sample than seed {seed} draws")
    if chosen is not None and chosen[-1] >= full:
        faults.append(f"the manifest states scenario {chosen[-1]}, but the grid has {full:,}")
    stated = (
        ("seed", manifest.seed, seed),
        ("full", manifest.full, full),
        ("count", manifest.count, count),
        ("methods", len(manifest.methods), len(set(manifest.methods))),
    )
    faults += [f"the manifest states {name} {value}, not {own}" for name, value, own in stated if value != own]
    other = {str(by.get("dtype", manifest.dtype)) for by in manifest.planned_by} - {manifest.dtype}
    return faults + [f"the manifest states dtype {manifest.dtype}, planned by {name}" for name in sorted(other)]


def scenario_faults(run: Run, method: str) -> list[str]:
    """Return one sentence per difference between a method's tables, the manifest and the grid, the first of each kind.

    Raises:
        InputError: If a file or the grid cannot be read.
    """
    targets, scenarios = run.targets(method), run.scenarios(method)
    if faults := [*_row_faults(run, method, targets, scenarios)]:
        return faults
    plans = run.plans(method)
    planned = plans.outcomes.planned
    points = [point for point in run.points() if planned[point.number]]
    numbers = np.array([point.number for point in points], int)
    own = plans.rows(numbers)
    for row, point in enumerate(points):
        if point.config.begins_rad:
            own.start[row] = point.config.begins_rad
    expected = tables.scenario_table(method, points, own, run.manifest.joints, run.varied)
    saved_tracked = np.zeros(plans.exists.shape, bool)
    saved_tracked[targets["scenario"].to_numpy(), targets["target"].to_numpy()] = targets["tracked"].to_numpy(False)
    return [
        *_value_faults(scenarios, expected),
        *_target_faults(numbers, own, saved_tracked[numbers], [point.config for point in points]),
    ]


def _row_faults(run: Run, method: str, targets: pa.Table, scenarios: pa.Table) -> Iterator[str]:
    """Yield faults of the numbers and methods of rows, and of the manifest's counts of them."""
    shards = sorted((shard for shard in run.manifest.shards if shard.method == method), key=lambda shard: shard.first)
    numbers = sorted(number for shard in shards for number in shard.scenario_numbers)
    saved = scenarios["scenario"].to_pylist()
    if saved != numbers:
        yield f"other scenarios: scenarios/ has the rows {_short(saved)}, the manifest {_short(numbers)}"
        return
    counts = scenarios["targets"].to_pylist()
    rows = [(number, k) for number, count in zip(numbers, counts, strict=True) for k in range(count or 0)]
    there = list(zip(targets["scenario"].to_pylist(), targets["target"].to_pylist(), strict=True))
    if there != rows:
        yield f"targets/ has {len(there):,} rows of scenarios and targets that scenarios/ does not have in this order"
    for name, table in (("targets", targets), ("scenarios", scenarios)):
        if others := set(table["method"].to_pylist()) - {method}:
            yield f"{name}/ has rows of the method {min(map(str, others))}"
    if len(numbers) == run.manifest.count and sum(count or 0 for count in counts) != run.manifest.targets:
        yield f"the manifest states {run.manifest.targets:,} targets, scenarios/ {sum(counts):,}"
    of = dict(zip(saved, scenarios["tracked"].to_pylist(), strict=True))
    for shard in shards:
        if (tracked := sum(of[number] or 0 for number in shard.scenario_numbers)) != shard.tracked:
            stated = f"{shard.tracked:,} tracked targets in the shard from scenario {shard.first}"
            yield f"the manifest states {stated}, not {tracked:,}"


def _value_faults(saved: pa.Table, expected: pa.Table) -> Iterator[str]:
    """Yield the first scenario with another value than expected, for each column of the table of scenarios."""
    given = {*labels.parameter_names(expected), "group", "margin_m", "path"}
    given |= {name for name in expected.column_names if name.startswith(("rotation_", "tool_"))}
    for name in expected.column_names:
        was, right = saved[name], expected[name]
        if name in tables.CAUSE or (name in tables.STEPS and was.null_count == len(was)):  # text, or an older version
            continue
        if pa.types.is_floating(right.type):
            a, b = (column.to_numpy().astype(float) for column in (was, right))
            same = np.isclose(a, b, rtol=PRECISION, atol=PRECISION, equal_nan=True)
        else:
            same = np.array([a == b for a, b in zip(was.to_pylist(), right.to_pylist(), strict=True)], bool)
        if not same.all():
            k = int(np.argmin(same))
            what = "other scenarios: scenarios/ has" if name in given else "scenarios/ does not follow from targets/:"
            number = expected["scenario"][k].as_py()
            yield f"{what} {name} {was[k].as_py()} in scenario {number}, expected {right[k].as_py()}"


def _target_faults(numbers: np.ndarray, plans: Plans, saved_tracked: np.ndarray, jobs: Sequence) -> Iterator[str]:
    """Yield the first target with a value that contradicts another one, for each kind of contradiction."""
    tracked, clearance = plans.tracked, plans.clearance
    before = np.concatenate([plans.start[:, None], plans.x[:, :-1]], axis=1)
    margin = np.array([job.margin_m for job in jobs])[:, None]
    straight = np.array([not job.task for job in jobs], bool)[:, None]  # the TCP follows the path
    with np.errstate(invalid="ignore"):
        joint_step = np.linalg.norm(plans.x - before, axis=2)
        residual = np.linalg.norm(plans.tcp - plans.target[..., :3], axis=2)
        right = {  # comparisons with NaN are False, so a missing value is a fault
            "the column tracked differs from the status": saved_tracked == tracked,
            "the clearance is below margin_m": ~tracked | (clearance >= margin - ROUNDING_M),
            "joint_step_rad differs from the configurations": ~tracked
            | (np.abs(joint_step - plans.joint_step) <= RECORD_M),
            "residual_m differs from the TCP's distance": ~(tracked & straight)
            | (np.abs(residual - plans.residual) <= RECORD_M),
            "segment_clearance_m is above clearance_m": ~tracked
            | np.isnan(plans.segment_clearance)
            | (plans.segment_clearance <= clearance + RECORD_M),
        }
    for what, each in right.items():
        if not each.all():
            s, t = np.argwhere(~each)[0].tolist()
            yield f"targets/: {what} in scenario {numbers[s]} at target {t}"


def _short(numbers: Sequence) -> str:
    """Return the first numbers of a list, and its length."""
    return f"{', '.join(map(str, numbers[:8]))}{', ...' if numbers[8:] else ''} ({len(numbers):,})"
