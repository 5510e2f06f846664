"""The engine: a scenario is a small state machine, and the engine advances every unfinished one by one step at a time.

    prepare   (device)  lane -> step QP             linearised task, clearance rows, limits about x_ref
    solve     (host)    step QPs -> steps, verdicts Clarabel
    advance   (device)  lane, step -> lane          linearised and measured at the new x_ref

or, when the step QPs are solved on the device too (`qp: device`), a burst of these rounds at a time.

A lane tracks one target by step QPs until it is reached, then the next one; or it is stuck, and walks the null space
one step at a time; or it is one of many candidates of a sampling escape, tracking the stuck target on behalf of a
scenario that waits. Lanes never wait for each other: each has its own target, phase and count; finished ones leave, new
scenarios take their place. Lanes in the same phase go through one kernel together. Which lanes those happen to be has
no influence on any of them: a scenario's result is the same alone, in any batch, in any order and on any thread.

Everything here is bookkeeping on numpy tables. The mathematics is in `escape` and below; batching is in `kernels`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np

from htcp_jax.clearance import Linearisation
from htcp_jax.escape import METHODS, NullSpace
from htcp_jax.kernels import Kernels, Measured, Task, tasks
from htcp_jax.plans import Plans
from htcp_jax.qp import QPSolver, QPStatus
from htcp_jax.scenario import Scenario
from htcp_jax.settings import Settings
from htcp_jax.status import Status

MAIN = -1  # `candidate` of a lane that tracks for its scenario itself

TRACK, WALK = 0, 1


class Lanes(NamedTuple):
    """The active lanes, one row each."""

    scenario: np.ndarray
    target: np.ndarray
    candidate: np.ndarray  # MAIN, or the number of a candidate
    phase: np.ndarray  # TRACK, or WALK in the null space
    stage: np.ndarray  # of the escape, while in it
    fresh: np.ndarray  # x_ref not linearised yet
    iteration: np.ndarray  # step QPs at this target so far
    walked: np.ndarray  # null-space steps so far
    x_previous: np.ndarray
    x_ref: np.ndarray
    linear: Linearisation

    def take(self, rows) -> "Lanes":
        """Some of the lanes, as copies."""
        return _map(lambda t: t[rows], self)


def _map(function: Callable, *lanes: Lanes) -> Lanes:
    fields = [function(*columns) for columns in zip(*(lane[:-1] for lane in lanes), strict=True)]
    linear = Linearisation(*(function(*columns) for columns in zip(*(lane.linear for lane in lanes), strict=True)))
    return Lanes(*fields, linear)


@dataclass
class Waiting:
    """A stuck scenario whose candidates are being tracked."""

    lane: Lanes  # the one lane that is stuck
    left: int  # candidates not decided yet
    reached: list[np.ndarray] = field(default_factory=list)
    numbers: list[int] = field(default_factory=list)
    qps: int = 0  # step QPs that the candidates took


class Engine:
    """Plans the scenarios that an iterator hands out, writing into `plans`; one engine per thread. Without a solver the
    step QPs are solved on the device. It takes at most `share` new scenarios at a time."""

    def __init__(
        self,
        kernels: Kernels,
        solver: QPSolver | None,
        method: str,
        settings: Settings,
        scenarios: Scenario,
        plans: Plans,
        share: int,
    ):
        self._kernels, self._solver, self._settings = kernels, solver, settings
        self._method = METHODS[method]
        self._scenarios, self._plans, self._capacity = scenarios, plans, kernels.lanes
        self._share = share
        self._check_steps = self._method.check_paths or settings.path_check == "all"
        self._check_escapes = self._check_steps or settings.path_check == "escapes"
        self._lanes: Lanes | None = None
        self._queue: list[Lanes] = []  # lanes waiting for room in the table
        self._waiting: dict[int, Waiting] = {}
        self._bodies, self._joints = kernels.bodies, scenarios.x_start.shape[1]

    def run(self, scenarios: Iterator[int], tell: Callable[[int, int], None]) -> None:
        """Plan until the iterator is empty. tell(targets newly tracked, scenarios newly finished) after every round."""
        while self._fill(scenarios):
            self._tracked = self._finished = 0
            lanes, self._lanes = self._lanes, None
            walking = lanes.phase == WALK
            track, walk = (~walking).any(), walking.any()
            if track and walk and not self._kernels.pays_by_lane:
                # A call takes its time however few lanes there are: let the smaller group grow.
                track = walking.sum() <= (~walking).sum()
                walk = not track
                self._keep(lanes.take(walking if track else ~walking))
            if track:
                self._track(lanes.take(~walking))
            if walk:
                self._walk(lanes.take(walking))
            tell(self._tracked, self._finished)

    def _tasks(self, lanes: Lanes) -> Task:
        return tasks(self._scenarios, lanes.scenario, lanes.target)

    # Filling the table

    def _fill(self, scenarios: Iterator[int]) -> bool:
        """Top the table up from the queue, then with new scenarios. False when nothing is left to do."""
        parts, room = [], self._capacity
        if self._lanes is not None:
            parts, room = [self._lanes], room - len(self._lanes.scenario)
        while room > 0 and self._queue:
            block = self._queue.pop(0)
            if len(block.scenario) > room:
                self._queue.insert(0, block.take(slice(room, None)))
                block = block.take(slice(0, room))
            parts.append(block)
            room -= len(block.scenario)
        new = []
        while len(new) < min(room, self._share) and (scenario := next(scenarios, None)) is not None:
            new.append(scenario)
        if new:
            starts = self._scenarios.x_start[new]
            parts.append(self._new_lanes(np.array(new), np.zeros(len(new), int), starts, starts))
        self._lanes = _map(lambda *t: np.concatenate(t), *parts) if parts else None
        return self._lanes is not None

    def _new_lanes(self, scenario, target, x_previous, x_ref, candidate=MAIN, stage=0) -> Lanes:
        lanes, n, k = len(scenario), self._joints, self._bodies

        def column(value):
            return np.broadcast_to(np.asarray(value, np.int32), lanes).copy()

        linear = Linearisation(
            np.zeros((lanes, 3)), np.zeros((lanes, 3, n)), np.zeros((lanes, k)), np.zeros((lanes, k, n))
        )
        return Lanes(
            column(scenario), column(target), column(candidate), column(TRACK), column(stage),
            np.ones(lanes, bool), column(0), column(0), np.array(x_previous), np.array(x_ref), linear,
        )  # fmt: skip

    def _keep(self, lanes: Lanes) -> None:
        """Put lanes that go on back into the table."""
        if len(lanes.scenario):
            self._lanes = (
                lanes if self._lanes is None else _map(lambda a, b: np.concatenate([a, b]), self._lanes, lanes)
            )

    # Tracking by step QPs

    def _track(self, lanes: Lanes) -> None:
        settings = self._settings
        lanes, now, verdict = self._burst(lanes) if self._solver is None else self._step(lanes)
        tried, solved = lanes.iteration > 0, verdict == QPStatus.SOLVED
        reached = tried & solved & (now.residual <= settings.tolerance_m) & (now.clearance > 0)
        stuck = tried & ~reached & (~solved | (lanes.iteration >= settings.inner_iterations))
        self._keep(lanes.take(~reached & ~stuck))

        reason = np.where(
            verdict == QPStatus.INFEASIBLE,
            Status.QP_INFEASIBLE,
            np.where(verdict == QPStatus.FAILED, Status.QP_FAILED, Status.ITERATION_LIMIT),
        )
        main = lanes.candidate == MAIN
        self._stuck(lanes.take(stuck & main), reason[stuck & main])
        self._reached(lanes.take(reached & main), _rows(now, reached & main))
        self._decided(lanes, now, reached & ~main, stuck & ~main)

    def _step(self, lanes: Lanes) -> tuple[Lanes, Measured, np.ndarray]:
        """One step QP for every lane, solved on the host; a fresh lane is linearised only."""
        y, verdict = np.zeros_like(lanes.x_ref), np.full(len(lanes.scenario), QPStatus.SOLVED, np.int32)
        old = ~lanes.fresh
        if old.any():
            known = lanes.take(old)
            qps = self._kernels("prepare", self._tasks(known), known.x_ref, known.x_previous, known.linear)
            y[old], verdict[old] = self._solver.solve(qps)
        now: Measured = self._kernels("advance", self._tasks(lanes), lanes.x_ref, y)
        return self._moved(lanes, now, lanes.iteration + old), now, verdict

    def _burst(self, lanes: Lanes) -> tuple[Lanes, Measured, np.ndarray]:
        """A few step QPs for every lane, solved on the device; a fresh lane is linearised first."""
        if lanes.fresh.any():
            new = lanes.take(lanes.fresh)
            here = self._kernels("advance", self._tasks(new), new.x_ref, np.zeros_like(new.x_ref))
            tables = zip(lanes.linear, here.linear, strict=True)
            lanes = lanes._replace(linear=Linearisation(*(_put(table, lanes.fresh, rows) for table, rows in tables)))
        state = lanes.x_ref, lanes.x_previous, lanes.linear, lanes.iteration
        now, iteration, verdict = self._kernels("track", self._tasks(lanes), *state)
        return self._moved(lanes, now, iteration), now, verdict

    def _moved(self, lanes: Lanes, now: Measured, iteration: np.ndarray) -> Lanes:
        fresh = np.zeros_like(lanes.fresh)
        return lanes._replace(x_ref=now.x, linear=now.linear, iteration=iteration, fresh=fresh)

    def _reached(self, lanes: Lanes, now: Measured) -> None:
        """Main lanes whose step QP reached the target: ascend if the method does, check the path, go on."""
        if not len(lanes.scenario):
            return
        clear = np.full(len(lanes.scenario), -1, np.int8)
        if self._method.keep_clear:
            lanes, now = self._ascended(lanes, now)
        if self._check_steps:
            clear = self._kernels("check_path", self._tasks(lanes), lanes.x_previous, now.x).astype(np.int8)
        blocked = clear == 0
        self._accept(lanes.take(~blocked), _rows(now, ~blocked), Status.TRACKED, 0, clear[~blocked])
        self._stuck(lanes.take(blocked), np.full(int(blocked.sum()), Status.PATH_BLOCKED))

    def _ascended(self, lanes: Lanes, now: Measured) -> tuple[Lanes, Measured]:
        """Keep clear: move on in the null space where D is small, unless that blocks a path that was clear."""
        low = now.clearance < self._settings.keep_clear_m
        if not low.any():
            return lanes, now
        near = lanes.take(low)
        higher = self._kernels("ascend", self._tasks(near), now.x[low]).x
        if self._check_steps:
            clear = self._kernels("check_path", self._tasks(near), near.x_previous, higher)
            higher = np.where(clear[:, None], higher, now.x[low])
        moved = self._kernels("advance", self._tasks(near), higher, np.zeros_like(higher))
        now = _unflat([_put(table, low, new) for table, new in zip(_flat(now), _flat(moved), strict=True)])
        return lanes._replace(x_ref=now.x, linear=now.linear), now

    def _accept(self, lanes: Lanes, now: Measured, status: Status, stage: int, clear: np.ndarray) -> None:
        """Record the target and go on to the next one, or finish."""
        if len(lanes.scenario):
            self._record(lanes, now, status, stage, clear)
            self._go_on(lanes, now)

    def _record(self, lanes: Lanes, now: Measured, status: Status, stage: int, clear: np.ndarray) -> None:
        s, t, plans = lanes.scenario, lanes.target, self._plans
        plans.x[s, t], plans.tcp[s, t] = now.x, now.linear.tcp
        plans.clearance[s, t], plans.residual[s, t] = now.clearance, now.residual
        plans.status[s, t], plans.escape[s, t] = status, stage
        plans.iterations[s, t] = lanes.iteration
        plans.joint_step[s, t] = np.linalg.norm(now.x - lanes.x_previous, axis=1)
        plans.path_clear[s, t] = clear
        self._tracked += len(s)

    def _go_on(self, lanes: Lanes, now: Measured) -> None:
        zero = np.zeros_like(lanes.target)
        lanes = lanes._replace(
            x_previous=now.x,
            x_ref=now.x,
            linear=now.linear,
            target=lanes.target + 1,
            iteration=zero,
            phase=zero + TRACK,
            stage=zero,
        )
        done = lanes.target >= self._scenarios.count[lanes.scenario]
        self._finished += int(done.sum())
        self._keep(lanes.take(~done))

    # Escapes

    def _stuck(self, lanes: Lanes, reason: np.ndarray) -> None:
        """Main lanes that step QPs could not bring to their target."""
        for stage in np.unique(lanes.stage):
            at = lanes.stage == stage
            self._enter(lanes.take(at), int(stage), reason[at])

    def _enter(self, lanes: Lanes, stage: int, reason: np.ndarray) -> None:
        """Begin a stage of the escape; without one, fail."""
        if not len(lanes.scenario):
            return
        stages = self._method.stages
        lanes = lanes._replace(stage=np.full_like(lanes.stage, stage))
        if stage >= len(stages):
            self._fail(lanes, reason)
        elif isinstance(stages[stage], NullSpace):
            here = self._kernels("enter", self._tasks(lanes), lanes.x_previous)
            lanes = lanes._replace(
                phase=np.full_like(lanes.phase, WALK), walked=np.zeros_like(lanes.walked), x_ref=here.x
            )
            self._arrived(lanes, here)
        else:
            found = self._kernels(f"sample {stage}", self._tasks(lanes), lanes.x_previous)
            clear = []
            for k in range(len(lanes.scenario)):
                done = found.done[k]
                if done.any():
                    clear.append((lanes.take([k]), found.x[k][done]))
                else:
                    self._try_candidates(lanes.take([k]), found.x[k][found.valid[k]])
            self._take_best(clear)

    def _walk(self, lanes: Lanes) -> None:
        """One null-space step for every lane that walks."""
        for stage in np.unique(lanes.stage):
            part = lanes.take(lanes.stage == stage)
            here = self._kernels(f"walk {stage}", self._tasks(part), part.x_previous, part.x_ref, part.walked)
            self._arrived(part._replace(x_ref=here.x, walked=part.walked + 1), here)

    def _arrived(self, lanes: Lanes, here) -> None:
        """Lanes after a null-space step: out of it, at the end of it, or still in it."""
        out = (here.clearance > 0) & (here.residual <= self._settings.tolerance_m)
        spent = ~out & (lanes.walked >= self._settings.outer_steps)
        self._keep(lanes.take(~out & ~spent))
        for stage in np.unique(lanes.stage):
            ended = spent & (lanes.stage == stage)
            self._next_stage(lanes.take(ended), int(stage), Status.ESCAPE_EXHAUSTED)
        free = lanes.take(out)
        if self._settings.after_escape == "track":
            for k in range(len(free.scenario)):
                self._try_candidates(free.take([k]), free.x_ref[[k]])
        elif len(free.scenario):
            now = self._kernels("advance", self._tasks(free), free.x_ref, np.zeros_like(free.x_ref))
            self._escaped(free, now)

    def _escaped(self, lanes: Lanes, now: Measured) -> None:
        """Lanes at a configuration that an escape found: the path there must be clear where paths are checked."""
        clear = np.full(len(lanes.scenario), -1, np.int8)
        if self._check_escapes:
            clear = self._kernels("check_path", self._tasks(lanes), lanes.x_previous, now.x).astype(np.int8)
        self._at_the_end(lanes, now, clear)

    def _at_the_end(self, lanes: Lanes, now: Measured, clear: np.ndarray) -> None:
        """Lanes that an escape has brought to their target: go on where the path is clear, or not checked (-1)."""
        for stage in np.unique(lanes.stage):
            good = (clear != 0) & (lanes.stage == stage)
            self._accept(lanes.take(good), _rows(now, good), Status.TRACKED_AFTER_ESCAPE, int(stage) + 1, clear[good])
            self._next_stage(lanes.take((clear == 0) & (lanes.stage == stage)), int(stage), Status.PATH_BLOCKED)

    def _next_stage(self, lanes: Lanes, stage: int, reason: Status) -> None:
        self._enter(lanes, stage + 1, np.full(len(lanes.scenario), reason))

    # Candidates

    def _try_candidates(self, lane: Lanes, x: np.ndarray) -> None:
        """Track the lane's target from each of the configurations x (C, N) while the lane waits."""
        scenario = int(lane.scenario[0])
        self._waiting[scenario] = Waiting(lane, len(x))
        if len(x):
            n = len(x)
            self._queue.append(
                self._new_lanes(
                    np.repeat(lane.scenario, n),
                    np.repeat(lane.target, n),
                    np.repeat(lane.x_previous, n, axis=0),
                    x,
                    candidate=np.arange(n),
                    stage=np.repeat(lane.stage, n),
                )
            )
        else:
            self._choose([scenario])

    def _decided(self, lanes: Lanes, now: Measured, reached: np.ndarray, stuck: np.ndarray) -> None:
        """Candidates that reached the target, and those that did not."""
        ready = []
        for k in np.flatnonzero(reached | stuck):
            scenario = int(lanes.scenario[k])
            waiting = self._waiting[scenario]
            waiting.left -= 1
            waiting.qps += int(lanes.iteration[k])
            if reached[k]:
                waiting.reached.append(now.x[[k]])
                waiting.numbers.append(int(lanes.candidate[k]))
            if not waiting.left:
                ready.append(scenario)
        self._choose(ready)

    def _choose(self, scenarios: list[int]) -> None:
        """Go on from the best of the candidates that reached the target."""
        clear = []
        for waiting in [self._waiting.pop(scenario) for scenario in scenarios]:
            lane = waiting.lane._replace(iteration=waiting.lane.iteration + waiting.qps)
            if waiting.reached:
                # In the order of their numbers, whatever the order in which they came in.
                x = np.concatenate([waiting.reached[k] for k in np.argsort(waiting.numbers)])
                clear.append((lane, x))
            else:
                self._next_stage(lane, int(lane.stage[0]), Status.ESCAPE_EXHAUSTED)
        self._take_best(clear)

    def _take_best(self, found: list[tuple[Lanes, np.ndarray]]) -> None:
        """Go on, from every lane, with one of its configurations (C, N) that are clear on the target: the smallest
        joint change whose path is clear."""
        if not found:
            return
        sizes = [len(x) for _, x in found]
        many = _map(lambda *t: np.concatenate(t), *(lane.take(np.zeros(len(x), int)) for lane, x in found))
        x = np.concatenate([x for _, x in found])
        clear = np.full(len(x), -1, np.int8)
        if self._check_escapes:
            clear = self._kernels("check_path", self._tasks(many), many.x_previous, x).astype(np.int8)
        change = np.where(clear != 0, np.linalg.norm(x - many.x_previous, axis=1), np.inf)
        ends = np.cumsum(sizes)
        best = np.array([end - n + np.argmin(change[end - n : end]) for end, n in zip(ends, sizes, strict=True)])
        many, x = many.take(best), x[best]
        now = self._kernels("advance", self._tasks(many), x, np.zeros_like(x))
        self._at_the_end(many, now, clear[best])

    # Failure, and the way back

    def _fail(self, lanes: Lanes, reason: np.ndarray) -> None:
        """The target is lost, and with it the rest of the scenario, unless another posture leads there."""
        self._plans.status[lanes.scenario, lanes.target] = reason
        self._plans.iterations[lanes.scenario, lanes.target] = lanes.iteration
        for k in range(len(lanes.scenario)):
            if not (self._method.retries and self._plan_backwards(lanes.take([k]))):
                self._finished += 1

    def _plan_backwards(self, lane: Lanes) -> bool:
        """Draw clear configurations at the lost target and carry each back to the first target: a chain that stays
        clear all along, paths included, replaces the rows so far, its first posture the start. False when none does."""
        lost = int(lane.target[0])
        for round_ in range(self._settings.postures):
            here = self._kernels("draw", tasks(self._scenarios, lane.scenario, lane.target, round_))
            here = jax.tree.map(lambda leaf: leaf[0], here)
            chains = here.x[self._good(here)][:, None]
            for row in range(lost - 1, -1, -1):
                if not len(chains):
                    break
                many = np.zeros(len(chains), int)
                at = tasks(self._scenarios, lane.scenario[many], many + row)
                here = self._kernels("push", at, chains[:, 0])
                chains = np.concatenate([here.x[:, None], chains], axis=1)[self._good(here)]
            if any(self._record_chain(lane, chain) for chain in chains):
                return True
        return False

    def _good(self, here) -> np.ndarray:
        return (here.clearance > 0) & (here.residual <= self._settings.tolerance_m)

    def _record_chain(self, lane: Lanes, x: np.ndarray) -> bool:
        """Write the chain x (rows, N) over the rows so far and go on behind it, if its paths are clear."""
        rows = len(x)
        many = lane.take(np.zeros(rows, int))._replace(
            target=np.arange(rows, dtype=np.int32), x_previous=x[[0, *range(rows - 1)]]
        )
        if not self._kernels("check_path", self._tasks(many), many.x_previous, x).all():
            return False
        now = self._kernels("advance", self._tasks(many), x, np.zeros_like(x))
        self._tracked -= rows - 1
        self._record(many, now, Status.TRACKED_AFTER_ESCAPE, len(self._method.stages) + 1, np.ones(rows, np.int8))
        self._go_on(many.take([-1]), _rows(now, [-1]))
        return True


EMPTY = {
    "x": np.nan, "tcp": np.nan, "clearance": np.nan, "residual": np.nan, "status": Status.NOT_ATTEMPTED,
    "iterations": 0, "joint_step": np.nan, "escape": 0, "path_clear": -1,
}  # fmt: skip


def _rows(now: Measured, rows) -> Measured:
    return _unflat([table[rows] for table in _flat(now)])


def _flat(now: Measured) -> list[np.ndarray]:
    return [now.x, *now.linear, now.clearance, now.residual]


def _unflat(tables) -> Measured:
    x, *linear, clearance, residual = tables
    return Measured(x, Linearisation(*linear), clearance, residual)


def _put(table: np.ndarray, rows: np.ndarray, new: np.ndarray) -> np.ndarray:
    table = table.copy()
    table[rows] = new
    return table
