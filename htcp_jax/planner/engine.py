"""The engine: a scenario is a small state machine, and the engine advances every unfinished one by one step at a time.

    prepare   (device)  lane -> step QP             linearised task, clearance rows, limits about x_ref
    solve     (host)    step QPs -> steps, verdicts Clarabel
    advance   (device)  lane, step -> lane          linearised and measured at the new x_ref

or, when the step QPs are solved on the device too (`qp: device`), a burst of these rounds at a time.

A lane tracks one target by step QPs until it is reached, then the next one; or it is stuck and in a stage of its
escape, which walks the null space one step at a time or samples; or it is one of many candidates of a sampling stage,
tracking the stuck target on behalf of a scenario that waits. Each lane has its own target, phase and count; finished
ones leave, new scenarios take their place. Lanes in the same phase go through one kernel together. Which lanes those
happen to be has no influence on any of them: a scenario's result is the same alone, in any batch, in any order and on
any thread.

Everything here is bookkeeping on numpy tables (`lanes`). The mathematics is in `escape` and below; batching is in
`kernels`.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from htcp_jax.planner.kernels import Measured
from htcp_jax.planner.lane_inputs import LaneInputs, lane_inputs
from htcp_jax.planner.lanes import ENTERING, MAIN, NEW, TRACK, Lanes, concatenate, gather, new_lanes, scatter
from htcp_jax.planner.methods import METHODS, NullSpace
from htcp_jax.planner.null_space import Anchored
from htcp_jax.planner.plans import Plans
from htcp_jax.planner.programs import Kernels
from htcp_jax.planner.sampling import Candidates
from htcp_jax.planner.tip_check import TipCheck
from htcp_jax.scene.scenario import Scenario
from htcp_jax.settings import Settings
from htcp_jax.solvers.step_qp import QPSolver, QPStatus
from htcp_jax.status import Status


@dataclass
class PendingCandidates:
    """A stuck scenario whose candidates are being tracked."""

    lane: Lanes  # the one lane that is stuck
    left: int  # candidates not decided yet
    qps: int = 0  # step QPs that the candidates took
    numbers: list[np.ndarray] = field(default_factory=list)  # of the candidates that reached the target
    ends: list[Measured] = field(default_factory=list)  # where those are


class Engine:
    """Plans the scenarios that an iterator hands out, writing into `plans`; one engine per thread. Without a solver the
    step QPs are solved on the device. It takes at most `share` new scenarios at a time. With `tip`, no target counts at
    which the tool's bare tip passes through a wall."""

    def __init__(
        self,
        kernels: Kernels,
        solver: QPSolver | None,
        method: str,
        settings: Settings,
        scenarios: Scenario,
        plans: Plans,
        share: int,
        tip: TipCheck | None = None,
    ):
        self._kernels, self._solver, self._settings, self._tip = kernels, solver, settings, tip
        self._method = METHODS[method]
        self._scenarios, self._plans, self._capacity = scenarios, plans, kernels.lanes
        self._share = share
        self._check_steps = self._method.check_paths or settings.path_check == "all"
        self._check_escapes = self._check_steps or settings.path_check == "escapes"
        self._lanes: Lanes | None = None
        self._queue: list[Lanes] = []  # lanes waiting for room in the table
        self._waiting: dict[int, PendingCandidates] = {}

    def run(self, scenarios: Iterator[int], progress: Callable[[int, int], None]) -> None:
        """Plan until the iterator is empty; progress(targets newly tracked, scenarios newly finished) every round."""
        while self._fill(scenarios):
            self._tracked = self._finished = 0
            for phase, lanes in self._turn():
                if phase == NEW:
                    self._linearise(lanes)
                elif phase == TRACK:
                    self._track(lanes)
                elif isinstance(self._method.stages[phase], NullSpace):
                    self._walk(lanes, phase)
                else:
                    self._sample(lanes, phase)
            progress(self._tracked, self._finished)

    def _turn(self) -> list[tuple[int, Lanes]]:
        """Take the lanes whose turn it is out of the table, by phase. Where a call takes its time however few lanes
        there are, it is the turn of the phase that has most: the others grow meanwhile."""
        lanes, self._lanes = self._lanes, None
        phases, counts = np.unique(lanes.phase, return_counts=True)
        if not self._kernels.pays_by_lane:
            phases = phases[[np.argmax(counts)]]
            self._keep(gather(lanes, lanes.phase != phases[0]))
        return [(int(phase), gather(lanes, lanes.phase == phase)) for phase in phases]

    def _inputs(self, lanes: Lanes) -> LaneInputs:
        return lane_inputs(self._scenarios, lanes.scenario, lanes.target)

    def _measured(self, lanes: Lanes, x: np.ndarray) -> Measured:
        """The lanes at configurations x (lanes, N)."""
        return self._kernels("advance", self._inputs(lanes), x, np.zeros_like(x))

    def _counts(self, lanes: Lanes, here: Measured | Anchored) -> np.ndarray:
        """Which lanes keep their margin on their target."""
        margin_m = self._scenarios.margin_m[lanes.scenario]
        return self._kernels.task.counts(here.clearance, here.residual, margin_m)

    def _tip_passes(self, lanes: Lanes, x: np.ndarray, among: np.ndarray) -> np.ndarray:
        """In which of some lanes, `among`, the tip of the tool passes through a wall at x."""
        through = np.zeros(len(x), bool)
        if self._tip is not None and among.any():
            through[among] = self._tip.at(self._inputs(gather(lanes, among)), x[among])
        return through

    def _at_target(self, lanes: Lanes, here: Measured | Anchored) -> np.ndarray:
        """Which lanes count: they keep their margin on their target, and the tool's tip is out of the walls."""
        good = self._counts(lanes, here)
        return good & ~self._tip_passes(lanes, here.x, good)

    def _path_clear(self, lanes: Lanes, x: np.ndarray, asked: bool) -> np.ndarray:
        """Whether the joint path from each lane's last target to x is clear; -1 where nobody asked."""
        if not (asked and len(x)):
            return np.full(len(x), -1, np.int8)
        inputs = self._inputs(lanes)
        clear = self._kernels("check_path", inputs, lanes.x_previous, x)
        if self._tip is not None:
            clear = clear & ~self._tip.along(inputs, lanes.x_previous, x)
        return clear.astype(np.int8)

    # Filling the table

    def _fill(self, scenarios: Iterator[int]) -> bool:
        """Top the table up from the queue, then with new scenarios. False when nothing is left to do."""
        parts, room = [], self._capacity
        if self._lanes is not None:
            parts, room = [self._lanes], room - self._lanes.size
        while room > 0 and self._queue:
            block = self._queue.pop(0)
            if block.size > room:
                self._queue.insert(0, gather(block, slice(room, None)))
                block = gather(block, slice(0, room))
            parts.append(block)
            room -= block.size
        new = []
        while len(new) < min(room, self._share) and (scenario := next(scenarios, None)) is not None:
            new.append(scenario)
        if new:
            starts = self._scenarios.x_start[new]
            parts.append(new_lanes(self._kernels.sizes, np.array(new), np.zeros(len(new), int), starts, starts))
        self._lanes = concatenate(parts) if parts else None
        return self._lanes is not None

    def _keep(self, lanes: Lanes) -> None:
        """Put lanes that go on back into the table."""
        if lanes.size:
            self._lanes = lanes if self._lanes is None else concatenate([self._lanes, lanes])

    # Tracking by step QPs

    def _linearise(self, lanes: Lanes) -> None:
        """Linearise new lanes where they are. A scenario whose start is in collision is over."""
        now = self._measured(lanes, lanes.x_ref)
        lanes = lanes._replace(x_ref=now.x, linear=now.linear, phase=np.full_like(lanes.phase, TRACK))
        collides = (lanes.candidate == MAIN) & (now.clearance <= 0)
        self._plans.status[lanes.scenario[collides], lanes.target[collides]] = Status.START_IN_COLLISION
        self._finished += int(collides.sum())
        self._keep(gather(lanes, ~collides))

    def _track(self, lanes: Lanes) -> None:
        """One step QP for every lane, or on the device a burst of them."""
        now, iteration, verdict = self._burst(lanes) if self._solver is None else self._step(lanes)
        lanes = lanes._replace(x_ref=now.x, linear=now.linear, iteration=iteration)
        solved = verdict == QPStatus.SOLVED
        reached = solved & self._counts(lanes, now)
        tip_blocked = self._tip_passes(lanes, now.x, reached)
        reached &= ~tip_blocked
        stuck = tip_blocked | ~reached & (~solved | (iteration >= self._settings.inner_iterations))
        self._keep(gather(lanes, ~reached & ~stuck))

        reason = np.where(
            verdict == QPStatus.INFEASIBLE,
            Status.QP_INFEASIBLE,
            np.where(verdict == QPStatus.FAILED, Status.QP_FAILED, Status.ITERATION_LIMIT),
        )
        reason[tip_blocked] = Status.TIP_BLOCKED
        main = lanes.candidate == MAIN
        self._enter(gather(lanes, stuck & main), 0, reason[stuck & main])
        self._reached(gather(lanes, reached & main), gather(now, reached & main))
        self._decided(lanes, now, reached & ~main, stuck & ~main)

    def _step(self, lanes: Lanes) -> tuple[Measured, np.ndarray, np.ndarray]:
        inputs = self._inputs(lanes)
        qps = self._kernels("prepare", inputs, lanes.x_ref, lanes.x_previous, lanes.linear)
        y, verdict = self._solver.solve(qps)
        return self._kernels("advance", inputs, lanes.x_ref, y), lanes.iteration + 1, verdict

    def _burst(self, lanes: Lanes) -> tuple[Measured, np.ndarray, np.ndarray]:
        state = lanes.x_ref, lanes.x_previous, lanes.linear, lanes.iteration
        return self._kernels("track", self._inputs(lanes), *state)

    def _reached(self, lanes: Lanes, now: Measured) -> None:
        """Main lanes whose step QP reached the target: ascend if the method does, check the path, go on."""
        if not lanes.size:
            return
        if self._method.keep_clear:
            lanes, now = self._ascended(lanes, now)
        clear = self._path_clear(lanes, now.x, self._check_steps)
        blocked = clear == 0
        self._accept(gather(lanes, ~blocked), gather(now, ~blocked), Status.TRACKED, 0, clear[~blocked])
        self._enter(gather(lanes, blocked), 0, Status.PATH_BLOCKED)

    def _ascended(self, lanes: Lanes, now: Measured) -> tuple[Lanes, Measured]:
        """Keep clear: move on in the null space where D is small, unless that blocks a path that was clear."""
        low = now.clearance < self._settings.keep_clear_m
        if not low.any():
            return lanes, now
        near = gather(lanes, low)
        higher = self._kernels("ascend", self._inputs(near), now.x[low]).x
        clear = self._path_clear(near, higher, self._check_steps)
        clear[self._tip_passes(near, higher, clear != 0)] = 0
        higher = np.where(clear[:, None] != 0, higher, now.x[low])
        moved = self._measured(near, higher)
        now = scatter(now, low, moved)
        return lanes._replace(x_ref=now.x, linear=now.linear), now

    def _accept(self, lanes: Lanes, now: Measured, status: Status, stage: int, clear: np.ndarray) -> None:
        """Record the target and go on to the next one, or finish."""
        if lanes.size:
            self._record(lanes, now, status, stage, clear)
            self._go_on(lanes, now)

    def _record(self, lanes: Lanes, now: Measured, status: Status, stage: int, clear: np.ndarray) -> None:
        s, t, plans = lanes.scenario, lanes.target, self._plans
        plans.x[s, t], plans.tcp[s, t] = now.x, now.tcp
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
        )
        done = lanes.target >= self._scenarios.count[lanes.scenario]
        self._finished += int(done.sum())
        self._keep(gather(lanes, ~done))

    # Escapes

    def _enter(self, lanes: Lanes, stage: int, reason: np.ndarray | Status) -> None:
        """Main lanes that have not come to their target: the given stage of the escape is next; without one, fail."""
        if not lanes.size:
            return
        if stage < len(self._method.stages):
            phase, walked = np.full_like(lanes.phase, stage), np.full_like(lanes.walked, ENTERING)
            self._keep(lanes._replace(phase=phase, walked=walked))
        else:
            self._fail(lanes, reason)

    def _walk(self, lanes: Lanes, stage: int) -> None:
        """One null-space step for every lane; one that enters is brought onto its target first."""
        entering = lanes.walked == ENTERING
        if entering.any():
            new = gather(lanes, entering)
            now = self._kernels("enter", self._inputs(new), new.x_previous)
            lanes = concatenate([gather(lanes, ~entering), self._arrived(new, now, stage)])
        if lanes.size:
            now = self._kernels(f"walk {stage}", self._inputs(lanes), lanes.x_previous, lanes.x_ref, lanes.walked)
            self._keep(self._arrived(lanes, now, stage))

    def _arrived(self, lanes: Lanes, now: Measured, stage: int) -> Lanes:
        """Lanes after one more step in the null space: those that are out of it, or at the end of it, leave; the others
        come back."""
        lanes = lanes._replace(x_ref=now.x, walked=lanes.walked + 1)
        out = self._at_target(lanes, now)
        spent = ~out & (lanes.walked >= self._settings.outer_steps)
        reason = np.where(self._counts(lanes, now), Status.TIP_BLOCKED, Status.ESCAPE_EXHAUSTED)
        self._enter(gather(lanes, spent), stage + 1, reason[spent])
        free = gather(lanes, out)
        if self._settings.after_escape == "track":
            self._try_candidates(free, free.x_ref[:, None], np.ones((free.size, 1), bool), stage)
        else:
            self._escaped(free, gather(now, out), self._path_clear(free, free.x_ref, self._check_escapes), stage)
        return gather(lanes, ~out & ~spent)

    def _escaped(self, lanes: Lanes, now: Measured, clear: np.ndarray, stage: int) -> None:
        """Lanes that a stage has brought to their target: go on where the path there is clear, or not checked."""
        good = clear != 0
        self._accept(gather(lanes, good), gather(now, good), Status.TRACKED_AFTER_ESCAPE, stage + 1, clear[good])
        self._enter(gather(lanes, ~good), stage + 1, Status.PATH_BLOCKED)

    # Candidates

    def _sample(self, lanes: Lanes, stage: int) -> None:
        """Propose candidates for every lane. Where some are done as they are, take the best of them; elsewhere try."""
        found = self._kernels(f"sample {stage}", self._inputs(lanes), lanes.x_previous)
        found = found._replace(done=self._without_passing_tips(lanes, found))
        done = found.done.any(axis=1)
        self._try_candidates(gather(lanes, ~done), found.x[~done], found.valid[~done], stage)
        if done.any():
            lanes, (owner, number) = gather(lanes, done), np.nonzero(found.done[done])
            x = found.x[done][owner, number]
            best, clear = self._best(lanes, owner, number, x)
            self._escaped(lanes, self._measured(lanes, x[best]), clear, stage)

    def _without_passing_tips(self, lanes: Lanes, found: Candidates) -> np.ndarray:
        """Which candidates (lanes, C) are done, but for those whose tip passes through a wall."""
        owner, number = np.nonzero(found.done)
        through = self._tip_passes(gather(lanes, owner), found.x[owner, number], np.ones(len(owner), bool))
        done = found.done.copy()
        done[owner[through], number[through]] = False
        return done

    def _try_candidates(self, lanes: Lanes, x: np.ndarray, valid: np.ndarray, stage: int) -> None:
        """Track the target of each lane from its valid configurations, x (lanes, C, N), while the lane waits."""
        left = valid.sum(axis=1)
        for k in np.flatnonzero(left):
            self._waiting[int(lanes.scenario[k])] = PendingCandidates(gather(lanes, [k]), int(left[k]))
        owner, number = np.nonzero(valid)
        if len(owner):
            at = lanes.scenario[owner], lanes.target[owner]
            x = x[owner, number]
            self._queue.append(new_lanes(self._kernels.sizes, *at, lanes.x_previous[owner], x, number))
        self._enter(gather(lanes, left == 0), stage + 1, Status.ESCAPE_EXHAUSTED)

    def _decided(self, lanes: Lanes, now: Measured, reached: np.ndarray, stuck: np.ndarray) -> None:
        """Candidates that reached the target, and those that did not."""
        decided = np.flatnonzero(reached | stuck)
        if not len(decided):
            return
        decided = decided[np.argsort(lanes.scenario[decided], kind="stable")]
        ready = []
        for rows in np.split(decided, np.flatnonzero(np.diff(lanes.scenario[decided])) + 1):
            scenario = int(lanes.scenario[rows[0]])
            waiting = self._waiting[scenario]
            waiting.left -= len(rows)
            waiting.qps += int(lanes.iteration[rows].sum())
            if reached[rows].any():
                good = rows[reached[rows]]
                waiting.numbers.append(lanes.candidate[good])
                waiting.ends.append(gather(now, good))
            if not waiting.left:
                ready.append(self._waiting.pop(scenario))
        for stage in sorted({int(waiting.lane.phase[0]) for waiting in ready}):
            self._choose([waiting for waiting in ready if waiting.lane.phase[0] == stage], stage)

    def _choose(self, ready: list[PendingCandidates], stage: int) -> None:
        """Go on from the best of the candidates that reached the target."""
        lanes = concatenate([each.lane._replace(iteration=each.lane.iteration + each.qps) for each in ready])
        found = np.array([bool(each.numbers) for each in ready])
        self._enter(gather(lanes, ~found), stage + 1, Status.ESCAPE_EXHAUSTED)
        if found.any():
            ready, lanes = [each for each in ready if each.numbers], gather(lanes, found)
            owner = np.repeat(np.arange(len(ready)), [sum(map(len, each.numbers)) for each in ready])
            number = np.concatenate([part for each in ready for part in each.numbers])
            now = concatenate([part for each in ready for part in each.ends])
            best, clear = self._best(lanes, owner, number, now.x)
            self._escaped(lanes, gather(now, best), clear, stage)

    def _best(self, lanes: Lanes, owner: np.ndarray, number: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, ...]:
        """For every lane, which of the configurations x (M, N) that it owns has the smallest joint change of those
        whose path is clear, and whether that is clear (-1: not checked)."""
        start = lanes.x_previous[owner]
        clear = self._path_clear(gather(lanes, owner), x, self._check_escapes)
        change = np.where(clear != 0, np.linalg.norm(x - start, axis=1), np.inf)
        order = np.lexsort((number, change, owner))
        best = order[np.unique(owner[order], return_index=True)[1]]
        return best, clear[best]

    # Failure, and the way back

    def _fail(self, lanes: Lanes, reason: np.ndarray | Status) -> None:
        """The target is lost, and with it the rest of the scenario, unless another posture leads there."""
        self._plans.status[lanes.scenario, lanes.target] = reason
        self._plans.iterations[lanes.scenario, lanes.target] = lanes.iteration
        for k in range(lanes.size):
            if not (self._method.retries and self._plan_backwards(gather(lanes, [k]))):
                self._finished += 1

    def _plan_backwards(self, lane: Lanes) -> bool:
        """Draw clear configurations at the lost target and carry each back to the first target: a chain that is clear
        all along, from the start to its first posture too, replaces the rows so far. False when none does."""
        lost = int(lane.target[0])
        for round_ in range(self._settings.postures):
            here = self._kernels("draw", lane_inputs(self._scenarios, lane.scenario, lane.target, round_))
            here = gather(here, 0)
            chains = here.x[self._at_target(gather(lane, np.zeros(len(here.x), int)), here)][:, None]
            for row in range(lost - 1, -1, -1):
                if not len(chains):
                    break
                many = gather(lane, np.zeros(len(chains), int))
                at = lane_inputs(self._scenarios, many.scenario, np.full(many.size, row))
                here = self._kernels("push", at, chains[:, 0])
                chains = np.concatenate([here.x[:, None], chains], axis=1)[self._at_target(many, here)]
            if any(self._record_chain(lane, chain) for chain in chains):
                return True
        return False

    def _record_chain(self, lane: Lanes, x: np.ndarray) -> bool:
        """Write the chain x (rows, N) over the rows so far and go on behind it, if its paths are clear."""
        rows, start = len(x), self._scenarios.x_start[lane.scenario]
        many = gather(lane, np.zeros(rows, int))._replace(
            target=np.arange(rows, dtype=np.int32), x_previous=np.concatenate([start, x[:-1]])
        )
        if not self._path_clear(many, x, asked=True).all():
            return False
        now = self._measured(many, x)
        self._tracked -= rows - 1
        self._record(many, now, Status.TRACKED_AFTER_ESCAPE, len(self._method.stages) + 1, np.ones(rows, np.int8))
        self._go_on(gather(many, [-1]), gather(now, [-1]))
        return True


EMPTY = {
    "x": np.nan, "tcp": np.nan, "clearance": np.nan, "residual": np.nan, "status": Status.NOT_ATTEMPTED,
    "iterations": 0, "joint_step": np.nan, "escape": 0, "path_clear": -1,
}  # fmt: skip
