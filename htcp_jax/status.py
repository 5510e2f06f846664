"""Status codes for targets, segments and motions, each with a name and a message."""

import enum


class Status(enum.IntEnum):
    """Result for one target; stored as int8.

    A scenario ends at its first target that is not tracked; all later targets are NOT_ATTEMPTED.
    """

    TRACKED = 0
    TRACKED_AFTER_RECOVERY = 1
    QP_INFEASIBLE = 2
    ITERATION_LIMIT = 3
    RECOVERY_EXHAUSTED = 4
    PATH_BLOCKED = 5
    QP_FAILED = 6
    NOT_ATTEMPTED = 7
    START_IN_COLLISION = 8
    OUT_OF_REACH = 9
    TIP_BLOCKED = 10
    NO_NULL_SPACE = 11
    HOME_IN_COLLISION = 12
    HOME_NOT_JOINED = 13
    NO_START = 14
    NO_SOLUTION = 15  # only methods of other packages set NO_SOLUTION and BUDGET_EXHAUSTED
    BUDGET_EXHAUSTED = 16

    @property
    def tracked(self) -> bool:
        """True if the target was reached within the tolerance, with the required clearance."""
        return self <= Status.TRACKED_AFTER_RECOVERY

    @property
    def words(self) -> str:
        """The name as text, such as "QP infeasible"."""
        return self.name.replace("_", " ").lower().replace("qp", "QP")

    @property
    def ended(self) -> str:
        """Short reason why planning ended, for a target where no colliding body is named."""
        return _ENDED.get(self, self.words)

    @property
    def message(self) -> str:
        """Sentence that describes this result."""
        return _MESSAGES[self]


# Statuses of scenarios that were not planned: no target was attempted.
AT_HOME = Status.HOME_IN_COLLISION, Status.HOME_NOT_JOINED, Status.NO_START
NOT_TRIED = Status.START_IN_COLLISION, Status.OUT_OF_REACH, *AT_HOME

_ENDED = {
    Status.QP_INFEASIBLE: "step QP infeasible",
    Status.ITERATION_LIMIT: "step QPs out of iterations",
    Status.RECOVERY_EXHAUSTED: "no configuration accepted",
    Status.PATH_BLOCKED: "no segment accepted",
    Status.QP_FAILED: "QP solver failed",
}
_MESSAGES = {
    Status.TRACKED: "tracked by step QPs",
    Status.TRACKED_AFTER_RECOVERY: "tracked after a recovery",
    Status.QP_INFEASIBLE: "the step QP is infeasible: no step satisfies the clearance, progress and limit constraints",
    Status.ITERATION_LIMIT: "the step QPs reached their iteration limit before the target or the required clearance",
    Status.RECOVERY_EXHAUSTED: "the search found no configuration that reaches the target with the required clearance",
    Status.PATH_BLOCKED: (
        "configurations were found at the target, but every segment to them that was tried collides, comes nearer than "
        "the margin, leaves the path, turns a joint too far, or is not proven"
    ),
    Status.QP_FAILED: "the QP solver failed and returned no solution",
    Status.NOT_ATTEMPTED: "not attempted, because an earlier target of the scenario failed",
    Status.START_IN_COLLISION: "the start is in collision, so nothing was tried",
    Status.HOME_IN_COLLISION: "the home configuration is in collision, so nothing was tried",
    Status.HOME_NOT_JOINED: "no joint path from home to a start was proven collision-free, so nothing was tried",
    Status.NO_START: (
        "none of the random configurations that were tried at the first point of the path has the required clearance "
        "within the joint limits, so no target was tried"
    ),
    Status.OUT_OF_REACH: "a target is farther away than the arm is long, so nothing was tried",
    Status.NO_NULL_SPACE: "the step QPs are stuck, and the task has no null space in which to recover",
    Status.TIP_BLOCKED: "the arm is clear, but the bare end of the tool passes through the wall",
    Status.NO_SOLUTION: "the method found no configuration at the target, or no segment to one",
    Status.BUDGET_EXHAUSTED: "the method reached its limit of time or attempts before it found a configuration",
}


class Exclusion(enum.IntEnum):
    """Proven reason why a target cannot be reached: too far away, or the bodies of which at least one collides."""

    NONE = 0  # not proven
    OUT_OF_REACH = 1
    TOOL = 2
    WRIST = 3  # the tool and the link before it
    ARM = 4

    @property
    def words(self) -> str:
        """The name as text, such as "out of reach"."""
        return self.name.replace("_", " ").lower()

    @property
    def message(self) -> str:
        """Short description of the reason."""
        return _EXCLUSION_MESSAGES[self]


_EXCLUSION_MESSAGES = {
    Exclusion.NONE: "not excluded by proof",
    Exclusion.OUT_OF_REACH: "the arm does not get there",
    Exclusion.TOOL: "the tool collides",
    Exclusion.WRIST: "the tool, or the link before it, collides",
    Exclusion.ARM: "the tool or the arm behind it collides",
}


class SegmentStatus(enum.IntEnum):
    """Verification result for the motion segment between two consecutive rows of a plan; stored as int8."""

    NOT_CHECKED = -1
    VALID = 0
    IN_COLLISION = 1
    OFF_PATH = 2
    REVERSES = 3
    UNDECIDED = 4
    WRONG_START = 5
    SAMPLED = 6
    BELOW_MARGIN = 7
    REDUCED_MARGIN = 8

    @property
    def is_motion(self) -> bool:
        """True if the segment is a verified motion: proven, or proven except for sampled task rows."""
        return self in MOTION

    @property
    def words(self) -> str:
        """Name of the result in tables, such as "in collision"."""
        return _SEGMENT_WORDS[self]

    @property
    def message(self) -> str:
        """Sentence that describes this result."""
        return _SEGMENT_MESSAGES[self]


MOTION = SegmentStatus.VALID, SegmentStatus.SAMPLED, SegmentStatus.REDUCED_MARGIN

_SEGMENT_WORDS = {
    SegmentStatus.NOT_CHECKED: "not checked",
    SegmentStatus.VALID: "proven",
    SegmentStatus.IN_COLLISION: "in collision",
    SegmentStatus.OFF_PATH: "off path",
    SegmentStatus.REVERSES: "reverses",
    SegmentStatus.UNDECIDED: "undecided",
    SegmentStatus.WRONG_START: "wrong start",
    SegmentStatus.SAMPLED: "sampled",
    SegmentStatus.BELOW_MARGIN: "below the margin",
    SegmentStatus.REDUCED_MARGIN: "proven with less margin",
}
_SEGMENT_MESSAGES = {
    SegmentStatus.NOT_CHECKED: "not checked, because the motion ends before this segment",
    SegmentStatus.VALID: "proven: the arm is clear and the TCP stays on the path all along the segment",
    SegmentStatus.IN_COLLISION: "the arm collides on the segment to this target",
    SegmentStatus.OFF_PATH: "the TCP leaves the path on the segment to this target",
    SegmentStatus.REVERSES: "the TCP moves backwards along the path on this segment",
    SegmentStatus.UNDECIDED: "neither proven nor refuted at the finest subdivision",
    SegmentStatus.WRONG_START: "the plan does not begin at the given start",
    SegmentStatus.SAMPLED: ("the arm is proven clear; a task row without a bound is satisfied at all samples"),
    SegmentStatus.BELOW_MARGIN: "the arm is clear on the segment to this target, but nearer than the margin",
    SegmentStatus.REDUCED_MARGIN: "proven: the arm is clear, but has less clearance than `transfer_margin_m` requires",
}


class UndecidedCause(enum.IntEnum):
    """Cause for which a segment of a motion in a file is undecided."""

    NONE = 0  # it is not undecided
    TRACKING = 1
    CORNER = 2
    SUBDIVISION = 3
    MESH_POINTS = 4

    @property
    def words(self) -> str:
        """Name of the cause in tables, such as "rounded corner"."""
        return {0: "", 1: "tracking", 2: "rounded corner", 3: "finest subdivision", 4: "points on a mesh"}[self]

    @property
    def message(self) -> str:
        """Short description of the cause."""
        return _CAUSE_MESSAGES[self]


_CAUSE_MESSAGES = {
    UndecidedCause.NONE: "",
    UndecidedCause.TRACKING: "clear on the motion itself, not proven within the tracking",
    UndecidedCause.CORNER: "not proven for all paths inside the rounded corner",
    UndecidedCause.SUBDIVISION: "neither proven nor refuted at the finest subdivision",
    UndecidedCause.MESH_POINTS: "far enough from the points on a mesh, not proven for the mesh between them",
}


class Kind(enum.IntEnum):
    """Kind of the motion that leads to a configuration; stored as int8."""

    TRANSFER = 0  # from home, or from the start, to the configuration in which the plan begins
    APPROACH = 1  # to the path's first point
    PROCESS = 2  # along the path
    DWELL = 3  # the TCP stays at a target while the arm changes its configuration
    RETRACT = 4  # back to home or the start, along the same motion in reverse

    @property
    def words(self) -> str:
        """The name as text, such as "process"."""
        return self.name.lower()
