"""What a validation comes to, as its file holds it: for those who read it and do not check anything themselves."""

from typing import NamedTuple

Place = tuple[int, int]  # scenario and target, of a path the one that it leads to


class Refuted(NamedTuple):
    """A tracked configuration that does not stand."""

    method: str
    scenario: int
    target: int
    reason: str


class RowHeld(NamedTuple):
    """How a row of the task is held at the path's tracked targets, by all scenarios together."""

    row: str  # task.2, and what it is of
    off: float  # where that is the largest share of what is allowed
    most: float  # what is allowed there
    unit: str  # of both: mm or degrees
    at: Place


class MethodCheck(NamedTuple):
    """What was found for one method; None where there was nothing to measure."""

    checked: int  # tracked targets
    refuted: int
    tcp_error_max_mm: float | None  # |site - target|
    clearance_min_mm: float | None
    clearance_min_at: Place | None
    clearance_less_cover_min_mm: float | None  # less the covering radius of the mesh, as plans have it; None: no mesh
    clearance_off_max_mm: float | None  # |MuJoCo's - recorded|, so are the next two
    tcp_off_max_mm: float | None
    target_off_max_mm: float | None
    paths: int  # straight joint paths between consecutive tracked targets, and from the start to the first
    paths_touching: int | None  # of them; None where nothing was looked at between the targets
    paths_blocked_on_record: int
    clearance_between_min_mm: float | None  # along the paths, targets included
    clearance_between_min_at: Place | None
    line_deviation_max_mm: float | None  # of the TCP from the straight line between two targets
    line_deviation_max_at: Place | None
    speed_ratio_max: float | None  # joint speed by its limit at the feed rate; None where the model has no limits
    speed_joint: str | None  # whose it is
    speed_at: Place | None
    in_place_max_rad: float | None  # largest joint change between targets closer than the tolerance, for which the
    # feed rate leaves no time; among them the one from the start to the first target
    rows: tuple[RowHeld, ...]  # of the task, where the job has one


class Validation(NamedTuple):
    """The result of `validate`."""

    validated: bool
    methods: dict[str, MethodCheck]
    refuted: tuple[Refuted, ...]
    between: int
    feed_mm_s: float
    seconds: float
    files: dict[str, str]  # SHA-256 of what was validated
    excluded: str | None = None  # the capsules that overlap most of those that are not checked, and by how much


ROUNDING_M = 1e-9  # two ways to compute a clearance differ by 1e-15; 0 and the tolerance are meant to this width
RECORD_M = 1e-5  # a record further off is refuted; 32-bit planners are within it
STEP_RAD = 0.002  # a joint turns no further between two looks; a point 2 m away moves by 4 mm
