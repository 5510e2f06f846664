"""Smoothing: reduce the cost (3) of a motion as far as its constraints allow.

The method is sequential quadratic programming. Each round solves one sparse QP per path about the current iterate
(`solvers.path_qp`), and moves the configurations back onto their targets. The result is accepted if it is shorter and
still proven to be a motion. If parts of it are not proven, the adjacent configurations stay and their trust region
shrinks, while the other configurations move. Every accepted iterate is a motion, so smoothing can stop at any round.

Via points are smoothed, too. They are dropped if the straight segment without them is a motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from htcp_jax.device import devices, processes, tables
from htcp_jax.model import TaskLinear
from htcp_jax.motion.collision_checker import CollisionChecker
from htcp_jax.motion.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.motion.motion_check import RequiredMargins, StraightPaths, prove_segments
from htcp_jax.motion.plans import Outcome, Plans
from htcp_jax.motion.problem import Problem
from htcp_jax.motion.sparse_columns import ViaPoints
from htcp_jax.motion.step_functions import TASK_ROWS, State
from htcp_jax.solvers import PathQP, path_cost, solve_path_qp
from htcp_jax.status import SegmentStatus

TRUST = 0.2  # maximum step of a joint per round [rad or m]
NEIGHBOURS = 4  # number of configurations next to a fixed one over which steps increase to their full length
GAIN, SLOW, MOST_ROUNDS = 2e-3, 3, 40  # a path is done after SLOW consecutive rounds that save less than GAIN
TOGETHER = 64  # paths per thread that are smoothed at a time; the linearisation of a path takes a third of a megabyte
TOGETHER_ON_GPU = 1024  # the same on a GPU, where few lanes take as long as many
GPU_THREADS = 3  # maximum on GPUs: while one thread waits for QPs, the others use the GPU
FEW_QPS = 16  # QPs that are solved in less time than it takes to send them to other processes
GRAZES = 64  # maximum number of clearance queries per proof; a segment that needs more is too close to an obstacle


@dataclass(eq=False)
class SmoothedPath:
    """The motion of one scenario: P configurations after the start, at targets and at via points."""

    scenario: int
    x: Float[np.ndarray, "P1 N"]  # the start, then the configurations
    target: Int[np.ndarray, "P"]  # target at the end of the segment that a configuration is on
    is_via_point: Bool[np.ndarray, "P"]  # True for via points
    on_path: int  # see `Scenario`
    radius: Float[np.ndarray, "P"]  # radius of each trust region; 0 for a fixed configuration
    begins_anywhere: bool  # True if the start may move, as it is the configuration at the first target
    seen: State | None = None  # at each configuration and half way to it: (P, 2, ...)
    slow: int = field(default=0)  # number of consecutive rounds with almost no saving
    rounds: int = 0  # number of rounds so far
    cost: float | None = None  # of x; None: not known

    @classmethod
    def of(cls, problem: Problem, plans: Plans, end: Outcome) -> "SmoothedPath":
        """Return the path of a scenario: its executable motion.

        The last configuration is fixed if tracked targets follow. A given start between home and the first target is
        fixed, too.
        """
        s = end.scenario
        edges = [(t, [*plans.via_points.on_segment(s, t), plans.x[s, t]]) for t in range(end.executable)]
        x = np.array([plans.start[s], *(configuration for _, edge in edges for configuration in edge)])
        target = np.repeat([t for t, _ in edges], [len(edge) for _, edge in edges])
        is_via_point = np.append(target[1:] == target[:-1], False)
        radius = np.full(len(target), TRUST)
        if end.executable < end.tracked:
            radius[-1] = 0.0
        radius[(target == 0) & is_via_point & _is_given_start(problem, s, x[1:])] = 0.0
        anywhere = bool(problem.begins_anywhere[s])
        return cls(s, x, target, is_via_point, int(problem.scenarios.on_path[s]), radius, anywhere)

    @property
    def constrained(self) -> Bool[np.ndarray, "P"]:
        """True for configurations at which the task is required: all except the approach's via points."""
        return ~self.is_via_point | (self.target > self.on_path)

    @property
    def may_drop(self) -> Bool[np.ndarray, "P"]:
        """True for via points that may be dropped: via points on segments without a fixed configuration."""
        return self.is_via_point & ~np.isin(self.target, self.target[self.is_via_point & (self.radius == 0)])

    @property
    def row(self) -> Int[np.ndarray, "P"]:
        """Index of the target at each configuration; for a via point, of the previous target."""
        return np.maximum(self.target - self.is_via_point, 0)

    @property
    def done(self) -> bool:
        """True if smoothing of this path has ended."""
        return self.slow >= SLOW or self.rounds >= MOST_ROUNDS

    def segments(self, x: Float[np.ndarray, "P1 N"]) -> StraightPaths:
        """Return the straight joint paths between consecutive configurations x, beginning at the start."""
        return StraightPaths(np.full(len(self.target), self.scenario), self.target, x[:-1], x[1:], self.is_via_point)

    def without(self, dropped: Bool[np.ndarray, "P"]) -> None:
        """Remove some configurations, and discard the states."""
        self.x = self.x[np.append(True, ~dropped)]
        self.target, self.is_via_point, self.radius = (
            a[~dropped] for a in (self.target, self.is_via_point, self.radius)
        )
        self.seen = self.cost = None


class Candidate(NamedTuple):
    """A path after a step, and what is known about it."""

    step: Float[np.ndarray, "P N"]  # step of the configurations, before they are moved onto their targets [rad or m]
    x: Float[np.ndarray, "P1 N"]  # the start, then the configurations
    seen: State  # at each configuration and half way to it: (P, 2, ...)
    valid: Bool[np.ndarray, "P"]  # True for configurations that satisfy task and margin
    proven: Bool[np.ndarray, "P"]  # True if the straight joint path to the configuration is proven

    @classmethod
    def standing(cls, path: SmoothedPath) -> "Candidate":
        """Return a path after a step of length 0: it is a motion."""
        always = np.ones(len(path.target), bool)
        return cls(np.zeros_like(path.x[1:]), path.x, path.seen, always, always)


def smooth(problem: Problem, plans: Plans) -> Plans:
    """Return the plans with their executable motions smoothed; call `verify_motions` again afterwards.

    Scenarios are reported as finished when their motions are smoothed.
    """
    ends = plans.outcomes  # computed once for all scenarios
    going = np.flatnonzero(ends.executable).tolist()
    most, threads, workers = TOGETHER, problem.threads, 1
    if not problem.checkers[0].executor.pays_by_lane:
        most, threads = TOGETHER_ON_GPU, max(threads, min(GPU_THREADS, len(going) // TOGETHER_ON_GPU))
        workers = processes.profitable_count(devices.cores(), len(going), int(ends.executable.sum()))
    paths, margins = [SmoothedPath.of(problem, plans, ends.of(s)) for s in going], RequiredMargins(problem, plans, True)

    def work(checker: CollisionChecker, share: slice) -> None:
        smoothing, mine = Smoothing(problem, checker, margins, workers), paths[share]
        for first in range(0, len(mine), most):
            smoothing.run(mine[first : first + most])

    problem.progress(0, len(problem.to_plan) - len(paths))
    problem.in_threads(work, threads)
    return _written(problem, plans, paths)


class Smoothing:
    """Smoothing of several paths together, round by round.

    Args:
        problem: The problem.
        checker: Collision checker of a device.
        margins: The required margins.
        workers: Number of processes that solve the QPs.
    """

    def __init__(self, problem: Problem, checker: CollisionChecker, margins: RequiredMargins, workers: int = 1):
        self._problem, self._checker, self._margins, self._workers = problem, checker, margins, workers
        settings, joints = problem.settings, problem.scenarios.x_start.shape[1]
        self._lower, self._upper = np.asarray(problem.robot.lower), np.asarray(problem.robot.upper)
        self._weights = np.ones(joints) if settings.path_weights is None else np.array(settings.path_weights)

    def run(self, paths: Sequence[SmoothedPath]) -> None:
        """Smooth until all paths are done."""
        while going := [path for path in paths if not path.done]:
            self._drop(going)
            self._look([path for path in going if path.seen is None])
            before = [self._cost(path) for path in going]
            self._round(going)
            for path, cost in zip(going, before, strict=True):
                path.slow = path.slow + 1 if cost - self._cost(path) < GAIN * cost else 0
                path.rounds += 1
                path.seen = None if path.done else path.seen  # which would keep tables of all paths in memory
            self._problem.progress(0, sum(path.done for path in going))

    def _cost(self, path: SmoothedPath) -> float:
        """Return the cost of a path, which is computed once for each iterate."""
        if path.cost is None:
            path.cost = path_cost(path.x, self._weights)
        return path.cost

    def _drop(self, paths: list[SmoothedPath]) -> None:
        """Drop via points if the straight segment without them is a motion."""
        edges = [(path, target) for path in paths for target in np.unique(path.target[path.may_drop])]
        if not edges:
            return
        own = [np.flatnonzero(path.target == target) for path, target in edges]
        a, b = (np.stack([path.x[k] for (path, _), k in zip(edges, at, strict=True)])
                for at in ([rows[0] for rows in own], [rows[-1] + 1 for rows in own]))  # fmt: skip
        scenario, target = np.array([path.scenario for path, _ in edges]), np.array([target for _, target in edges])
        straight = self._motions(StraightPaths(scenario, target, a, b, np.zeros(len(edges), bool)))
        for path in {path for k, (path, _) in enumerate(edges) if straight[k]}:
            free = [target for k, (each, target) in enumerate(edges) if each is path and straight[k]]
            path.without(path.is_via_point & np.isin(path.target, free))

    def _round(self, paths: list[SmoothedPath]) -> None:
        """Solve one QP per path, and apply the part of its step that is accepted."""
        tries = [
            (path, y, np.ones(len(path.target)), Candidate.standing(path))
            for path, y in zip(paths, self._steps(paths), strict=True)
        ]
        for attempt in range(3):
            again, steps = [], [(path, share[:, None] * y, last) for path, y, share, last in tries]
            for (path, y, share, _), candidate in zip(tries, self._candidates(steps), strict=True):
                bad = self._rejected(path, candidate)
                if attempt == 0:
                    path.radius = np.where(bad, 0.5, 1.5 if not bad.any() else 1.0) * path.radius
                    path.radius = np.minimum(path.radius, TRUST)
                if bad.any():
                    stays = np.flatnonzero(bad | (share == 0))
                    apart = np.abs(np.arange(len(bad))[:, None] - stays).min(axis=1)
                    again.append((path, y, np.clip((apart - attempt) / NEIGHBOURS, 0.0, 1.0), candidate))
                elif (cost := path_cost(candidate.x, self._weights)) < self._cost(path):
                    path.x, path.seen, path.cost = candidate.x, candidate.seen, cost
            if not (tries := again):
                return

    def _steps(self, paths: list[SmoothedPath]) -> list[Float[np.ndarray, "P N"]]:
        """Return, per path, the step that the QP about its current iterate yields [rad or m]."""
        steps = self._solve([self._qp(path, rows) for path, rows in zip(paths, self._task_rows(paths), strict=True)])
        if not self._problem.robot.indexed:
            return steps
        return [np.where(self._still(path), 0.0, y) for path, y in zip(paths, steps, strict=True)]

    def _solve(self, qps: list[PathQP]) -> list[Float[np.ndarray, "P N"]]:
        """Return the QPs' solutions; this process solves few of them itself."""
        if self._workers == 1 or len(qps) < FEW_QPS:
            return _solutions(None, qps)
        rows = processes.shares(len(qps), self._workers)
        parts = [[qps[k] for k in own.tolist()] for own in rows]
        spread = processes.spread([processes.ON_CPU] * self._workers, _solutions, processes.portable(), parts, None)
        order = np.argsort(np.concatenate(rows)).tolist()
        found = [y for part in spread.results for y in part]
        return [found[k] for k in order]

    def _qp(self, path: SmoothedPath, task_rows: TaskLinear) -> PathQP:
        """Return the QP about a path's current iterate.

        Bands and cones of the task are added to the clearance rows at configurations at which the task is required, and
        half way to configurations after the path's first point.
        """
        rows = path.seen.linear.clearance
        G, left = -rows.gradient, np.maximum(rows.distance - self._aims(path)[..., None], 0.0)
        if not self._problem.task.is_points:
            requested = np.stack([path.constrained, path.target > path.on_path], axis=1)
            slack = np.where(requested[:, :, None], np.maximum(task_rows.slack, 0.0), np.inf)
            G, left = np.concatenate([G, -task_rows.gradient], 2), np.concatenate([left, slack], 2)
        radius, x = path.radius[:, None], path.x[1:]
        lower = np.clip(self._lower - x, -radius, 0.0)
        upper = np.clip(self._upper - x, 0.0, radius)
        if self._problem.robot.indexed:
            still = self._still(path)
            lower, upper = np.where(still, 0.0, lower), np.where(still, 0.0, upper)
        return PathQP(
            path.x, self._weights, path.constrained, task_rows.jacobian[:, 0], G[:, 0], left[:, 0], G[:, 1], left[:, 1],
            lower, upper, path.begins_anywhere,
        )  # fmt: skip

    def _still(self, path: SmoothedPath) -> Bool[np.ndarray, "P N"]:
        """Return True for joints that must not move at configurations: indexed axes, within a seam."""
        on_seam = (path.target + ~path.is_via_point > path.on_path) | path.begins_anywhere
        return self._problem.indexed & on_seam[:, None]

    def _aims(self, path: SmoothedPath) -> Float[np.ndarray, "P 2"]:
        """Return the clearance that bodies may not go below at each configuration and half way to it [m].

        Before the path it is `transfer_margin_m`, so that bodies that are nearer do not come still nearer.
        """
        scenarios, above = self._problem.scenarios, self._problem.settings.aim_above_m
        own, transfer = scenarios.margin_m[path.scenario] + above, scenarios.transfer_margin_m[path.scenario]
        before = path.target <= path.on_path
        before = np.stack([before & (path.is_via_point | (path.target < path.on_path)), before], axis=1)
        return np.where(before & (transfer > 0), np.maximum(own, transfer + above), own)

    def _task_rows(self, paths: list[SmoothedPath]) -> list[TaskLinear]:
        """Return, per path, the task's rows at each configuration and half way to it."""
        if self._problem.task.is_points:
            return [path.seen.linear.task for path in paths]
        inputs = jax.tree.map(lambda table: np.repeat(table, 2, axis=0), self._inputs(paths))
        linear = tables.concatenate([path.seen.linear for path in paths])
        count = len(linear.clearance.distance)
        flat = jax.tree.map(lambda table: table.reshape(2 * count, *table.shape[2:]), linear)
        rows = self._checker.executor.task.own_rows(self._checker.executor(TASK_ROWS, inputs, flat))
        rows = jax.tree.map(lambda table: table.reshape(count, 2, *table.shape[1:]), rows)
        return [tables.gather(rows, own) for own in _rows_of_each(paths)]

    def _candidates(self, steps: list[tuple[SmoothedPath, np.ndarray, Candidate]]) -> list[Candidate]:
        """Return each path after a step.

        Args:
            steps: The paths, their steps (P, N), and the same paths after other steps. Where both steps are equal, what
                is known is not computed again.
        """
        paths, last = [path for path, *_ in steps], [each for *_, each in steps]
        new = np.concatenate([_differing(path, step, each) for path, step, each in steps])
        x = self._settled(steps, new[:, 0])
        seen, good, proven = (
            tables.concatenate(column)
            for column in zip(*((each.seen, each.valid, each.proven) for each in last), strict=True)
        )
        if new.any():
            seen = tables.scatter(seen, new, self._states(paths, x, new))
            good = np.where(new[:, 0], self._valid(paths, seen, new[:, 0]), good)
            segments = tables.concatenate([path.segments(at) for path, at in zip(paths, x, strict=True)])
            between = new[:, 1]
            proven = tables.scatter(proven, between, self._motions(tables.gather(segments, between), GRAZES))
        return [
            Candidate(step, at, *tables.gather((seen, good, proven), own))
            for (_, step, _), at, own in zip(steps, x, _rows_of_each(paths), strict=True)
        ]

    def _rejected(self, path: SmoothedPath, candidate: Candidate) -> Bool[np.ndarray, "P"]:
        """Return True for rejected configurations; only configurations that moved can be rejected."""
        stays, edge = (candidate.x == path.x).all(axis=1), candidate.proven
        if self._problem.scenarios.max_joint_step is not None:
            edge = edge & self._keeps_steps(path, candidate.x)
        edge = edge | (stays[1:] & stays[:-1])
        bad = ~(candidate.valid | stays[1:]) | ~edge
        bad[:-1] |= ~edge[1:]
        return bad

    def _look(self, paths: list[SmoothedPath]) -> None:
        if paths:
            everywhere = np.ones((sum(len(path.target) for path in paths), 2), bool)
            seen = self._states(paths, [path.x for path in paths], everywhere)
            seen = jax.tree.map(lambda table: table.reshape(-1, 2, *table.shape[1:]), seen)
            for path, rows in zip(paths, _rows_of_each(paths), strict=True):
                path.seen = tables.gather(seen, rows)

    def _settled(
        self, steps: list[tuple[SmoothedPath, np.ndarray, Candidate]], new: Bool[np.ndarray, "n"]
    ) -> list[np.ndarray]:
        """Return the configurations of the paths after a step, including starts.

        Configurations that moved and at which the task is required are moved back onto their targets.
        """
        paths = [path for path, *_ in steps]
        x = np.concatenate([np.clip(path.x[1:] + y, self._lower, self._upper) for path, y, _ in steps])
        x[~new] = np.concatenate([last.x[1:] for *_, last in steps])[~new]
        off = new & np.concatenate([path.constrained & y.any(axis=1) for path, y, _ in steps])
        if off.any():
            inputs = self._inputs(paths)
            if self._problem.robot.indexed:
                inputs = inputs._replace(still=np.concatenate([self._still(path) for path in paths]))
            x[off] = self._checker.project(tables.gather(inputs, off), x[off])
        return [
            np.concatenate([own[:1] if path.begins_anywhere else path.x[:1], own])
            for path, own in zip(paths, (x[rows] for rows in _rows_of_each(paths)), strict=True)
        ]

    def _states(self, paths: list[SmoothedPath], x: list[np.ndarray], rows: Bool[np.ndarray, "n 2"]) -> State:
        """Return the states at the marked ones of all configurations, and of the places half way to each one."""
        places = np.concatenate([np.stack([at[1:], 0.5 * (at[1:] + at[:-1])], axis=1) for at in x])
        return self._checker.states(tables.gather(self._inputs(paths), np.nonzero(rows)[0]), places[rows])

    def _valid(self, paths: list[SmoothedPath], seen: State, among: Bool[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Return True for valid configurations among those marked."""
        residual = np.where(np.concatenate([path.constrained for path in paths]), seen.residual[:, 0], 0.0)
        at = State(seen.x[:, 0], clearance=seen.clearance[:, 0], residual=residual)
        return self._checker.valid(self._inputs(paths), at, among)

    def _motions(self, segments: StraightPaths, most_queries: int | None = None) -> Bool[np.ndarray, "n"]:
        """Return True for joint paths that are proven in at most `most_queries` clearance queries."""
        proofs = prove_segments(self._problem, self._checker, segments, margins=self._margins)
        few = True if most_queries is None else proofs.queries <= most_queries
        return (proofs.verdict == SegmentStatus.VALID) & few

    def _keeps_steps(self, path: SmoothedPath, x: Float[np.ndarray, "P1 N"]) -> Bool[np.ndarray, "P"]:
        """Return True for joint paths on segments that satisfy `Scenario.max_joint_step`."""
        scenarios = self._problem.scenarios
        segment, most = (t[path.scenario, path.target] for t in (scenarios.segments, scenarios.max_joint_step))
        travel = np.zeros((segment.max(initial=0) + 1, x.shape[1]))
        np.add.at(travel, segment, np.abs(np.diff(x, axis=0)))
        return (travel[segment] <= most).all(axis=1)

    def _inputs(self, paths: list[SmoothedPath]) -> LaneInputs:
        scenario = np.repeat([path.scenario for path in paths], [len(path.target) for path in paths])
        return lane_inputs(self._problem.scenarios, scenario, np.concatenate([path.row for path in paths]))


def _solutions(_, qps: list[PathQP]) -> list[Float[np.ndarray, "P N"]]:
    return [solve_path_qp(qp) for qp in qps]


def _is_given_start(problem: Problem, s: int, x: Float[np.ndarray, "P N"]) -> Bool[np.ndarray, "P"]:
    scenarios = problem.scenarios
    return (x == scenarios.x_start[s]).all(axis=1) & ~scenarios.auto_start[s]


def _differing(path: SmoothedPath, step: Float[np.ndarray, "P N"], last: Candidate) -> Bool[np.ndarray, "P 2"]:
    """Return True where a path differs from the path after another step: at configurations, and half way to each."""
    differs = (step != last.step).any(axis=1)
    before = np.append(differs[0] if path.begins_anywhere else False, differs[:-1])
    return np.stack([differs, differs | before], axis=1)


def _rows_of_each(paths: list[SmoothedPath]) -> list[slice]:
    """Return the rows of each path in tables of all paths' configurations; as slices, of which no copies are made."""
    ends = np.cumsum([len(path.target) for path in paths]).tolist()
    return [slice(begin, end) for begin, end in zip([0, *ends], ends, strict=False)]


def _written(problem: Problem, plans: Plans, paths: list[SmoothedPath]) -> Plans:
    """Return the plans with the configurations of the smoothed paths."""
    s = np.concatenate([np.full((~path.is_via_point).sum(), path.scenario) for path in paths] or [np.zeros(0, int)])
    if not len(s):
        return plans
    plans = plans.with_own("start", "x", "tcp", "clearance", "residual", "joint_step")
    for path in paths:
        plans.start[path.scenario] = path.x[0]
    t, x = (
        np.concatenate(column)
        for column in zip(*((p.target[~p.is_via_point], p.x[1:][~p.is_via_point]) for p in paths), strict=True)
    )
    seen = problem.checkers[0].states(lane_inputs(problem.scenarios, s, t), x)
    plans.x[s, t], plans.tcp[s, t] = x, seen.tcp
    plans.clearance[s, t], plans.residual[s, t] = seen.clearance, seen.residual
    plans.joint_step[s, t] = np.linalg.norm(x - plans.before(s, t), axis=1)
    edges = [(path.scenario, t, path.x[1:][path.is_via_point & (path.target == t)])
            for path in paths for t in np.unique(path.target[path.is_via_point]).tolist()]  # fmt: skip
    executable = plans.executable
    beyond = {row for row in zip(*map(np.ndarray.tolist, plans.via_points[:2]), strict=True) if not executable[row]}
    edges += [(*row, plans.via_points.on_segment(*row)) for row in beyond]
    return plans._replace(via_points=ViaPoints.of(edges, plans.x.shape[2]))
