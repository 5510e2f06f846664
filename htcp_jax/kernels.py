"""The engine's device side: pure functions of one lane, and how a batch of lanes runs through them.

A kernel takes what all lanes share and one lane's arguments. `chunked` runs it over a table of fixed capacity, a few
lanes at a time and only as far as the table is filled: one compiled program serves one lane and a thousand, and a
lane's result does not depend on how many others there are.
"""

import threading
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from htcp_jax import qp
from htcp_jax.clearance import Linearisation, linearise
from htcp_jax.escape import (
    Candidates,
    Method,
    Sample,
    Scene,
    Stuck,
    anchor,
    keep_clear_ascent,
    null_space_step,
    own_scene,
    path_clear,
    postures,
    stuck_key,
)
from htcp_jax.nullspace import reanchor
from htcp_jax.numerics import safe_norm
from htcp_jax.scenario import Scenario
from htcp_jax.settings import Settings

POSTURE_STAGE = 99  # random keys of retries lie apart from those of the stages


class Shared(NamedTuple):
    """What every lane reads: the scene, and all scenarios stacked."""

    scene: Scene
    scenarios: Scenario


class Place(NamedTuple):
    """Which target of which scenario, and in which attempt at it."""

    scenario: jax.Array
    target: jax.Array
    attempt: jax.Array


class Measured(NamedTuple):
    """A configuration, its linearisation, and how it stands to the target."""

    x: jax.Array
    linear: Linearisation
    clearance: jax.Array
    residual: jax.Array


def _own(shared: Shared, place: Place) -> tuple[Scene, Scenario, jax.Array]:
    scenario = jax.tree.map(lambda leaf: leaf[place.scenario], shared.scenarios)
    return own_scene(shared.scene, scenario), scenario, scenario.targets[place.target]


def _stuck(settings: Settings, scenario, place: Place, x_previous, target, stage: int) -> Stuck:
    return Stuck(x_previous, target, stuck_key(settings, scenario, place.target, stage, place.attempt))


def prepare(settings: Settings, shared: Shared, place: Place, x_ref, x_previous, linear: Linearisation) -> qp.StepQP:
    """The step QP of one lane, equation (8)."""
    scene, scenario, target = _own(shared, place)
    robot = scene.robot
    return qp.assemble(
        settings,
        x_ref,
        x_previous,
        target - linear.tcp,
        linear.jacobian,
        linear.clearance,
        linear.gradient,
        scenario.margin_m,
        robot.lower,
        robot.upper,
    )


def advance(settings: Settings, shared: Shared, place: Place, x_ref, y) -> Measured:
    """The lane after a step y: inside the limits to the last bit, linearised, and measured against its target."""
    scene, scenario, target = _own(shared, place)
    x = jnp.clip(x_ref + y, scene.robot.lower, scene.robot.upper)
    linear = linearise(scene.robot, scene.obstacle, scenario, x)
    return Measured(x, linear, jnp.min(linear.clearance), safe_norm(linear.tcp - target))


def enter_null_space(settings: Settings, shared: Shared, place: Place, x_previous):
    """Algorithm 1, line 9: inverse kinematics of the stuck target from x_{t-1}."""
    scene, scenario, target = _own(shared, place)
    x, _ = reanchor(scene.robot, x_previous, target, 0.1 * settings.tolerance_m)
    return anchor(scene, settings, scenario, x, target)


def walk_null_space(stage, index, settings: Settings, shared: Shared, place: Place, x_previous, x_ref, count):
    """One step of a null-space stage."""
    scene, scenario, target = _own(shared, place)
    stuck = _stuck(settings, scenario, place, x_previous, target, index)
    return null_space_step(stage.minimise, scene, settings, scenario, stuck, x_ref, count)


def propose(stage: Sample, index, settings: Settings, shared: Shared, place: Place, x_previous) -> Candidates:
    """Candidates of a sampling stage."""
    scene, scenario, target = _own(shared, place)
    return stage.propose(scene, settings, scenario, _stuck(settings, scenario, place, x_previous, target, index))


def propose_postures(settings: Settings, shared: Shared, place: Place, x_previous) -> Candidates:
    """Other postures at the scenario's first target."""
    scene, scenario, target = _own(shared, place)
    return postures(scene, settings, scenario, _stuck(settings, scenario, place, x_previous, target, POSTURE_STAGE))


def ascend(settings: Settings, shared: Shared, place: Place, x):
    """Keep-clear ascent at the target just reached."""
    scene, scenario, target = _own(shared, place)
    return keep_clear_ascent(scene, settings, scenario, x, target)


def check_path(settings: Settings, shared: Shared, place: Place, a, b):
    """Whether the straight joint path from a to b is clear."""
    scene, scenario, _ = _own(shared, place)
    return path_clear(scene, settings, scenario, a, b)


def chunked(kernel: Callable, width: int) -> Callable:
    """`kernel(shared, *one lane)` over tables with a leading axis of capacity C: run(shared, chunks, *tables) computes
    the first chunks x width lanes; the rest of the result is zeros."""

    def run(shared, chunks, *tables):
        def one_chunk(start):
            part = jax.tree.map(lambda t: jax.lax.dynamic_slice_in_dim(t, start, width), tables)
            return jax.vmap(partial(kernel, shared))(*part)

        def body(i, results):
            start = i * width
            return jax.tree.map(
                lambda all_, part: jax.lax.dynamic_update_slice_in_dim(all_, part, start, 0), results, one_chunk(start)
            )

        capacity = jax.tree.leaves(tables)[0].shape[0]
        shapes = jax.eval_shape(one_chunk, 0)
        empty = jax.tree.map(lambda s: jnp.zeros((capacity, *s.shape[1:]), s.dtype), shapes)
        return jax.lax.fori_loop(0, chunks, body, empty)

    return jax.jit(run)


class Kernels:
    """The kernels of one method, compiled on first use for one shape; knows the seconds that took.

    Call them through the methods below with tables of n lanes: they are padded to a multiple of the capacity and come
    back as numpy arrays of n lanes.
    """

    def __init__(self, shared: Shared, method: Method, settings: Settings, width: int, capacity: int):
        self._shared, self._width, self._capacity = shared, width, capacity
        self._compiled: dict[str, Callable] = {}
        self._compiling = threading.Lock()
        self.compile_s = 0.0
        self.bodies = len(shared.scene.robot.capsule_link)
        self._kernels = {
            "prepare": partial(prepare, settings),
            "advance": partial(advance, settings),
            "enter": partial(enter_null_space, settings),
            "ascend": partial(ascend, settings),
            "postures": partial(propose_postures, settings),
            "check_path": partial(check_path, settings),
        }
        for index, stage in enumerate(method.stages):
            work = partial(propose, stage) if isinstance(stage, Sample) else partial(walk_null_space, stage)
            self._kernels[f"stage {index}"] = partial(work, index, settings)

    def __call__(self, name: str, *tables):
        """Run kernel `name` over tables of n >= 1 lanes; returns numpy arrays of n lanes."""
        lanes = len(jax.tree.leaves(tables)[0])
        parts = [
            self._run(name, jax.tree.map(lambda t, s=start: t[s : s + self._capacity], tables))
            for start in range(0, lanes, self._capacity)
        ]
        return parts[0] if len(parts) == 1 else jax.tree.map(lambda *p: np.concatenate(p), *parts)

    def _run(self, name: str, tables):
        lanes = len(jax.tree.leaves(tables)[0])
        padded = jax.tree.map(lambda t: _pad(np.asarray(t), self._capacity), tables)
        chunks = np.int32(-(-lanes // self._width))
        result = self._program(name, chunks, padded)(self._shared, chunks, *padded)
        return jax.tree.map(lambda r: np.asarray(r)[:lanes], result)

    def _program(self, name: str, chunks, tables) -> Callable:
        with self._compiling:
            if name not in self._compiled:
                began = time.perf_counter()
                program = chunked(self._kernels[name], self._width)
                self._compiled[name] = program.lower(self._shared, chunks, *tables).compile()
                self.compile_s += time.perf_counter() - began
            return self._compiled[name]


def _pad(table: np.ndarray, capacity: int) -> np.ndarray:
    """The table with its first row repeated up to the capacity: real numbers, so that padding never goes astray."""
    return np.concatenate([table, np.repeat(table[:1], capacity - len(table), axis=0)])
