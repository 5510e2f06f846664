"""Data types for the results of a validation."""

from typing import NamedTuple

TargetPlace = tuple[int, int]  # scenario and target; a joint path has the target at its end


class Refutation(NamedTuple):
    """Tracked target whose configuration or segment failed validation."""

    method: str
    scenario: int
    target: int
    reason: str


class RowDeviation(NamedTuple):
    """Largest deviation from a row of the task at tracked targets of the path, over all scenarios."""

    row: str  # name and description of the row, such as "task.2: axis tcp.z"
    off: float  # deviation with the largest ratio to its tolerance
    most: float  # tolerance at this target
    unit: str  # unit of both: mm or degrees
    at: TargetPlace


class MethodCheck(NamedTuple):
    """Validation results of one method; None for values that were not measured."""

    checked: int  # number of tracked targets
    refuted: int
    tcp_error_max_mm: float | None  # largest distance from its target of the point that follows the path, or the TCP
    tcp_error_max_at: TargetPlace | None
    clearance_min_mm: float | None
    clearance_min_at: TargetPlace | None
    clearance_less_cover_min_mm: float | None  # minimum clearance minus the mesh's covering radius; None: no mesh
    clearance_off_max_mm: float | None  # this and the next two: largest difference of MuJoCo's and the saved value
    tcp_off_max_mm: float | None
    target_off_max_mm: float | None
    paths: int  # number of straight joint paths between consecutive tracked targets, and from the start to the first
    paths_touching: int | None  # number of colliding paths; None if paths were not checked
    paths_blocked: int
    clearance_between_min_mm: float | None  # minimum along the joint paths, including their ends
    clearance_between_min_at: TargetPlace | None
    line_deviation_max_mm: float | None  # largest distance of the TCP from the line between two targets, where proven
    line_deviation_max_at: TargetPlace | None
    speed_ratio_max: float | None  # largest joint speed / limit, at `feed_mm_s`; None without limits
    speed_joint: str | None  # joint with this ratio
    speed_at: TargetPlace | None
    in_place_max_rad: float | None  # largest joint change between targets closer than the tolerance, for which the
    # feed rate leaves no time, or from the start to the first target
    rows: tuple[RowDeviation, ...]  # for each row of the task; empty if the job has none


class Validation(NamedTuple):
    """Result of `validate_results`."""

    validated: bool
    methods: dict[str, MethodCheck]
    refuted: tuple[Refutation, ...]
    between: int
    feed_mm_s: float
    seconds: float
    files: dict[str, str]  # SHA-256 of the validated files
    excluded: str | None = None  # unchecked capsules with the largest overlap, and its depth, as text
    unchecked: tuple[str, ...] = ()  # sentences on seams, obstacles and rows that are not checked


ROUNDING_M = 1e-9  # rounding error allowed in comparisons with 0 and with tolerances
RECORD_M = 1e-5  # maximum error of a saved value, which 32-bit planners satisfy
STEP_RAD = 0.002  # maximum joint step between two checks; a point 2 m away moves by 4 mm
ONE_POINT_M = 1e-5  # targets closer than this coincide, and the line between them has no direction
