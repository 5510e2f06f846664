"""Results of a validation, as in its file: for code that reads them without validating."""

from typing import NamedTuple

TargetPlace = tuple[int, int]  # scenario and target; for a path, the target at its end


class Refutation(NamedTuple):
    """A tracked configuration that failed validation."""

    method: str
    scenario: int
    target: int
    reason: str


class RowDeviation(NamedTuple):
    """Largest deviation of a row of the task at the path's tracked targets, over all scenarios."""

    row: str  # task.2, and its description
    off: float  # deviation with the largest share of the tolerance
    most: float  # tolerance there
    unit: str  # of both: mm or degrees
    at: TargetPlace


class MethodCheck(NamedTuple):
    """Validation results of one method; None where no value was measured."""

    checked: int  # tracked targets
    refuted: int
    tcp_error_max_mm: float | None  # |site - target|
    clearance_min_mm: float | None
    clearance_min_at: TargetPlace | None
    clearance_less_cover_min_mm: float | None  # minus the covering radius of the mesh, as in plans; None: no mesh
    clearance_off_max_mm: float | None  # |MuJoCo's - saved|, like the next two
    tcp_off_max_mm: float | None
    target_off_max_mm: float | None
    paths: int  # straight joint paths between consecutive tracked targets, and from the start to the first
    paths_touching: int | None  # None if nothing was checked between the targets
    paths_blocked: int
    clearance_between_min_mm: float | None  # along the paths, targets included
    clearance_between_min_at: TargetPlace | None
    line_deviation_max_mm: float | None  # of the TCP from the straight line between two targets
    line_deviation_max_at: TargetPlace | None
    speed_ratio_max: float | None  # joint speed by its limit at the feed rate; None if the model has no limits
    speed_joint: str | None  # the joint with this ratio
    speed_at: TargetPlace | None
    in_place_max_rad: float | None  # largest joint change between targets closer than the tolerance, for which there
    # is no time at the feed rate; also from the start to the first target
    rows: tuple[RowDeviation, ...]  # rows of the task, if the job has one


class Validation(NamedTuple):
    """The result of `validate`."""

    validated: bool
    methods: dict[str, MethodCheck]
    refuted: tuple[Refutation, ...]
    between: int
    feed_mm_s: float
    seconds: float
    files: dict[str, str]  # SHA-256 of what was validated
    excluded: str | None = None  # the unchecked capsules with the largest overlap, and its size
    unchecked: tuple[str, ...] = ()  # sentences on obstacles and rows that are not checked


ROUNDING_M = 1e-9  # two ways to compute a clearance differ by 1e-15; width of comparisons with 0 and the tolerance
RECORD_M = 1e-5  # a saved value with a larger error is refuted; 32-bit planners are within it
STEP_RAD = 0.002  # largest joint step between two checks; a point 2 m away moves by 4 mm
ONE_POINT_M = 1e-5  # targets closer to each other coincide: a line between them has no direction
