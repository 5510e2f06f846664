"""Saved results to validate, read from the folder of a run or a plan."""

from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path

import numpy as np

from htcp_jax.jobs import build
from htcp_jax.model import Workpiece
from htcp_jax.motion import Plans
from htcp_jax.runs import PlanSet, Run, open, open_plans
from htcp_jax.spec import PlanConfig
from htcp_jax.spec import config as configs
from htcp_jax.status import MOTION, SegmentStatus
from htcp_jax.validation.scene_rules import Results, Track, WorkpieceData

MOST_WORKPIECES = 8  # maximum number of workpieces in memory


def read_results(source: Path | Run) -> Results:
    """Read the results of a run, or in the folder of a run or a plan.

    Raises:
        InputError: If the folder contains no plans, or if a file is missing or damaged.
    """
    found = open.plans_of_run(source) if isinstance(source, Run) else open_plans(source)
    return Results(found.folder, _workpieces(), found.count, _tracks(found), found.files, found.missing)


def _tracks(found: PlanSet) -> Iterator[Track]:
    """Yield the tracks of all scenarios, method by method, so that only one method's results are in memory."""
    for method in found.methods:
        plans = found.plans(method)
        for number in np.flatnonzero(plans.outcomes.planned).tolist():
            yield _track(method, number, found.jobs[number], plans)


def _track(method: str, number: int, config: PlanConfig, plans: Plans) -> Track:
    there = plans.exists[number]
    proven, has_via_points = np.isin(plans.segment_status, MOTION), np.zeros(plans.exists.shape, bool)
    has_via_points[plans.via_points.scenario, plans.via_points.target] = True
    claimed = proven | (has_via_points & (plans.segment_status == SegmentStatus.NOT_CHECKED))
    flags = plans.tracked, plans.path_clear == 0, proven, claimed
    columns = plans.x, plans.tcp, plans.target, plans.clearance, plans.segment_clearance
    return Track(
        method,
        number,
        config,
        plans.start[number],
        *(column[number][there] for column in flags),
        *(
            tuple(of(number, target) for target in range(int(there.sum())))
            for of in (plans.via_points.on_segment, plans.via_points.shares_on)
        ),
        *(column[number][there] for column in columns),
    )


def data_of(loaded: Workpiece) -> WorkpieceData:
    """Return a loaded workpiece's data for validation, without computed data such as hull, normals and tangents."""
    mesh, cover_m = loaded.triangles, loaded.covering_radius_m
    own = loaded.cloud, loaded.path, loaded.inlet, mesh, cover_m
    return WorkpieceData(*own, *loaded.frames, seam_begins=loaded.seam_begins)


def _workpieces() -> Callable[[PlanConfig], WorkpieceData]:
    """Return a cached function that loads a job's workpiece; it samples a mesh as densely as the job's arm requires."""

    @lru_cache(maxsize=MOST_WORKPIECES)
    def load(part: configs.WorkpieceConfig, arm: tuple) -> WorkpieceData:
        return data_of(build.workpiece_of(part, build.robot_of(*arm)))

    return lambda config: load(build.workpiece_key(config), build.robot_key(config))
