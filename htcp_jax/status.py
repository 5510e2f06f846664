"""Results for targets, segments and motions. A failure is data: it has a number, a name and a message."""

import enum


class Status(enum.IntEnum):
    """Result for one target; stored as int8.

    The first target of a scenario that is not tracked ends it, and all later ones are NOT_ATTEMPTED.
    """

    TRACKED = 0
    TRACKED_AFTER_ESCAPE = 1
    QP_INFEASIBLE = 2
    ITERATION_LIMIT = 3
    ESCAPE_EXHAUSTED = 4
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
    NO_SOLUTION = 15  # these two for methods of other packages
    BUDGET_EXHAUSTED = 16

    @property
    def tracked(self) -> bool:
        """True if the target was reached within the tolerance, with the required clearance."""
        return self <= Status.TRACKED_AFTER_ESCAPE

    @property
    def words(self) -> str:
        """The name as text: "QP infeasible"."""
        return self.name.replace("_", " ").lower().replace("qp", "QP")

    @property
    def ended(self) -> str:
        """Short reason why the search ended at a target at which no body collides."""
        return _ENDED.get(self, self.words)

    @property
    def message(self) -> str:
        """Description in one sentence."""
        return _MESSAGES[self]


# Results of scenarios that were not planned.
AT_HOME = Status.HOME_IN_COLLISION, Status.HOME_NOT_JOINED, Status.NO_START
NOT_TRIED = Status.START_IN_COLLISION, Status.OUT_OF_REACH, *AT_HOME

_ENDED = {
    Status.QP_INFEASIBLE: "step QP infeasible",
    Status.ITERATION_LIMIT: "step QPs out of iterations",
    Status.ESCAPE_EXHAUSTED: "no clear configuration found",
    Status.PATH_BLOCKED: "no clear way found",
    Status.QP_FAILED: "QP solver failed",
}
_MESSAGES = {
    Status.TRACKED: "tracked by step QPs",
    Status.TRACKED_AFTER_ESCAPE: "tracked after an escape",
    Status.QP_INFEASIBLE: "the step QP has no answer that keeps clear, nears the target and heeds the limits",
    Status.ITERATION_LIMIT: "the step QPs ran out of iterations short of the target or of clearance",
    Status.ESCAPE_EXHAUSTED: "no clear configuration was found that reaches the target",
    Status.PATH_BLOCKED: "every clear configuration that was found lies behind a way that collides or leaves the path",
    Status.QP_FAILED: "the QP solver broke down and returned no usable answer",
    Status.NOT_ATTEMPTED: "not attempted, because an earlier target of the scenario failed",
    Status.START_IN_COLLISION: "the start is in collision, so nothing was tried",
    Status.HOME_IN_COLLISION: "the home posture is in collision, so nothing was tried",
    Status.HOME_NOT_JOINED: "no joint path from home to a start was found that is proven clear, so nothing was tried",
    Status.NO_START: "no clear posture was found at the first point of the path, so nothing was tried",
    Status.OUT_OF_REACH: "a target is farther away than the arm is long, so nothing was tried",
    Status.NO_NULL_SPACE: "the step QPs are stuck, and the task leaves no null space to escape in",
    Status.TIP_BLOCKED: "the arm is clear there, but the bare end of the tool passes through the wall",
    Status.NO_SOLUTION: "the method found no configuration there, or no way to one",
    Status.BUDGET_EXHAUSTED: "the method used up its time or its tries before it found a configuration",
}


class Way(enum.IntEnum):
    """Verification result for the motion segment from one row of a plan to the next; stored as int8."""

    UNKNOWN = -1
    PROVEN = 0
    COLLIDES = 1
    LEAVES = 2
    TURNS_BACK = 3
    OPEN = 4
    ELSEWHERE = 5
    SAMPLED = 6

    @property
    def is_motion(self) -> bool:
        """True if the segment was verified: proven, or as far as it can be."""
        return self in MOTION

    @property
    def words(self) -> str:
        """Name of the result in tables."""
        return _WAY_WORDS[self]

    @property
    def message(self) -> str:
        """Description in one sentence."""
        return _WAYS[self]


MOTION = Way.PROVEN, Way.SAMPLED

_WAY_WORDS = {
    Way.UNKNOWN: "not checked",
    Way.PROVEN: "proven",
    Way.COLLIDES: "blocked",
    Way.LEAVES: "off path",
    Way.TURNS_BACK: "turns back",
    Way.OPEN: "undecided",
    Way.ELSEWHERE: "wrong start",
    Way.SAMPLED: "sampled",
}
_WAYS = {
    Way.UNKNOWN: "nobody looked, because the motion ends before",
    Way.PROVEN: "the arm is clear all along, and the tool keeps to its path",
    Way.COLLIDES: "the arm touches on the way there",
    Way.LEAVES: "the tool leaves its path on the way there",
    Way.TURNS_BACK: "the tool turns back on the way there",
    Way.OPEN: "the way there is too close to call",
    Way.ELSEWHERE: "the plan does not begin at the start that was given",
    Way.SAMPLED: "the arm is proven clear all along; a row of the task has no bound, and holds wherever it was sampled",
}


class Kind(enum.IntEnum):
    """Kind of motion that leads to one configuration of a motion."""

    TRANSFER = 0  # from home, or from the start, to the configuration in which the plan begins
    APPROACH = 1  # to the path's first point
    FEED = 2  # along the path
    DWELL = 3  # the tool stays at a target while the arm changes its configuration
    RETRACT = 4  # back along the same motion

    @property
    def words(self) -> str:
        """The name as text: "feed"."""
        return self.name.lower()


def words(status: Status) -> str:
    """Return a status's name as text."""
    return status.name.replace("_", " ").lower().replace("qp", "QP")
