"""Experiments behind the deviations from the paper's two tables, under configs/paper.yaml at equal joint weights.

    python -m benchmarks paper-deviations [--only NAME,...] [--cloud measured|generated]

Prints Markdown tables of the success in % of all targets, poses / starts unless a column says otherwise. One experiment
takes minutes, `jacobian`, `readings` and `fmincon` about ten each on two idle cores (estimated).
"""

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import NonlinearConstraint, minimize

from htcp_jax.caching import cache_folder
from htcp_jax.clearance import Scene, minimum_clearance, own_scene
from htcp_jax.device import Executor
from htcp_jax.device.executor import EXECUTABLES
from htcp_jax.device.lane_function import DEEP_LOOP, LaneFunction
from htcp_jax.jobs.grid import load_sweep
from htcp_jax.model.kinematics import point_jacobians, tcp_position
from htcp_jax.motion import CollisionChecker, Execution, Plans, Problem, step_functions
from htcp_jax.motion.step_functions import MEASURED as READS_OF_MEASURED
from htcp_jax.motion.step_functions import measured
from htcp_jax.planning import methods as planning_methods
from htcp_jax.planning import registry
from htcp_jax.planning.batch import plan
from htcp_jax.planning.tracking import StepQPs
from htcp_jax.planning.tracking.lane_checks import LaneChecks
from htcp_jax.planning.tracking.null_space import READS, anchor, null_space_step, sphere_problem, stuck_at
from htcp_jax.planning.tracking.stages import NullSpace, NullSpaceState, take_null_space_steps
from htcp_jax.solvers import cma_es, sphere

ROOT = Path(__file__).resolve().parents[1]
MEASURED = ROOT.parent / "shared/data/duct"
OVERRIDES = {
    "measured": (
        f"workpiece.cloud={MEASURED / 'cloud.xyz'}",
        f"workpiece.path={MEASURED / 'weld.csv'}",
        "workpiece.inlet_m=[0, 0, 0.19138]",
    ),
    "generated": (),
}
SIX = ("baseline", "cspace-sample", "nspace-sample", "nspace-sqp", "nspace-ip", "nspace-cmaes")
OPTIMISERS = SIX[3:]
SWEEPS = "workpiece", "robot"
EQUAL, PORT = "settings.q_weights=[1,1,1,1,1,1]", "settings.q_weights=[5,5,2,1,5,10]"
PAPER = {  # success %, TCP distance mm, safe distance mm, of each sweep by each of the six
    "workpiece": (
        (39.16, 49.93, 50.11, 70.73, 76.87, 62.22),
        (0.4831, 0.4668, 0.4557, 0.4207, 0.3986, 0.4287),
        (12.0973, 4.6684, 4.1437, 4.3668, 1.7241, 7.5280),
    ),
    "robot": (
        (66.95, 68.50, 70.85, 99.84, 99.71, 100.0),
        (0.4474, 0.4510, 0.4494, 0.4450, 0.4385, 0.4533),
        (0.1561, 0.1572, 0.4622, 0.6309, 0.7028, 0.8200),
    ),
}
BASE_M = 0.259  # height of the GP50's base in the world


@dataclass(frozen=True)
class Runs:
    """Planner of both sweeps on one cloud."""

    cloud: str

    def plans(self, sweep: str, method: str, *overrides: str, edit: tuple[tuple[str, str], ...] = ()) -> Plans:
        """Return the plans of one sweep; edit: (old, new) texts of the sweep file."""
        text = (ROOT / f"sweeps/{sweep}.yaml").read_text()
        for old, new in edit:
            text = text.replace(old, new)
        with tempfile.TemporaryDirectory() as folder:
            (file := Path(folder) / f"{sweep}.yaml").write_text(text)
            spec = load_sweep(file, ROOT / "configs/paper.yaml", [*OVERRIDES[self.cloud], EQUAL, *overrides])
            batch = spec.batch()
        how = {"check_paths": False, "execution": Execution(processes=1)}
        return plan(Problem.of(batch.robot, batch.workpiece, batch.scenarios, spec.config.settings, **how), method)

    def success(self, method: str, *overrides: str, sweeps: tuple[str, ...] = SWEEPS, **edit) -> str:
        """Return the success in %, one number per sweep."""
        found = [self.plans(sweep, method, *overrides, **edit) for sweep in sweeps]
        return " / ".join(f"{100 * each.tracked.mean():.2f}" for each in found)


def table(head: tuple[str, ...], rows) -> None:
    """Print a Markdown table, row by row as they come."""
    print("\n|", " | ".join(head), "|\n|" + "---|" * len(head), flush=True)
    for row in rows:
        print("|", " | ".join(row), "|", flush=True)


def readings(runs: Runs) -> None:
    """Weights, the cost's centre and the step after a recovery, all six methods."""
    after_recovery = "accept", "track"
    cases = [
        (q, about, after) for q in (EQUAL, PORT) for about in ("previous", "reference") for after in after_recovery
    ]

    def row(q, about, after):
        def one(method):
            if after == "track" and method not in OPTIMISERS:
                return "as above"  # no method without a null-space stage reads it
            return runs.success(method, q, f"settings.cost_about={about}", f"settings.after_recovery={after}")

        return "equal" if q == EQUAL else "port", about, after, *map(one, SIX)

    paper = (" / ".join(f"{PAPER[sweep][0][m]:.2f}" for sweep in SWEEPS) for m in range(6))
    head = "Q", "cost about", "after recovery", *SIX
    table(head, chain([("paper", "", "", *paper)], (row(*case) for case in cases)))


def cmaes(runs: Runs) -> None:
    """CMA-ES: initial sigma, first direction, how |w| = 1 is kept, what is returned."""

    def minimise(sigma, is_random, penalty, is_mean, problem, seen, key, settings):
        population, dimension = settings.population, problem.curvature.shape[0]
        strategy = cma_es.strategy_parameters(population, dimension)

        def of(w):
            length = jnp.linalg.norm(w)
            if penalty is None:
                return w / length, problem.measure(w / length)
            return w, problem.measure(w) - penalty * jnp.abs(length - 1)

        def body(generation, state):
            distribution, best, value = state
            samples = cma_es.ask(distribution, jax.random.fold_in(key, generation), population)
            w, merit = jax.vmap(of)(samples)
            top = jnp.argmax(merit)
            best = jnp.where(merit[top] > value, w[top], best)
            return cma_es.tell(distribution, samples, -merit, strategy), best, jnp.maximum(merit[top], value)

        first = sphere.first_direction(problem, seen)
        if is_random:
            draw = jax.random.normal(jax.random.fold_in(key, settings.generations), (dimension,))
            first = draw / jnp.linalg.norm(draw)
        state = cma_es.start(first, sigma), first, jnp.full((), -jnp.inf)
        distribution, best, value = jax.lax.fori_loop(0, settings.generations, body, state)
        return sphere.Best(of(distribution.mean)[0] if is_mean else best, value)

    def row(sigma, is_random, penalty=None, is_mean=False, generations=5):
        with own_null_space(
            partial(minimise, sigma, is_random, penalty, is_mean), ("population", "generations")
        ) as name:
            found = runs.success(name, f"settings.generations={generations}")
        first, returned = "random" if is_random else "best of 64", "last mean" if is_mean else "best sample"
        kept = "samples are normalised" if penalty is None else f"penalty, {penalty:g} m"
        return str(sigma), first, kept, returned, str(generations), found

    cases = [(sigma, is_random) for sigma in (0.1, 0.3, 0.5, 1.0) for is_random in (False, True)]
    cases += [(0.5, True, None, True), (1.0, True, None, True), (0.5, True, None, False, 1)]
    cases += [(0.5, True, penalty) for penalty in (0.1, 1.0, 3.0, 10.0)]
    table(("sigma", "first direction", "norm of w", "result", "generations", "success"), (row(*case) for case in cases))


def cmaes_box(runs: Runs) -> None:
    """CMA-ES without |w| = 1: samples of any length, in a box or penalised; re-anchoring after the last step only."""

    def minimise(sigma, first, limit, penalty, is_unit, problem, seen, key, settings):
        population, dimension = settings.population, problem.curvature.shape[0]
        strategy = cma_es.strategy_parameters(population, dimension)
        unit = lambda w: w / jnp.linalg.norm(w)  # noqa: E731

        def kept(samples):
            if limit == "ball":
                return samples / jnp.maximum(1, jnp.linalg.norm(samples, axis=1, keepdims=True))
            return jnp.clip(samples, -1, 1) if limit == "box" else samples

        def merit(w):
            return problem.measure(w) - penalty * (w @ w - 1) ** 2

        def body(generation, state):
            distribution, best, value = state
            samples = kept(cma_es.ask(distribution, jax.random.fold_in(key, generation), population))
            merits = jax.vmap(merit)(samples)
            top = jnp.argmax(merits)
            best = jnp.where(merits[top] > value, samples[top], best)
            return cma_es.tell(distribution, samples, -merits, strategy), best, jnp.maximum(merits[top], value)

        start_key = jax.random.fold_in(key, settings.generations)
        mean = jnp.zeros(dimension) if first == "zero" else jax.random.uniform(start_key, (dimension,), minval=-1)
        state = cma_es.start(mean, sigma), mean, jnp.full((), -jnp.inf)
        _, best, value = jax.lax.fori_loop(0, settings.generations, body, state)
        return sphere.Best(unit(best) if is_unit else best, value)

    def row(sigma, first, limit, penalty=0.0, is_unit=False, anchors="each step"):
        own = partial(minimise, sigma, first, limit, penalty, is_unit)
        stage = (AnchoredAtTheEnd if anchors == "last step" else NullSpace)(own, ("population", "generations"))
        with registered(StepQPs("own", "own", "own", stages=(stage,))) as name:
            found = runs.success(name)
        return str(sigma), first, limit, f"{penalty:g}", "w / |w|" if is_unit else "w", anchors, found

    cases = [(sigma, "in the box", "none") for sigma in (0.3, 0.6, 1.0)] + [(0.5, "zero", "none")]
    cases += [(0.6, "in the box", "box"), (0.6, "in the box", "ball"), (0.3, "zero", "box")]
    cases += [(0.6, "in the box", "none", 0.0, True), (0.6, "in the box", "box", 0.0, True)]
    cases += [(0.6, "in the box", "none", penalty) for penalty in (0.1, 0.3, 1.0, 3.0)]
    cases += [(0.6, "in the box", limit, 0.0, unit, "last step") for limit, unit in (("none", True), ("box", False))]
    head = ("sigma", "first mean", "limits", "penalty on w'w - 1 [m]", "moves by", "re-anchors after", "success")
    table(head, (row(*case) for case in cases))


def late_anchor(runs: Runs) -> None:
    """Re-anchoring after the last null-space step only, with the three minimisers of the paper."""

    def row(name):
        each_step = runs.success(name)
        stages = [AnchoredAtTheEnd(stage.minimise, stage.settings) for stage in planning_methods.find(name).stages]
        with registered(StepQPs("own", "own", "own", stages=tuple(stages))) as own:
            last_step = runs.success(own)
        paper = " / ".join(f"{PAPER[sweep][0][SIX.index(name)]:.2f}" for sweep in SWEEPS)
        return name, each_step, last_step, paper

    table(("method", "after each step", "after the last step", "paper"), map(row, OPTIMISERS))


def starts(runs: Runs) -> None:
    """Joints that vary, and the start's configuration."""
    joints = tuple((f"start_rad.{joint}:", f"start_rad.{joint - 1}:") for joint in (3, 4, 5))
    configuration = (("0.5, -2.0]", "0.5, 0.0]"),)
    cases = [("joints 3, 4, 5", ()), ("joints 2, 3, 4", joints), ("joint 6 at 0", configuration)]
    cases.append(("joints 2, 3, 4, joint 6 at 0", joints + configuration))
    rows = ((name, *(runs.success(m, sweeps=("robot",), edit=edit) for m in SIX)) for name, edit in cases)
    table(("starts", *SIX), rows)
    rows = ((name, *(runs.success(m, sweeps=("workpiece",), edit=e) for m in SIX)) for name, e in cases[::2])
    table(("poses, start", *SIX), rows)


def sample_step(runs: Runs) -> None:
    """N-Space sample: the length of its steps."""
    lengths = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1)
    found = (runs.success("nspace-sample", f"settings.sample_step_rad={length}") for length in lengths)
    table(("step [rad]", "nspace-sample"), ((str(length), each) for length, each in zip(lengths, found, strict=True)))


def null_space(runs: Runs) -> None:
    """Settings of the null-space loop, for its three minimisers and Adam."""
    cases = ["max_null_space_steps=20", "max_null_space_steps=10", "max_null_space_steps=5", "max_null_space_steps=2"]
    cases += [
        "path_check=recoveries",
        "include_proximal_bodies=false",
        "alpha_rad=0.02",
        "alpha_rad=0.05",
        "alpha_rad=0.2",
    ]
    methods = (*OPTIMISERS, "nspace-adam")
    rows = ((case, *(runs.success(m, f"settings.{case}", sweeps=("workpiece",)) for m in methods)) for case in cases)
    table(("poses", *methods), rows)


# The step QP's Jacobian in the authors' public code


@contextmanager
def jacobian_point(height_m: float) -> Iterator[None]:
    """Use the Jacobian of a point at this height above the TCP in the step QPs."""
    own = step_functions.linearisation.linearise

    def linearise(robot, obstacles, where, x, task, smallest=False):
        found = own(robot, obstacles, where, x, task, smallest)
        point = tcp_position(robot, x) + jnp.array([0.0, 0.0, height_m])
        wrong = point_jacobians(robot, x, point[None], (len(robot.slides) - 1,))[0]
        return found._replace(task=found.task._replace(jacobian=wrong))

    EXECUTABLES.clear()
    with mock.patch.object(step_functions.linearisation, "linearise", linearise):
        yield
    EXECUTABLES.clear()


def best_null_space_steps(
    minimise, index, settings, scene, lane, x_previous, x_ref, null_space_steps, most
) -> NullSpaceState:
    """Return the clearest valid configuration of a null-space loop that takes six steps at least, or the last one."""
    stuck = stuck_at(lane, x_previous, index)

    def valid(now):
        return scene.task.is_satisfied(now.clearance, now.residual, lane.margin_m)

    def going(state):
        _, best, count = state
        return (count < settings.max_null_space_steps) & ((count < 6) | ~valid(best))

    def step(state):
        x, best, count = state
        new = null_space_step(minimise, scene, settings, lane, stuck, x, count)
        now = measured(settings, scene, lane, new.x)
        better = ~valid(best) | (valid(now) & (now.clearance > best.clearance))
        return new.x, jax.tree.map(lambda n, b: jnp.where(better, n, b), now, best), count + 1

    first = measured(settings, scene, lane, x_ref)
    _, best, _ = jax.lax.while_loop(going, step, (x_ref, first, jnp.zeros((), jnp.int32)))
    return NullSpaceState(best, jnp.full((), settings.max_null_space_steps, jnp.int32))


def null_space_steps_anchored_at_the_end(
    minimise, index, settings, scene, lane, x_previous, x_ref, null_space_steps, most
) -> NullSpaceState:
    """Move along J2's directions until D exceeds the margin, without re-anchoring between the steps; then re-anchor."""
    stuck = stuck_at(lane, x_previous, index)

    def going(state):
        x, count = state
        clear = minimum_clearance(scene.robot, scene.obstacles, lane, x) > lane.margin_m
        return (count < settings.max_null_space_steps) & ~(clear & (count > 0))

    def step(state):
        x, count = state
        problem, held, basis = sphere_problem(scene, settings, lane, x, stuck.target)
        best = minimise(problem, held, jax.random.fold_in(stuck.key, count), settings)
        return jnp.clip(x + basis @ best.w, scene.robot.lower, scene.robot.upper), count + 1

    x, _ = jax.lax.while_loop(going, step, (x_ref, jnp.zeros((), jnp.int32)))
    x = anchor(scene, settings, lane, x, lane.target).x
    return NullSpaceState(measured(settings, scene, lane, x), jnp.full((), settings.max_null_space_steps, jnp.int32))


@dataclass(frozen=True)
class AnchoredAtTheEnd(NullSpace):
    """Null-space stage by `null_space_steps_anchored_at_the_end`."""

    def lane_function(self, index: int) -> LaneFunction:
        """Return the complete loop, as stage `index` of a method."""
        reads = *READS, *READS_OF_MEASURED, "max_null_space_steps", *self.settings
        own = null_space_steps_anchored_at_the_end
        return LaneFunction(f"at the end {index}", own, DEEP_LOOP, reads, (self.minimise, index))


@dataclass(frozen=True)
class BestOfLoop(NullSpace):
    """Null-space stage by `best_null_space_steps`."""

    def lane_function(self, index: int) -> LaneFunction:
        """Return the complete loop, as stage `index` of a method."""
        reads = *READS, *READS_OF_MEASURED, "max_null_space_steps"
        return LaneFunction(f"best {index}", best_null_space_steps, DEEP_LOOP, reads, (self.minimise, index))


def jacobian(runs: Runs) -> None:
    """Success [%], TCP distance and safe distance [mm], with the step QPs' Jacobian of the TCP and of a point above it;
    and with the null-space loop of the authors' C++ port."""
    cases = [(h, q, about, False) for h in (0.0, BASE_M) for q in (EQUAL, PORT) for about in ("previous", "reference")]
    cases += [(BASE_M, q, about, True) for q in (EQUAL, PORT) for about in ("previous", "reference")]

    def row(sweep, height, q, about, of_port):
        overrides = q, f"settings.cost_about={about}"
        with jacobian_point(height), port_loop() as method:
            if of_port:
                overrides = *overrides, "settings.max_null_space_steps=10", "settings.path_check=recoveries"
            methods = ("", "", "", method, "", "") if of_port else SIX
            found = [four(runs.plans(sweep, m, *overrides)) if m else "" for m in methods]
        return f"{height:g}", "equal" if q == EQUAL else "port", about, "port" if of_port else "paper", *found

    for sweep in SWEEPS:
        paper = (f"{s:.1f}, {tcp:.2f}, {safe:.2f}" for s, tcp, safe in zip(*PAPER[sweep], strict=True))
        head = (f"{sweep}: point above [m]", "Q", "cost about", "null-space loop", *SIX)
        table(head, chain([("paper", "", "", "", *paper)], (row(sweep, *case) for case in cases)))


def four(plans: Plans) -> str:
    """Format success [%], mean TCP distance and mean over scenarios of the minimum clearance [mm]."""
    clearance = np.where(plans.tracked, 1e3 * plans.clearance, np.nan)
    residual = 1e3 * plans.residual[plans.tracked].mean()
    return f"{100 * plans.tracked.mean():.1f}, {residual:.2f}, {np.nanmean(np.nanmin(clearance, axis=1)):.2f}"


def columns(runs: Runs) -> None:
    """Definitions of the safe distance and of the TCP distance [mm]."""
    iterates: list = []
    own = LaneChecks.advanced

    def advanced(checks, lanes, y):
        now = own(checks, lanes, y)
        iterates.append((lanes.candidate < 0, now.clearance, now.residual))
        return now

    for sweep in SWEEPS:
        found: dict[str, list[str]] = {}
        for method in SIX:
            iterates.clear()
            with mock.patch.object(LaneChecks, "advanced", advanced):
                plans = runs.plans(sweep, method)
            main, clearance, residual = map(np.concatenate, zip(*iterates, strict=True))
            for name, value in definitions(plans, 1e3 * clearance[main], 1e3 * residual[main]).items():
                found.setdefault(name, []).append(f"{value:.4g}")
        paper = [(name, *map(str, PAPER[sweep][k])) for name, k in (("D, paper", 2), ("TCP, paper", 1))]
        table((sweep, *SIX), (*paper, *((name, *row) for name, row in found.items())))


def definitions(plans: Plans, clearances: np.ndarray, residuals: np.ndarray) -> dict[str, float]:
    """Return candidates for both columns [mm]; clearances, residuals: of all iterates of step QPs."""
    tracked, rows = plans.tracked, np.arange(len(plans.tracked))
    last = np.maximum(tracked.sum(axis=1) - 1, 0)
    D = np.where(tracked, 1e3 * plans.clearance, np.nan)
    off = np.where(tracked, 1e3 * plans.residual, np.nan)
    recovered = plans.recovery > 0
    return {
        "D, mean over tracked targets": np.nanmean(D),
        "D, median over tracked targets": np.nanmedian(D),
        "D, mean over targets on the weld": np.nanmean(D[:, 11:]),
        "D, mean over scenarios of the mean": np.nanmean(np.nanmean(D, axis=1)),
        "D, mean over scenarios of the minimum": np.nanmean(np.nanmin(D, axis=1)),
        "D, mean over scenarios at the last tracked target": np.nanmean(D[rows, last]),
        "D, minimum": np.nanmin(D),
        "D, largest of the scenarios' minima": np.nanmax(np.nanmin(D, axis=1)),
        "D, mean over QP iterates": clearances.mean(),
        "D, mean over targets tracked after a recovery": D[recovered].mean() if recovered.any() else np.nan,
        "TCP, mean over tracked targets": np.nanmean(off),
        "TCP, median over tracked targets": np.nanmedian(off),
        "TCP, mean over scenarios of the maximum": np.nanmean(np.nanmax(off, axis=1)),
        "TCP, mean at the last tracked target": np.nanmean(off[rows, last]),
        "TCP, mean over targets tracked after a recovery": off[recovered].mean() if recovered.any() else np.nan,
        "TCP, mean over QP iterates below 1 mm": residuals[residuals < 1].mean(),
    }


def damped(runs: Runs) -> None:
    """Damped step QPs: TCP distance with linear convergence."""
    own = LaneChecks.advanced

    def row(share):
        with mock.patch.object(LaneChecks, "advanced", lambda checks, lanes, y: own(checks, lanes, share * y)):
            return str(share), *(four(runs.plans(sweep, "nspace-sqp")) for sweep in SWEEPS)

    table(("share of the step", "poses", "starts"), map(row, (1.0, 0.95, 0.9, 0.8, 0.5)))


# Methods of this benchmark


@contextmanager
def registered(method) -> Iterator[str]:
    """Register a method, and yield its name."""
    with mock.patch.dict(registry.METHODS._own):
        yield registry.METHODS.register(method).name


def own_null_space(minimise: Callable, settings: tuple[str, ...] = ()):
    """Register a null-space method with this minimiser."""
    return registered(StepQPs("own", "own", "own", stages=(NullSpace(minimise, settings),)))


def port_loop():
    """Register the null-space loop of the authors' C++ port, with our SQP."""
    stage = BestOfLoop(lambda problem, seen, key, settings: sphere.sqp(problem, seen))
    return registered(StepQPs("port-loop", "port", "port", stages=(stage,)))


@partial(jax.jit, static_argnames="settings")
def J2(scene, settings, lane, x_ref, w):
    """Return J2 of equation (11) at x_ref for several w [m]."""
    return -jax.lax.map(sphere_problem(scene, settings, lane, x_ref, lane.target)[0].measure, w)


@partial(jax.jit, static_argnames="settings")
def best_of_64(scene, settings, lane, x_ref):
    """Return the planners' first direction."""
    problem, seen, _ = sphere_problem(scene, settings, lane, x_ref, lane.target)
    return sphere.first_direction(problem, seen)


@partial(jax.jit, static_argnames="settings")
def moved(scene, settings, lane, x_ref, w):
    """Return the configuration after a null-space step w, re-anchored and measured."""
    _, _, basis = sphere_problem(scene, settings, lane, x_ref, lane.target)
    x = jnp.clip(x_ref + basis @ w, scene.robot.lower, scene.robot.upper)
    return measured(settings, scene, lane, anchor(scene, settings, lane, x, lane.target).x)


class HostExecutor(Executor):
    """Compiled functions, with null-space steps minimised on the host."""

    def __init__(self, direction: Callable, *of):
        super().__init__(*of)
        self._direction = direction

    def __call__(self, lane_function, *tables):
        if lane_function.function is not take_null_space_steps:
            return super().__call__(lane_function, *tables)
        found = [self._move_in_null_space(*jax.tree.map(lambda t, i=i: t[i], tables)) for i in range(len(tables[-1]))]
        return jax.tree.map(lambda *leaves: np.stack(leaves), *found)

    def _move_in_null_space(self, lane, x_previous, x, null_space_steps, most) -> NullSpaceState:
        scene = own_scene(self._scene, lane.tool_extension_m)
        while True:
            problem = scene, self._settings, lane, x
            null_space_steps = null_space_steps + 1
            now = jax.tree.map(np.asarray, moved(*problem, self._direction(problem, int(null_space_steps))))
            x = now.x
            if null_space_steps >= most or self.task.is_satisfied(now.clearance, now.residual, lane.margin_m):
                return NullSpaceState(now, np.int32(null_space_steps))


@dataclass(frozen=True)
class OnHost(registry.Method):
    """Method whose null-space steps are minimised by a function on the host."""

    name: str
    direction: Callable

    title = description = "null-space steps on the host"

    def plan(self, problem: Problem) -> Plans:
        """Plan with `HostExecutor`."""
        scene = Scene(problem.robot, problem.obstacles, problem.task)
        executor = HostExecutor(self.direction, scene, problem.settings, problem.devices[0])
        checkers = (CollisionChecker(executor, problem.settings),)
        own = replace(problem, execution=replace(problem.execution, threads=1), checkers=checkers)
        return StepQPs(self.name, self.title, self.description, stages=(NullSpace(lambda *_: None),)).plan(own)


def emulated(solver: str, first: str, iterations: int, counts: list, problem: tuple, step: int) -> np.ndarray:
    """Return what scipy's solver finds for (11): forward differences, |w| = 1 as a constraint, fmincon's tolerances."""
    lane, h = problem[2], 1.5e-8
    rng = np.random.default_rng((int(lane.number), int(lane.row), step))
    draw = rng.standard_normal(3)
    w = {"random": draw / np.linalg.norm(draw), "first axis": np.eye(3)[0], "zero": np.zeros(3)}.get(first)
    w = np.asarray(best_of_64(*problem)) if w is None else w

    def value_and_gradient(w):
        values = np.asarray(J2(*problem, np.vstack([w, w + h * np.eye(3)])))
        return values[0], (values[1:] - values[0]) / h

    def norm(w):
        return np.linalg.norm(w) - 1

    def slope(w):  # at 0 what forward differences give
        return w / np.linalg.norm(w) if w.any() else np.ones(3)

    if solver == "SLSQP":
        how = {"constraints": {"type": "eq", "fun": norm, "jac": slope}}
        how["options"] = {"ftol": 1e-6, "maxiter": iterations}
    else:
        how = {"constraints": NonlinearConstraint(norm, 0, 0, jac=lambda w: slope(w)[None])}
        how["options"] = {"gtol": 1e-6, "xtol": 1e-10, "maxiter": iterations}
    found = minimize(value_and_gradient, w, jac=True, method=solver, **how)
    counts.append(found.nfev)
    return found.x if np.isfinite(found.x).all() else w


def fmincon(runs: Runs) -> None:
    """scipy's SLSQP and trust-constr in place of SQP and interior point."""

    def row(solver, first, iterations):
        counts: list[int] = []
        with registered(OnHost("on-host", partial(emulated, solver, first, iterations, counts))) as method:
            found = runs.success(method, sweeps=("workpiece",))
        return solver, first, str(iterations), found, f"{len(counts):,}", f"{np.mean(counts):.0f}"

    firsts = "zero", "random", "first axis", "best of 64"
    cases = [("SLSQP", first, 400) for first in firsts] + [("trust-constr", first, 100) for first in firsts]
    head = ("solver", "first direction", "iterations at most", "success", "minimisations", "evaluations each")
    table(head, (row(*case) for case in cases))


EXPERIMENTS = {
    "readings": readings,
    "cmaes": cmaes,
    "cmaes-box": cmaes_box,
    "late-anchor": late_anchor,
    "starts": starts,
    "sample-step": sample_step,
    "columns": columns,
    "damped": damped,
    "jacobian": jacobian,
    "null-space": null_space,
    "fmincon": fmincon,
}


def main() -> None:
    """Run the experiments that were named, or all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(EXPERIMENTS), help=f"of {', '.join(EXPERIMENTS)}")
    parser.add_argument("--cloud", choices=OVERRIDES, default="measured")
    chosen = parser.parse_args()
    cache_folder.enable()
    for name in chosen.only.split(","):
        print(f"\n## {name}: {EXPERIMENTS[name].__doc__} Cloud: {chosen.cloud}.")
        EXPERIMENTS[name](Runs(chosen.cloud))


if __name__ == "__main__":
    main()
