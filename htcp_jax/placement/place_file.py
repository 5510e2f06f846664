"""PLACE.yaml: search variables, objective and budget of a search for mountings that complete all of a job's seams.

config: ../configs/duct.yaml                    # the job; without this key the default job
place:                                          # ranges, see `ranges`
  workpiece.rotation_y_rad: [0.0, 1.0]
  workpiece.shift_m: [[-0.2, 0.2], [-0.2, 0.2], [0.0, 0.1]]
objective: clearance                                # or cycle time, joint motion; a list of two gives a Pareto front
within: {scenarios: 2000}                       # or {seconds: 60}
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from pydantic import Field, field_validator, model_validator

from htcp_jax.errors import InputError
from htcp_jax.jobs import build, load_config, resolve, source_of
from htcp_jax.placement.ranges import Ranges, read_ranges
from htcp_jax.planning import registry
from htcp_jax.spec import PlanConfig, examples, strict_model

CLEARANCE, CYCLE_TIME = "clearance", "cycle time"
OBJECTIVES = CLEARANCE, CYCLE_TIME, "joint motion"


class Budget(strict_model.FileSection):
    """Budget of a search: a maximum number of scenarios, or a time limit in seconds."""

    scenarios: Annotated[int, Field(gt=0, le=1_000_000)] | None = None
    seconds: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _one_of_them(self) -> "Budget":
        if (self.scenarios is None) == (self.seconds is None):
            raise InputError("within must be either {scenarios: N} or {seconds: S}")
        return self


class Perturbation(strict_model.FileSection):
    """Bounds of a perturbation [mm, degrees]; a perturbation changes all parameters of a mounting at once."""

    mm: float = Field(3.0, gt=0, le=1000)
    deg: float = Field(0.5, gt=0, le=90)


class PlaceFile(strict_model.FileSection):
    """Contents of a PLACE.yaml."""

    config: str | None = None
    place: dict[str, Any] = Field(default_factory=dict)
    objective: tuple[str, ...] = ("clearance",)
    feed: str = "20mm/s"  # feed rate of the tool, if the cycle time is an objective
    within: Budget = Budget(scenarios=2000)
    perturbation: Perturbation = Perturbation()
    best: int = Field(20, ge=1, le=1000)  # maximum number of mountings that are confirmed as proven motions
    tolerances: int = Field(3, ge=0, le=1000)  # maximum number of mountings whose tolerance is determined
    screen: str = "beam"  # planning method of the quick plans, with the settings `scores.QUICK`
    confirm: str = "beam"  # planning method of the confirmed motions
    seed: int = Field(0, ge=0)

    @field_validator("objective", mode="before")
    @classmethod
    def _one_or_two(cls, value: Any) -> Any:
        names = [value] if isinstance(value, str) else value
        if not isinstance(names, list | tuple) or not 1 <= len(names) <= 2 or len(set(map(str, names))) < len(names):
            raise InputError(
                f"objective is {value!r}; it must be one objective or a list of two: {', '.join(OBJECTIVES)}"
            )
        for name in names:
            if name not in OBJECTIVES:
                raise InputError(f"unknown objective {name!r}; valid: {', '.join(OBJECTIVES)}")
        return tuple(names)

    @field_validator("screen", "confirm")
    @classmethod
    def _is_a_method(cls, name: str) -> str:
        if name not in registry.names():
            raise InputError(f"unknown method {name!r}; valid: {', '.join(registry.names())}")
        return name


class Search(NamedTuple):
    """Contents of a PLACE.yaml, read and checked, with its job."""

    name: str
    file: PlaceFile
    config: dict[str, Any] | str | None  # the job, in a form that `load_sweep` accepts
    overrides: tuple[str, ...]
    job: PlanConfig
    ranges: Ranges
    seams: tuple[str, ...]  # names of the job's seams; empty if it has one


def load_search(
    spec: str | Path | Mapping[str, Any],
    config: str | Path | None = None,
    overrides: Sequence[str] = (),
    changes: Mapping[str, Any] | None = None,
) -> Search:
    """Read and check a search.

    Args:
        spec: The path of a PLACE.yaml, the name of an example, or a mapping with the same keys. Files in a mapping are
            relative to the working folder.
        config: The job, in place of the search's own.
        overrides: Changes to the job, each "dotted.key=value".
        changes: Changes to the search, value by key.

    Raises:
        InputError: If the search or the job is invalid, or if seams are listed here and not in the job.
    """
    path, raw = examples.read_mapping(spec, "place")
    raw = {**raw, **(changes or {})}
    if "seams" in raw:
        raise InputError(f"{path}: seams has moved to the job: list them there, each as {{name: ..., path: ...}}")
    file: PlaceFile = strict_model.validate_model(raw, PlaceFile, str(path))
    if config is None and file.config is not None:
        config = examples.example_or_path(file.config, path.parent)
    job = load_config(config, overrides)
    robot = build.robot_of(job.robot, tree=job.tree)
    job = resolve(job, robot, source_of(config))
    ranges = read_ranges(f"{path}: place", file.place, robot.joint_names, job.model_dump())
    names = tuple(seam.name for seam in job.workpiece.seams)
    seams = names if len(names) > 1 else ()
    if file.within.scenarios is not None and file.within.scenarios < len(seams):
        raise InputError(f"{path}: within: scenarios must be at least {len(seams)}, the number of seams")
    return Search(path.stem, file, None if config is None else str(config), tuple(overrides), job, ranges, seams)
