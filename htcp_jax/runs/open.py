"""Opening of saved plans, with one interface for the folders of `htcp sweep`, `htcp place` and `htcp plan`.

    found = open_plans("out/workpiece")
    found.plans("hybrid").outcomes.complete     # row s is scenario s
    found.jobs[12]                              # scenario 12 as a separate job

The viewer, the report and the validation use it.
"""

from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from htcp_jax.errors import InputError
from htcp_jax.motion import Plans, Retract, ViaPoints, plans
from htcp_jax.runs import parameters, tables
from htcp_jax.runs.finite import check_arrays
from htcp_jax.runs.identity import file_hash, other_format, recorded_config, refuse_changed
from htcp_jax.runs.manifest import MANIFEST
from htcp_jax.runs.parameters import Parameters
from htcp_jax.runs.plan_folder import SUMMARY, TRAJECTORY, PlanRecord, read_plan
from htcp_jax.runs.run_folder import Run, open_run
from htcp_jax.runs.seam_order import SeamOrder
from htcp_jax.spec import PlanConfig
from htcp_jax.system import files

# Names in the folder of a placement search: the file with its request, and the run folder of the best placements.
SEARCH, MOTIONS = "place.json", "ranked"


class RunPlans:
    """Plans of a run. In an unfinished run, a method has results for some of the scenarios."""

    missing: Mapping[str, str] = MappingProxyType({})  # reasons for seams that the plans lack, by name

    def __init__(self, run: Run):
        shards = run.manifest.shards
        self.run, self.folder = run, run.folder
        self.methods = tuple(dict.fromkeys(shard.method for shard in shards))  # names of the methods with results
        self.count = sum(shard.scenarios.rows for shard in shards)  # number of saved plans, over all methods
        self.config = run.config  # configuration shared by the scenarios
        self.mixed = bool(run.varied)  # True if arms, parts, cells or settings differ
        self.files = run.result_files()  # SHA-256 of the files with results, by name in the folder

    def plans(self, method: str) -> Plans:
        """Return the plans of one method, read from disk; row s is scenario s.

        Raises:
            InputError: If a file is damaged.
        """
        return self.run.plans(method)

    @cached_property
    def jobs(self) -> list[PlanConfig]:
        """The complete configuration of each scenario, by number.

        Raises:
            InputError: If the grid cannot be read.
        """
        return [point.config for point in self.run.points()]

    @cached_property
    def parameters(self) -> dict[int, Parameters]:
        """Start, workpiece pose and tool extension of the scenarios with results, by number.

        Raises:
            InputError: If a file is damaged.
        """
        joints = self.run.manifest.joints
        return {
            row["scenario"]: parameters.of_row(row, joints) for row in self.run.scenarios(*self.methods).to_pylist()
        }

    @cached_property
    def labels(self) -> dict[int, str]:
        """Labels of the scenarios, by number, see `labels.labels_of`.

        Raises:
            InputError: If a file is damaged.
        """
        return self.run.labels()


class RankedPlans(RunPlans):
    """Plans of the ranked placements of a search, the best placement first.

    Each placement has one scenario per seam.
    """

    def __init__(self, run: Run, seams: int):
        super().__init__(run)
        self._seams = seams

    @cached_property
    def labels(self) -> dict[int, str]:
        """Labels of the scenarios, by number; each begins with the rank of its placement.

        Raises:
            InputError: If a file is damaged.
        """
        reported = self.run.labels()
        return {
            number: f"rank {number // self._seams + 1}" + (f", {text}" if text else "")
            for number, text in reported.items()
        }


class FolderPlan:
    """The plan in a folder of `htcp plan`, as scenario 0; it has the same interface as `RunPlans`.

    Raises:
        InputError: If the configuration cannot be read, or if the arrays do not form one plan.
    """

    def __init__(self, folder: Path, record: PlanRecord):
        self.folder, self.methods, self.count, self.mixed = folder, (record.method,), 1, False
        self._order, self.missing = record.order, record.missing  # reasons for seams that the plan lacks, by name
        self.config = recorded_config(record.config, folder / SUMMARY)
        self.jobs, self.parameters, self.labels = [self.config], {0: parameters.of_job(self.config)}, {0: ""}
        self.files = {TRAJECTORY: file_hash(folder / TRAJECTORY)}
        joints = record.arrays["x"].shape[-1]
        _check_shapes(folder / TRAJECTORY, record.arrays, joints)
        check_arrays(record.arrays, tables.READ | {"x": "x", "tcp": "tcp", "target": "target_xyz"}, folder / TRAJECTORY)
        via_points = _read_via_points(folder / TRAJECTORY, record, joints)
        arrays = {name: array[None] for name, array in record.arrays.items()}
        seams = _read_seams(folder / TRAJECTORY, record, joints)
        self._plans = Plans(**arrays, via_points=via_points, compile_s=0.0, run_s=0.0, **seams)

    @property
    def order(self) -> SeamOrder | None:
        """Order of the plan's seams; None for one seam.

        Raises:
            InputError: If another version of the package has written it.
        """
        try:
            return None if self._order is None else SeamOrder.read(self._order)
        except (KeyError, TypeError) as error:
            raise other_format(self.folder, f"{SUMMARY} has another order: {files.one_line(error)}") from None

    def plans(self, method: str) -> Plans:
        """Return the plan, with a scenario axis of length 1 in each array. Its run times are 0; they are not saved."""
        del method  # the folder has results of one method only
        return self._plans


FLOATS = frozenset(name for name, empty in plans.EMPTY.items() if isinstance(empty, float)) | {"start"}
PlanSet = RunPlans | FolderPlan


def open_plans(folder: str | Path) -> PlanSet:
    """Open the plans in a folder of `htcp sweep` or `htcp plan`, or the ranked plans of `htcp place`.

    Raises:
        InputError: If the folder is none of these, has no results or no ranked placement, or has a damaged file, or if
            a cloud, path or model has changed since planning.
    """
    folder = Path(folder)
    if (folder / MANIFEST).exists():
        return plans_of_run(open_run(folder))
    if (folder / SUMMARY).exists():
        record = read_plan(folder)
        refuse_changed(record.files, folder)
        return FolderPlan(folder, record)
    if (folder / SEARCH).exists():
        return _open_ranked(folder)
    raise InputError(f"{folder} contains neither a run of htcp sweep ({MANIFEST}) nor a plan of htcp plan ({SUMMARY})")


def run_folder(folder: Path) -> Path:
    """Return the folder with the plans: for a placement search, its run of the best placements; else `folder`.

    Raises:
        InputError: If the search has no ranked placement.
    """
    if (folder / MANIFEST).exists() or not (folder / SEARCH).exists():
        return folder
    if not (folder / MOTIONS / MANIFEST).exists():
        raise InputError(f"{folder} is a search of htcp place without a ranked mounting")
    return folder / MOTIONS


def plans_of_run(run: Run) -> RunPlans:
    """Return the plans of an opened run.

    Raises:
        InputError: If the run has no results, or if an input file has changed since planning.
    """
    _refuse_unfit(run)
    return RunPlans(run)


def _refuse_unfit(run: Run) -> None:
    refuse_changed(run.manifest.files, run.folder)
    if not run.manifest.shards:
        raise InputError(f"{run.folder} has no finished shard yet; run the sweep first")


def _open_ranked(folder: Path) -> RankedPlans:
    """Open the ranked plans of a placement search.

    Raises:
        InputError: If the search has no ranked placement, or if a file is damaged.
    """
    run = open_run(run_folder(folder))
    try:
        seams = files.read_json(folder / SEARCH, folder)["seams"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder / SEARCH} is damaged: {files.cause(error, folder / SEARCH)}") from None
    _refuse_unfit(run)
    return RankedPlans(run, max(1, len(seams)))


def _read_via_points(file: Path, record: PlanRecord, joints: int) -> ViaPoints:
    """Return the via points of a saved plan.

    Raises:
        InputError: If an array has the wrong shape or type, or contains NaN or infinity.
    """
    target, x, share = record.via_points
    kinds = target.dtype.kind in "iu" and x.dtype.kind == share.dtype.kind == "f"
    if x.shape != (len(target), joints) or share.shape != target.shape or not kinds:
        raise InputError(f"{file} is damaged: the via points have the shape {x.shape}")
    wrong = ~((np.abs(x) < files.LARGEST_NUMBER).all(axis=1) & (np.abs(share) < files.LARGEST_NUMBER))
    if wrong.any():
        raise InputError(f"{file} is damaged: a via point to target {target[wrong.argmax()]} is NaN or infinite")
    return ViaPoints(np.zeros(len(target), np.int32), target, x, share)


def _read_seams(file: Path, record: PlanRecord, joints: int) -> dict[str, Any]:
    """Return the fields of `Plans` for several seams.

    Raises:
        InputError: If the first targets of seams do not ascend, or if the retraction is not one.
    """
    count, begins = record.arrays["status"].size, record.seam_begins
    if begins.ndim != 1 or begins.dtype.kind not in "iu" or (np.diff([0, *begins, count]) <= 0).any():
        raise InputError(f"{file} is damaged: seam_begins is {begins}, for {count} targets")
    if record.retract is None:
        return {"seam_begins": tuple(begins.tolist())}
    x, clearance = record.retract
    finite = x.dtype.kind == clearance.dtype.kind == "f" and (np.abs(x) < files.LARGEST_NUMBER).all()
    if x.shape != (len(clearance), joints) or not finite or not (np.abs(clearance) < files.LARGEST_NUMBER).all():
        raise InputError(f"{file} is damaged: the retraction has the shape {x.shape}, or is not finite")
    return {"seam_begins": tuple(begins.tolist()), "retract": Retract(x, clearance)}


def _check_shapes(file: Path, arrays: dict[str, np.ndarray], joints: int) -> None:
    """Check that arrays form one plan.

    Raises:
        InputError: If the shape or the type of an array is wrong.
    """
    count = arrays["status"].size
    shapes = {"start": (joints,), "x": (count, joints), "tcp": (count, 3), "target": (count, 3)}
    for name, array in arrays.items():
        if array.shape != shapes.get(name, (count,)) or array.dtype.kind not in ("f" if name in FLOATS else "iu"):
            raise InputError(f"{file} is damaged: {name} has the shape {array.shape} and the type {array.dtype}")
