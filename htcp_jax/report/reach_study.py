"""Reach study: each target of a job or a sweep classified by itself, with a table and a picture.

`htcp reachability --each` runs it with a progress bar and writes its files.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np
import pyarrow as pa

from htcp_jax import viewer
from htcp_jax.clearance.obstacles import all_obstacles
from htcp_jax.device import tables as lanes
from htcp_jax.jobs import Batch, grid_axes, load_sweep_or_job
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import lane_inputs
from htcp_jax.notebook import html_facts
from htcp_jax.reachability import (
    PROOF_CELLS,
    RESOLUTION_RAD,
    EachTarget,
    Memo,
    Reach,
    Reachability,
    memo,
    obstruction,
    reachable_prefixes,
)
from htcp_jax.report.document import Table, png, write_csv
from htcp_jax.report.tables import reach_rows
from htcp_jax.runs import columns, reachability_file, tables
from htcp_jax.system import files, output_files

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure


TABLE, PICTURE = "reach.csv", "reach.png"  # files in addition to reachability_file.REACHABILITY
LISTED = 12  # maximum number of ranges of targets in a row of the table


@dataclass(frozen=True, eq=False, repr=False)
class ReachStudy:
    """Reach (reachable, excluded or undecided) of every target on the path, for a job or a sweep's scenarios."""

    name: str
    batch: Batch
    found: Reachability
    requested_rad: float  # requested angular resolution of the tool orientations
    proof_cells: int
    seed: int

    @property
    def each(self) -> EachTarget:
        """Results for every target; targets before the path's first one are not classified."""
        return self.found.each

    @cached_property
    def counts(self) -> dict[Reach, int]:
        """Number of targets by reach, over all scenarios."""
        return {reach: int((self.each.reach == reach).sum()) for reach in Reach if reach != Reach.NOT_JUDGED}

    @cached_property
    def reasons(self) -> dict[tuple[int, int], str]:
        """Reason as text by (scenario, target), for every target that is not reachable."""
        reach = self.each.reach
        found = {(s, t): Reach(int(reach[s, t])).message for s, t in np.argwhere(reach > Reach.REACHABLE).tolist()}
        for number, cell in enumerate(self.batch.cells):
            open_ = np.argwhere((reach == Reach.UNDECIDED) & (self.batch.cell == number)[:, None])
            own, measured = open_[~np.isnan(self.each.x[tuple(open_.T)]).any(axis=1)], []
            if len(own):
                scenarios = scenario_functions.with_goals_of(self.batch.scenarios, cell.task.numbers)
                inputs, x = lane_inputs.lane_inputs(scenarios, *own.T), self.each.x[tuple(own.T)]
                walls = all_obstacles(cell.workpiece, cell.obstacles)
                measured = obstruction.obstructions(
                    cell.robot, walls, inputs, x, inputs.target, cell.settings, cell.task
                )
            found |= {(s, t): "undecided: no configuration was found on the target" for s, t in open_.tolist()}
            for (s, t), at in zip(own.tolist(), measured, strict=True):
                found[s, t] = self._closest(s, t, at)
        return found

    def _closest(self, s: int, t: int, at: obstruction.Obstruction) -> str:
        """Return a description of the configuration with the largest clearance found at an undecided target.

        Args:
            s: The scenario's row.
            t: The target.
            at: The obstruction in this configuration.
        """
        clearance_m, margin_m = self.each.clearance_m[s, t], self.batch.scenarios.margin_m[s]
        if clearance_m >= margin_m:
            return "undecided: in every clear configuration found, the bare tip passes through a wall"
        how = f"{1e3 * abs(clearance_m):.3g} mm"
        how = f"{how} inside" if clearance_m <= 0 else f"only {how} clear of"
        return f"undecided: in the clearest configuration found, {at.body_label or at.body} is {how} {at.other}"

    def summary(self) -> Table:
        """Return the table of the targets by reach: their number, and the targets by scenario or seam."""
        rows = [row | {"target_numbers": self._named(row["value"])} for row in reach_rows(self.each.reach)]
        return Table.of("reach-summary", ("reach", "targets", "percent", "target_numbers"), rows).without_empty()

    def _named(self, reach: int) -> str:
        """Return the targets with this reach as text, at most LISTED scenarios with the name of each, if several."""
        found = {
            s: ranges(np.flatnonzero(own == reach)) for s, own in enumerate(self.each.reach) if (own == reach).any()
        }
        if len(self.each.reach) == 1:
            return "".join(found.values())
        words = [f"{self._scenario_name(s)}: {text}" for s, text in found.items()]
        return "; ".join(words[:LISTED]) + ("; ..." if len(words) > LISTED else "")

    def _scenario_name(self, s: int) -> str:
        return ", ".join([f"scenario {self.batch.points[s].number}", *seam_names(self.batch)[s : s + 1]])

    def unreached(self) -> Table:
        """Return the table of the targets that are not reachable, with the reason; targets with the same one are a row.

        It has at most LISTED rows.
        """
        found: dict[tuple[int, str], list[int]] = {}
        for (s, t), reason in sorted(self.reasons.items()):
            found.setdefault((s, reason), []).append(t)
        rows = [
            {"scenario": self._scenario_name(s), "target_numbers": ranges(np.array(own)), "reason": reason}
            for (s, reason), own in list(found.items())[:LISTED]
        ]
        keys = ("scenario", "target_numbers", "reason")[len(self.each.reach) == 1 :]
        return Table.of("reach-reasons", keys, rows)

    def table(self) -> Table:
        """Return the table of all targets on the path: position in the world, reach, reason, and a configuration.

        Only reachable targets have a configuration; only the others have a reason.
        """
        joints = tables.joint_columns(self.batch.robot)
        places = (f"target_{axis}_m" for axis in "xyz")
        seams = seam_names(self.batch)
        keys = "scenario", *(("seam",) if seams else ()), "target", "waypoint", *places, "reach", "reason", *joints
        scenarios, rows = self.batch.scenarios, []
        for s, t in np.argwhere(self.each.reach != Reach.NOT_JUDGED).tolist():
            reach = Reach(int(self.each.reach[s, t]))
            place, x = scenarios.targets[s, t].tolist(), self.each.x[s, t]
            x = x.tolist() if reach == Reach.REACHABLE else [None] * len(joints)
            waypoint = t - int(scenarios.on_path[s])
            number = self.batch.points[s].number
            seam = seams[s : s + 1]
            rows.append((number, *seam, t, waypoint, *place, reach.words, self.reasons.get((s, t)), *x))
        return Table("reach", columns.of(*keys), tuple(rows))

    def frame(self) -> "pandas.DataFrame":
        """Return `table` as a pandas frame.

        Raises:
            InputError: If pandas is not installed.
        """
        return tables.table_frame(pa.Table.from_pylist(self.table().records()))

    def figure(self) -> "Figure":
        """Draw the workpiece with every target coloured by reach."""
        panels, seams = [], seam_names(self.batch)
        for s, point in enumerate(self.batch.points):
            cell, T = self.batch.cells[self.batch.cell[s]], np.asarray(self.batch.scenarios.T_world_workpiece[s])
            own = self.each.reach[s] != Reach.NOT_JUDGED
            panels.append(
                viewer.ReachPanel(
                    ": ".join([f"scenario {point.number}", *seams[s : s + 1]]) if len(self.batch.points) > 1 else "",
                    cell.workpiece.shown @ T[:3, :3].T + T[:3, 3],
                    np.asarray(self.batch.scenarios.targets[s])[own],
                    self.each.reach[s][own],
                    np.asarray(cell.robot.T_parent_joint)[0, :3, 3],
                )
            )
        return viewer.draw_reach(
            panels, f"{self.name}: {self.counts[Reach.REACHABLE]:,} of {self._total:,} targets reachable"
        )

    @property
    def _total(self) -> int:
        return sum(self.counts.values())

    def record(self) -> dict[str, Any]:
        """Return the contents of reachability.json."""
        return record_of(self.batch, self.found, self.requested_rad, self.proof_cells, self.seed)

    def write(self, folder: Path) -> None:
        """Write reachability.json, reach.csv and reach.png into an existing folder."""
        output_files.write_json(folder / reachability_file.REACHABILITY, self.record())
        write_csv(folder / TABLE, self.table())
        files.write_atomically(folder, PICTURE, png(self.figure()))

    def save(self, folder: str | Path) -> None:
        """Write reachability.json, reach.csv and reach.png into `folder`: all of them or none.

        Raises:
            InputError: If the files cannot be written.
        """
        with output_files.written_whole(Path(folder)) as scratch:
            self.write(scratch)

    def __repr__(self) -> str:
        return f"ReachStudy({self.name}, {self.counts[Reach.REACHABLE]} of {self._total} targets reachable)"

    def _repr_html_(self) -> str:
        return html_facts(self.name, {str(row[0]): f"{row[1]:,} ({row[2]:.1f} %)" for row in self.summary().rows})


def reach_study(
    config: str | Path | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
    *,
    limit: int | None = None,
    resolution_rad: float = RESOLUTION_RAD,
    proof_cells: int = PROOF_CELLS,
    progress: Callable[[int, int], None] | None = None,
) -> ReachStudy:
    """Classify every target of a job or a sweep by itself as reachable, excluded or undecided.

    Args:
        config: A job or a sweep: its file, the name of an example, or a mapping of its keys.
        overrides: Changes to the job, as for `plan`.
        limit: Maximum number of scenarios of a sweep; None: all.
        resolution_rad: Angular resolution of the searched tool orientations [rad].
        proof_cells: Maximum number of cells in a proof that a target is unreachable; 0: no proofs.
        progress: Function that is called with the numbers of finished targets and of all targets of a step.

    Raises:
        InputError: If the input is invalid.
    """
    spec = load_sweep_or_job(config, None, overrides)
    batch = spec.batch(limit)
    report = progress or (lambda done, count: None)
    found = search_batch(batch, resolution_rad, proof_cells, True, lambda _, done, count, *step: report(done, count))
    return ReachStudy(spec.name, batch, found, resolution_rad, proof_cells, spec.config.settings.seed)


def search_batch(
    batch: Batch,
    resolution_rad: float,
    proof_cells: int,
    each: bool,
    progress: Callable[..., None],
    known: Memo = memo.compute_all,
) -> Reachability:
    """Return the reachability of a batch's scenarios, in their order.

    Args:
        batch: The scenarios.
        resolution_rad: Angular resolution of the searched tool orientations [rad].
        proof_cells: Maximum number of cells in a proof that a target is unreachable; 0: no proofs.
        each: True to also classify every target on the path by itself.
        progress: Function that is called with the number of the batch's cell (robot and scene), and then with the
            arguments of the function `progress` of `reachable_prefixes`.
        known: Results of an earlier, interrupted search of the batch.
    """
    parts = []
    for number, cell in enumerate(batch.cells):
        rows = np.flatnonzero(batch.cell == number)
        found = reachable_prefixes(
            cell.robot,
            cell.workpiece,
            scenario_functions.with_goals_of(jax.tree.map(itemgetter(rows), batch.scenarios), cell.task.numbers),
            cell.settings,
            task=cell.task,
            obstacles=cell.obstacles,
            resolution_rad=resolution_rad,
            proof_cells=proof_cells,
            each=each,
            progress=lambda *step, number=number: progress(number, *step),
            memo=memo.of_rows(known, rows),
        )
        parts.append((rows, found))
    order = np.argsort(np.concatenate([rows for rows, _ in parts]))
    return lanes.gather(lanes.concatenate([found for _, found in parts]), order)


def record_of(batch: Batch, found: Reachability, requested_rad: float, proof_cells: int, seed: int) -> dict:
    """Return the contents of reachability.json, without the comparison with a run's methods.

    Args:
        batch: The scenarios.
        found: The scenarios' reachability.
        requested_rad: Requested angular resolution of the tool orientations [rad].
        proof_cells: Maximum number of cells in a proof; 0: no proofs.
        seed: Seed of the search.
    """
    record = {
        "prefix": found.prefix.tolist(),
        "best_mm": [None if np.isnan(b) else 1e3 * b for b in found.best],
        "most": found.most.tolist(),
        "resolution_rad": _resolution(batch, found, requested_rad),
        "proof_cells": proof_cells,
        "seed": seed,
        "targets": int(batch.scenarios.count.sum()),
    }
    if seams := seam_names(batch):
        record["seams"] = seams
    if found.each is not None:
        record["each"] = [[Reach(number).words for number in row] for row in found.each.reach.tolist()]
    return record


def seam_names(batch: Batch) -> list[str]:
    """Return the name of each scenario's seam; empty if the job has one seam."""
    return [json.loads(own[grid_axes.SEAM]) for point in batch.points if grid_axes.SEAM in (own := point.varied)]


def _resolution(batch: Batch, found: Reachability, requested_rad: float) -> float | None:
    """Return the coarsest angular resolution that the search used [rad]; None if a task does not constrain the TCP."""
    if not all(cell.task.holds_tcp for cell in batch.cells):
        return None
    return max(requested_rad, float(found.resolution_rad.max()))


def ranges(numbers: np.ndarray) -> str:
    """Return ascending numbers as text in ranges, such as "3-17, 22", with at most LISTED ranges."""
    parts = np.split(numbers, np.flatnonzero(np.diff(numbers) > 1) + 1)
    words = [f"{own[0]}-{own[-1]}" if len(own) > 1 else f"{own[0]}" for own in parts]
    return ", ".join(words[:LISTED]) + (", ..." if len(words) > LISTED else "")
