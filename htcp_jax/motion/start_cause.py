"""Reason why a scenario cannot begin: bodies that overlap, or no clear configuration found at the path's first point.

Bodies that do not move, such as the arm's base and the workpiece, overlap in every configuration or in none. Other
pairs are measured at the random configurations that were sampled to find a start.
"""

from collections import Counter
from collections.abc import Sequence
from concurrent.futures import Future
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float, Int

from htcp_jax.clearance.obstacles import SelfCollision, refused_pair
from htcp_jax.device import tables
from htcp_jax.errors import InputError, mm_text
from htcp_jax.model import Robot
from htcp_jax.model import robot as robots
from htcp_jax.model import scenario as scenario_functions
from htcp_jax.motion import start_check
from htcp_jax.motion.home import FIRST_ROUND, ROUNDS
from htcp_jax.motion.measured_rows import MeasuredRows, task_errors
from htcp_jax.motion.problem import Problem, Rows
from htcp_jax.motion.transfers import drawn_configurations
from htcp_jax.status import AT_HOME, Status

CAUSES = Status.START_IN_COLLISION, Status.HOME_IN_COLLISION, Status.NO_START  # statuses with a cause
NAMED = 3  # maximum number of pairs of bodies in a description
NO_PROOF = "this is no proof: other configurations were not tried"
NEAR, NEAR_RAD = 1024, (0.01, 3.0)  # random configurations near one in collision; their least and largest distance


class Attempt(NamedTuple):
    """The sampled configuration at the first target with the least overlap, or without one the largest clearance."""

    x: Float[np.ndarray, "N"]  # [rad or m]
    body: str  # name of the capsule with the deepest overlap at x
    other: str  # name of the obstacle that it overlaps
    point: Float[np.ndarray, "3"]  # nearest point of this obstacle, world [m]
    depth_m: float  # depth of the overlap; negative: the clearance
    link: int  # number of the link to which the body belongs
    of_mesh: bool = False  # True: points stand for the obstacle, see `Obstacle.of_mesh`

    @property
    def description(self) -> str:
        """Text that names the bodies, the depth or clearance, and the place."""
        where = f"at ({', '.join(f'{value:.2f}' for value in self.point)}) m"
        if self.depth_m > 0:
            return f"{self.body} is {mm_text(self.depth_m)} inside {self.other} {where}"
        return f"{self.body} comes within {mm_text(-self.depth_m)} of {self.other} {where}"


class StartCause(NamedTuple):
    """Reason why a scenario cannot begin."""

    description: str
    body: str | None = None  # name of the capsule that overlaps; None if unknown
    other: str | None = None  # name of the obstacle
    depth_m: float = float("nan")  # depth of the overlap, the least of several; negative: the largest clearance
    always: bool = False  # True if the pair overlaps in every configuration
    attempt: Attempt | None = None  # the best attempt, if all attempts lack clearance

    @property
    def unproven(self) -> "StartCause":
        """The reason with a note that it is about some configurations only."""
        return self._replace(description=f"{self.description}; {NO_PROOF}")

    def place(self, T_world_workpiece: Float[np.ndarray, "4 4"]) -> str:
        """Return the beginning of the message: a hint if the workpiece has no given pose, else an empty text.

        The text is also empty if other bodies than the workpiece overlap.
        """
        is_part = self.other is None or "workpiece" in self.other
        return scenario_functions.without_pose(T_world_workpiece) if is_part else ""


def start_causes(problem: Problem, status: Int[np.ndarray, "S"], rounds: int = ROUNDS) -> dict[int, StartCause]:
    """Return the reasons why scenarios cannot begin: row -> reason, for rows with a status of `CAUSES`.

    Args:
        problem: The problem.
        status: Statuses of the scenarios' first targets.
        rounds: Maximum number of rounds of sampled starts to measure.
    """
    rows, scenarios = np.flatnonzero(np.isin(status, CAUSES)).tolist(), problem.scenarios
    begin = [s for s in rows if status[s] != Status.NO_START]
    x = np.where(np.isin(status, AT_HOME)[:, None], scenarios.x_home, scenarios.x_start)[begin]
    causes = dict[int, StartCause]()
    if begin:
        found = _measured(problem, np.array(begin), x)
        for k, s in enumerate(begin):
            causes[s] = _overlap(problem, found, k) or StartCause(Status(int(status[s])).message)
    for s in (s for s in rows if s not in causes):
        causes[s] = standing_overlap(problem, s) or _without_start(problem, s, rounds).unproven
    places = {s: causes[s].place(scenarios.T_world_workpiece[s]) for s in rows}
    return {s: causes[s]._replace(description=places[s] + causes[s].description) for s in rows}


def _overlap(problem: Problem, found: MeasuredRows, k: int) -> StartCause | None:
    """Return the deepest overlap at configuration k, of bodies that do not move if there is one; None without one."""
    if (depth := -found.distance[k]).max() <= 0:
        return _excluded_overlap(problem, found.x[k])
    standing = found.stands & (depth > 0)
    row = int(np.where(standing, depth, -np.inf).argmax() if standing.any() else depth.argmax())
    return _cause(found, row, k, always=bool(standing[row]))


def standing_overlap(problem: Problem, s: int) -> StartCause | None:
    """Return the deepest overlap that exists in every configuration of a scenario; None if there is none."""
    (x,) = drawn_configurations(problem, problem.checkers[0], np.array([s]), FIRST_ROUND)
    found = _measured(problem, s, x)
    always = np.where(found.distance.max(axis=0) <= 0, -found.distance.max(axis=0), -np.inf)
    row = int(always.argmax())
    return _cause(found, row, int(found.distance[:, row].argmax()), always=True) if always[row] >= 0 else None


def check_starts(problem: Problem, compilations: Sequence[Future]) -> None:
    """Check that no scenario's home or start is in collision, see `start_check.check_start`.

    Starts in collision are found by an executable that planning needs anyway.

    Args:
        problem: The problem.
        compilations: Compilations to cancel before the error is raised.

    Raises:
        InputError: If a home or a start is in collision.
    """
    for s in problem.to_plan.tolist():
        one = jax.tree.map(lambda leaf, s=s: leaf[s], problem.scenarios)
        for what, x in start_check.begins_at(one).items():
            if problem.checkers[0].states(problem.inputs(s, 0), x[None]).clearance[0] <= 0:
                for each in compilations:
                    each.cancel()
                try:
                    start_check.check_start(problem.robot, problem.workpiece, one, problem.other_obstacles)
                except InputError as error:
                    raise InputError(f"{error}{_clear_near(problem, s, what, x)}") from None


def _clear_near(problem: Problem, s: int, what: str, x: Float[np.ndarray, "N"]) -> str:
    """Return the nearest clear configuration of NEAR random ones as the end of a message; "" if none is clear.

    Args:
        problem: The problem.
        s: Row of the scenario.
        what: "home" or "start".
        x: The configuration in collision [rad or m].
    """
    draw, (lower, upper) = np.random.default_rng(problem.settings.seed), problem.checkers[0].executor.limits
    away = np.geomspace(*NEAR_RAD, NEAR)[:, None] * draw.uniform(-1, 1, (NEAR, len(x)))
    tried = np.round(np.asarray(x) + away, 3)
    tried = tried[((tried >= lower) & (tried <= upper)).all(axis=1)]
    if not len(tried):
        return ""
    clearance = problem.checkers[0].states(problem.inputs(np.full(len(tried), s), 0), tried).clearance
    is_clear = clearance > max(0.0, float(problem.scenarios.margin_m[s]))
    if not is_clear.any():
        return ""
    nearest = min(tried[is_clear].tolist(), key=lambda each: float(np.abs(each - x).max()))
    values = ", ".join(f"{value:g}" for value in nearest)
    return f"; next: --set '{what}_rad=[{values}]', the nearest clear one of {NEAR} random configurations"


def refuse_standing_overlaps(problem: Problem) -> None:
    """Check that no scenario without a start has an overlap in every configuration.

    Raises:
        InputError: If a scenario has such an overlap; the message names the bodies and the depth.
    """
    for s in np.flatnonzero(problem.scenarios.refused == Status.NO_START).tolist():
        if (found := standing_overlap(problem, s)) is not None:
            place = found.place(problem.scenarios.T_world_workpiece[s])
            raise InputError(f"{place}no start exists: {found.description}")


def closest_bodies(problem: Problem, x: Float[np.ndarray, "N"]) -> Attempt:
    """Return the bodies with the smallest clearance at x, as labels; see `closest_pairs`."""
    return closest_pairs(problem, x, 1)[0]


def closest_pairs(problem: Problem, x: Float[np.ndarray, "N"], count: int) -> list[Attempt]:
    """Return the pairs of a link and an obstacle with the smallest clearances at x, the smallest first.

    Args:
        problem: The problem; its first scenario is measured.
        x: The configuration [rad or m].
        count: Maximum number of pairs.
    """
    found, pairs = _measured(problem, 0, x[None]), dict[tuple[int, str], Attempt]()
    for row in found.distance[0].argsort(kind="stable").tolist():
        attempt = _attempt(found, row, 0)._replace(body=found.label(row))
        pairs.setdefault((attempt.link, attempt.other), attempt)
        if len(pairs) == count:
            break
    return list(pairs.values())


def clearances_at(problem: Problem, x: Float[np.ndarray, "n N"]) -> Float[np.ndarray, "n"]:
    """Return D at configurations in the problem's first scenario [m]."""
    return _measured(problem, 0, x).distance.min(axis=1, initial=np.inf)


def _measured(problem: Problem, scenarios: Rows, x: Float[np.ndarray, "n N"]) -> MeasuredRows:
    """Return the distances at n configurations of one scenario, or of n."""
    inputs, device = problem.inputs(np.broadcast_to(scenarios, len(x)), 0), problem.devices[0]
    return MeasuredRows(problem.robot, problem.obstacles, inputs, x, device)


def _cause(found: MeasuredRows, row: int, k: int, always: bool) -> StartCause:
    """Return a `StartCause` for the overlap of a row at configuration k."""
    other, body, depth_m = found.other(row, k), found.label(row), -float(found.distance[k, row])
    text = f"{body} is {mm_text(depth_m)} inside {other}"
    if always:
        where = "every configuration" if found.stands[row] else f"all of {len(found.x)} random configurations"
        least = "" if found.stands[row] else "at least "
        text = f"{other} and {body} overlap by {least}{mm_text(depth_m)} in {where}"
    return StartCause(text + found.gaps_note(row, k), found.body(row), other, depth_m, always)


def _attempt(found: MeasuredRows, row: int, k: int) -> Attempt:
    """Return the overlap or clearance of a row at configuration k as an attempt."""
    depth_m, point = -float(found.distance[k, row]), found.found.witness[k, row]
    link, of_mesh = int(found.links[row]), found.of_mesh(row, k)
    return Attempt(found.x[k], found.body(row), found.other(row, k), point, depth_m, link, of_mesh)


def _without_start(problem: Problem, s: int, rounds: int) -> StartCause:
    """Return the reason why none of the sampled configurations at the first target is a start."""
    checker, scenarios, task = problem.checkers[0], problem.scenarios, problem.task
    drawn = np.concatenate(drawn_configurations(problem, checker, np.full(rounds, s), FIRST_ROUND + np.arange(rounds)))
    inputs = problem.inputs(np.full(len(drawn), s), 0)
    at = checker.states(inputs, checker.project(inputs, drawn))
    reached, attempts = task.reached(at.residual), f"{len(drawn)} random attempts"
    if not reached.any():
        nearest = np.array([np.argmin(at.residual)])
        one = tables.gather(inputs, nearest)
        (off,), (angle,), _ = task_errors(problem.robot, task, one, at.x[nearest], one.target)
        turned = f" and {np.rad2deg(angle):.3g} deg" if angle else ""
        text = f"in {attempts} the arm came only to within {mm_text(off)}{turned} of the point"
        return StartCause(text + _at_limits(problem.robot, at.x[nearest[0]]))
    found = _measured(problem, s, at.x[reached])
    least, deepest = found.distance.min(axis=1), found.distance.argmin(axis=1)
    k = int(least.argmax())
    best = _attempt(found, int(deepest[k]), k)
    if clear := int((least > 0).sum()):
        valid = checker.valid(tables.gather(inputs, reached), tables.gather(at, reached))
        if valid.any():
            return StartCause(f"no start was found in {attempts}")
        margin_m, most_m = float(scenarios.margin_m[s]), float(least[k])
        lacks = f"a clearance of at most {mm_text(most_m)}, less than the margin of {mm_text(margin_m)}"
        if most_m >= margin_m:
            lacks = f"less than the margin of {mm_text(margin_m)}, or with the tool's bare tip in a wall"
        text = f"in {clear} of {attempts} the arm reached the point without collision, but with {lacks}"
        return StartCause(text, depth_m=-most_m, attempt=best if most_m < margin_m else None)
    tried = Counter(deepest.tolist()).most_common(NAMED)
    pairs = [(row, found.other(row, int(np.argmax(deepest == row))), count) for row, count in tried]
    named = [f"{found.label(row)} with {other} ({count})" for row, other, count in pairs]
    row, other, _ = pairs[0]
    depth_m = -float(least[k])
    text = (
        f"{len(least)} of {attempts} reached the point, all in collision, the least by {mm_text(depth_m)}: "
        f"{', '.join(named)}"
    )
    return StartCause(text, found.body(row), other, depth_m, attempt=best)


def _at_limits(robot: Robot, x: Float[np.ndarray, "N"]) -> str:
    """Return the names of the joints that are at their limits at a configuration, as the end of a sentence."""
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    at = [name for name, is_at in zip(robot.joint_names, (x <= lower) | (x >= upper), strict=True) if is_at]
    return f", with {', '.join(at)} at the joint limits" if at else ""


def _excluded_overlap(problem: Problem, x: Float[np.ndarray, "N"]) -> StartCause | None:
    """Return an overlap of a pair of capsules that self-collision excludes; None if there is none."""
    robot: Robot = problem.robot
    for own in (each for each in problem.obstacles if isinstance(each, SelfCollision)):
        if (found := refused_pair(own, robot, x)) is not None:
            body, other = (robot.capsule_names[k] for k in (found.first, found.second))
            return StartCause(found.reason, body, robots.capsule_label(robot, other), found.depth_m)
    return None
