"""The engine advances all unfinished scenarios a few steps at a time; each scenario is a small state machine.

    prepare   (device)  lane -> step QP             linearised task, clearance rows, limits about x_ref
    solve     (host)    step QPs -> steps, verdicts Clarabel
    advance   (device)  lane, step -> lane          linearised and measured at the new x_ref

If the step QPs are solved on the device (`qp: device`), one call runs a chunk of these steps.

A lane is one row of the batch. Usually it tracks one target by step QPs until the target is reached, then the next
target. A stuck lane is in a recovery stage, which takes a few null-space steps at a time, or samples. A lane may also
be one of many candidates of a sampling stage, which track the stuck target while their scenario waits (`candidates`).
If a target has failed, the path to it is planned backwards (`backwards`). Each lane has its own target, phase and step
count. Finished lanes are removed, and new scenarios take their place. One call of a lane function advances all lanes in
the same phase. Lanes do not influence each other: a scenario's result is the same alone, in any batch, in any order and
on any thread.

This module does the bookkeeping on numpy tables (`lanes`). The mathematics is in `step_functions` and in the modules
that it imports; `device.batching` runs it over tables.
"""

import numpy as np

from htcp_jax.device import tables
from htcp_jax.motion import CollisionChecker, Plans, Problem, step_functions
from htcp_jax.planning.tracking.backwards import BackwardPlans, BackwardsRound
from htcp_jax.planning.tracking.candidates import CandidateSearch, StageOutcome
from htcp_jax.planning.tracking.lane_checks import LaneChecks
from htcp_jax.planning.tracking.lanes import BACKWARDS, ENTERING, MAIN, NEW, TRACK, Lanes, LaneTable, Work
from htcp_jax.planning.tracking.record import Record
from htcp_jax.planning.tracking.stages import ASCEND, ENTER, NullSpace, Recoveries
from htcp_jax.solvers import step_qp
from htcp_jax.status import Status


class Engine:
    """Engine of one thread: plans scenarios from `work` and writes the results into `plans`.

    All engines share `work`. Without a `solver` the step QPs are solved on the device.
    """

    def __init__(
        self,
        problem: Problem,
        checker: CollisionChecker,
        solver: step_qp.QPSolver | None,
        recoveries: Recoveries,
        plans: Plans,
        work: Work,
    ):
        settings, scenarios, self._progress = problem.settings, problem.scenarios, problem.progress
        self._executor, self._solver, self._recoveries = checker.executor, solver, recoveries
        self._settings, self._counts = settings, scenarios.count
        self._table = LaneTable(checker.executor, scenarios, work)
        self._checks = LaneChecks(problem, checker, recoveries.check_paths)
        self._record = Record(plans)
        self._candidates = CandidateSearch(self._checks, recoveries, work)
        self._backwards = BackwardPlans(self._checks, self._record, recoveries, settings, scenarios.x_start)
        # Without a null space, stages that need one are skipped.
        self._is_possible = [checker.executor.freedom > 0 or not stage.in_null_space for stage in recoveries.stages]
        self._stage_functions = [stage.lane_function(k) for k, stage in enumerate(recoveries.stages)]

    def run(self) -> None:
        """Plan until no work is left; the problem's `progress` is called every round."""
        while self._table.fill():
            self._record.tracked = self._record.finished = 0
            for phase, lanes in self._table.next_chunk():
                self._advance(phase, lanes)
            self._progress(self._record.tracked, self._record.finished)

    def _advance(self, phase: int, lanes: Lanes) -> None:
        if phase == NEW:
            self._linearise(lanes)
        elif phase == TRACK:
            self._track(lanes)
        elif phase in BACKWARDS:
            self._continue_backwards(self._backwards.advance(lanes, phase))
        elif isinstance(self._recoveries.stages[phase], NullSpace):
            self._move_in_null_space(lanes, phase)
        else:
            self._continue_after_sampling(self._candidates.sample(lanes, phase))

    # Tracking by step QPs

    def _linearise(self, lanes: Lanes) -> None:
        """Linearise new scenarios at their start; end scenarios whose start is in collision."""
        lanes, clearance = self._checks.linearised(lanes)
        collides = clearance <= 0
        self._record.collide(tables.gather(lanes, collides))
        self._table.keep(tables.gather(lanes, ~collides))

    def _track(self, lanes: Lanes) -> None:
        """Solve one step QP for every lane or, on the device, a chunk of step QPs."""
        now, iteration, verdict = self._solve_chunk(lanes) if self._solver is None else self._solve_one_qp(lanes)
        lanes = lanes._replace(x_ref=now.x, linear=now.linear, iteration=iteration)
        solved = verdict == step_qp.QPStatus.SOLVED
        reached = self._checks.at_target(lanes, now, solved)
        tip_blocked = solved & ~reached & self._checks.keeps_margin(lanes, now)
        stuck = tip_blocked | ~reached & (~solved | (iteration >= self._settings.max_step_qps))
        self._table.keep(tables.gather(lanes, ~reached & ~stuck))

        reason = np.where(
            verdict == step_qp.QPStatus.INFEASIBLE,
            Status.QP_INFEASIBLE,
            np.where(verdict == step_qp.QPStatus.FAILED, Status.QP_FAILED, Status.ITERATION_LIMIT),
        )
        reason[tip_blocked] = Status.TIP_BLOCKED
        main = lanes.candidate == MAIN
        self._enter_stage(tables.gather(lanes, stuck & main), 0, reason[stuck & main])
        self._accept_reached(tables.gather(lanes, reached & main), tables.gather(now, reached & main))
        for outcome in self._candidates.decide(lanes, now, reached & ~main, stuck & ~main):
            self._continue_after_sampling(outcome)

    def _solve_one_qp(self, lanes: Lanes) -> tuple[step_functions.State, np.ndarray, np.ndarray]:
        qps = self._executor(
            step_functions.PREPARE, self._checks.inputs(lanes), lanes.x_ref, lanes.x_previous, lanes.linear
        )
        y, verdict = self._solver.solve(qps)
        return self._checks.advanced(lanes, y), lanes.iteration + 1, verdict

    def _solve_chunk(self, lanes: Lanes) -> tuple[step_functions.State, np.ndarray, np.ndarray]:
        state = lanes.x_ref, lanes.x_previous, lanes.linear, lanes.iteration
        return self._executor(step_functions.TRACK_CHUNK, self._checks.inputs(lanes), *state)

    def _accept_reached(self, lanes: Lanes, now: step_functions.State) -> None:
        """Continue main lanes that have reached the target: increase D if required, check the path, accept."""
        if not lanes.size:
            return
        if self._recoveries.keep_clear and self._executor.freedom:
            lanes, now = self._ascended(lanes, now)
        clear = self._checks.path_clear(lanes, now.x, self._checks.of_steps)
        blocked = clear == 0
        self._accept(tables.gather(lanes, ~blocked), tables.gather(now, ~blocked), Status.TRACKED, 0, clear[~blocked])
        self._enter_stage(tables.gather(lanes, blocked), 0, Status.PATH_BLOCKED)

    def _ascended(self, lanes: Lanes, now: step_functions.State) -> tuple[Lanes, step_functions.State]:
        """Return the lanes after an increase of D in the null space where D is small, unless it blocks a clear path."""
        low = now.clearance < self._settings.keep_clear_m
        if not low.any():
            return lanes, now
        near = tables.gather(lanes, low)
        higher = self._executor(ASCEND, self._checks.inputs(near), now.x[low]).x
        clear = self._checks.path_clear(near, higher, self._checks.of_steps)
        clear[~self._checks.tip_free(near, higher, clear != 0)] = 0
        higher = np.where(clear[:, None] != 0, higher, now.x[low])
        now = tables.scatter(now, low, self._checks.measured(near, higher))
        return lanes._replace(x_ref=now.x, linear=now.linear), now

    def _accept(
        self, lanes: Lanes, now: step_functions.State, status: Status, recovery: int, clear: np.ndarray
    ) -> None:
        """Record that the target is reached, and continue with the next one; finish after the last."""
        if lanes.size:
            self._record.track(lanes, now, status, recovery, clear)
            self._continue_path(lanes, now)

    def _continue_path(self, lanes: Lanes, now: step_functions.State) -> None:
        zero = np.zeros_like(lanes.target)
        lanes = lanes._replace(
            x_previous=now.x,
            x_ref=now.x,
            linear=now.linear,
            target=lanes.target + 1,
            iteration=zero,
            phase=zero + TRACK,
        )
        done = lanes.target >= self._counts[lanes.scenario]
        self._record.finished += int(done.sum())
        self._table.keep(tables.gather(lanes, ~done))

    # Recovery stages

    def _enter_stage(self, lanes: Lanes, stage: int, reason: np.ndarray | Status) -> None:
        """Enter a recovery stage with main lanes that are stuck.

        If the method has no stage with that number, the target fails, and the scenario ends unless it is planned
        backwards.
        """
        if not lanes.size:
            return
        while stage < len(self._is_possible) and not self._is_possible[stage]:
            stage, reason = stage + 1, Status.NO_NULL_SPACE
        if stage < len(self._is_possible):
            phase, null_space_steps = np.full_like(lanes.phase, stage), np.full_like(lanes.null_space_steps, ENTERING)
            self._table.keep(lanes._replace(phase=phase, null_space_steps=null_space_steps))
        else:
            self._record.lose(lanes, reason)
            self._continue_backwards(self._backwards.begin(lanes))

    def _move_in_null_space(self, lanes: Lanes, stage: int) -> None:
        """Take a chunk of null-space steps with every lane; new lanes are first moved onto their target."""
        entering = lanes.null_space_steps == ENTERING
        if entering.any():
            new = tables.gather(lanes, entering)
            now = self._executor(ENTER, self._checks.inputs(new), new.x_previous)
            new = self._after_steps(new._replace(null_space_steps=np.zeros_like(new.null_space_steps)), now, stage)
            lanes = tables.concatenate([tables.gather(lanes, ~entering), new])
        if lanes.size:
            most = np.minimum(
                lanes.null_space_steps + step_functions.STEPS_PER_CHUNK, self._settings.max_null_space_steps
            ).astype(np.int32)
            state = lanes.x_previous, lanes.x_ref, lanes.null_space_steps, most
            now, null_space_steps = self._executor(self._stage_functions[stage], self._checks.inputs(lanes), *state)
            self._table.keep(self._after_steps(lanes._replace(null_space_steps=null_space_steps), now, stage))

    def _after_steps(self, lanes: Lanes, now: step_functions.State, stage: int) -> Lanes:
        """Return the lanes whose recovery in the null space continues.

        Lanes that meet the success criterion, and lanes that have taken the maximum number of steps, leave the stage.
        """
        lanes = lanes._replace(x_ref=now.x)
        out = self._checks.at_target(lanes, now)
        spent = ~out & (lanes.null_space_steps >= self._settings.max_null_space_steps)
        reason = np.where(self._checks.keeps_margin(lanes, now), Status.TIP_BLOCKED, Status.RECOVERY_EXHAUSTED)
        self._enter_stage(tables.gather(lanes, spent), stage + 1, reason[spent])
        free = tables.gather(lanes, out)
        if self._settings.after_recovery == "track":
            one_each = np.ones((free.size, 1), bool)
            self._continue_after_sampling(self._candidates.track_from(free, free.x_ref[:, None], one_each, stage))
        else:
            clear = self._checks.path_clear(free, free.x_ref, self._checks.of_recoveries)
            self._accept_recovered(free, tables.gather(now, out), clear, stage)
        return tables.gather(lanes, ~out & ~spent)

    def _accept_recovered(self, lanes: Lanes, now: step_functions.State, clear: np.ndarray, stage: int) -> None:
        """Accept lanes that a stage has brought to their target if the path to the target is clear or not checked."""
        good = clear != 0
        self._accept(
            tables.gather(lanes, good), tables.gather(now, good), Status.TRACKED_AFTER_RECOVERY, stage + 1, clear[good]
        )
        self._enter_stage(tables.gather(lanes, ~good), stage + 1, Status.PATH_BLOCKED)

    def _continue_after_sampling(self, outcome: StageOutcome) -> None:
        """Continue with the outcome of a sampling stage."""
        if outcome.candidates is not None:
            self._table.queue(self._checks.linearised(outcome.candidates)[0])
        if outcome.arrived is not None:
            self._accept_recovered(*outcome.arrived, outcome.stage)
        self._enter_stage(outcome.spent, outcome.stage + 1, Status.RECOVERY_EXHAUSTED)

    def _continue_backwards(self, replanned: BackwardsRound) -> None:
        """Continue with the result of a round of planning backwards."""
        self._table.keep(replanned.going)
        self._record.finished += replanned.lost
        if replanned.now is not None:
            self._continue_path(replanned.found, replanned.now)
