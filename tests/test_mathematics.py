"""Public mathematical functions: available by name, differentiable everywhere, equal to those of the planners."""

import doctest
import importlib
import subprocess
import sys
from functools import cache, partial
from pathlib import Path

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest
from sphere_references import place

import htcp_jax
from htcp_jax.clearance import contacts, rows_of
from htcp_jax.clearance.obstacles.obstacle import slopes
from htcp_jax.clearance.obstacles.obstacles import clearance_rows
from htcp_jax.errors import InputError
from htcp_jax.planning.tracking.null_space import sphere_problem
from htcp_jax.settings import Settings

capsule_point_distance = htcp_jax.capsule_point_distance


# The distance of a capsule and a point


distances = made_once.quick_jit(capsule_point_distance)
gradients = jax.grad(capsule_point_distance, argnums=(0, 1, 2, 3))


def capsules(count: int):
    """Random capsules, some with an axis of length 0, and points, some of them inside."""
    rng = np.random.default_rng(0)
    p, q, point = rng.uniform(-1, 1, (3, count, 3))
    q[::5] = p[::5]
    return p, q, rng.uniform(0.05, 0.6, count), point


def test_a_capsule_s_distance_is_the_smallest_over_spheres_along_its_axis_and_negative_inside():
    p, q, radius, point = capsules(200)
    found = np.asarray(distances(p, q, radius, point))
    s = np.linspace(0, 1, 20_001)
    for k in range(200):
        dense = np.linalg.norm(p[k] + s[:, None] * (q[k] - p[k]) - point[k], axis=1).min() - radius[k]
        assert dense - 1e-7 < found[k] < dense + 1e-15
    assert (found < 0).sum() > 10 and (found > 0).sum() > 100


def test_its_gradient_is_that_of_differences_and_turns_with_what_it_belongs_to():
    p, q, radius, point = capsules(200)
    dp, dq, dr, dpoint = made_once.in_rows(gradients, 200)((), p, q, radius, point)
    np.testing.assert_allclose(dr, -1.0)
    np.testing.assert_allclose(np.linalg.norm(dpoint, axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(dp + dq + dpoint, 0.0, atol=1e-14)  # invariant under translation
    for axis in np.eye(3) * 1e-6:
        moved = [np.asarray(distances(p, q, radius, point + sign * axis[None])) for sign in (1.0, -1.0)]
        np.testing.assert_allclose(2 * dpoint @ axis, moved[0] - moved[1], atol=1e-14)


@pytest.mark.parametrize("q", [(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
def test_on_the_axis_and_at_a_sphere_s_centre_the_gradient_is_zero_and_not_NaN(q):
    row = [np.array([value]) for value in (np.zeros(3), q, 0.2, 0.5 * np.array(q))]
    assert np.resize(distances(*(np.resize(leaf, (200, *leaf.shape[1:])) for leaf in row)), 1) == -0.2
    dp, dq, _, dpoint = made_once.in_rows(gradients, 200)((), *row)
    for gradient in (dp, dq, dpoint):
        np.testing.assert_array_equal(gradient, 0.0)


# The null-space objective

WEIGHED = Settings(j1_weight=1.0, alpha_rad=0.05)
FAR_UNSEEN = Settings(j1_weight=1.0, alpha_rad=0.05, include_proximal_bodies=False)


def objective(settings):
    scene = made_once.scene()[:2]
    return lambda where, x_ref, w: htcp_jax.null_space_objective(*scene, where, x_ref, w, settings)


@cache
def both(settings):
    """Compiled J2 with its gradient by the public function, and the planners' objective and predicted gradient."""

    scene = made_once.scene()

    def planners(where, x_ref, w):
        problem, _, _ = sphere_problem(scene, settings, where, x_ref)
        value, gradient = problem.predict_with_gradient(w, problem.observe(w)[1])
        return problem.measure(w), gradient[jnp.argmin(value)]

    ours = jax.value_and_grad(objective(settings), argnums=2)
    return made_once.quick_jit(ours), made_once.quick_jit(planners)


def cases(count):
    rng = np.random.default_rng(1)
    for k in range(0, 200, 200 // count):
        w = rng.normal(size=3)
        yield *place(k), w / np.linalg.norm(w)


@pytest.mark.parametrize("settings", [WEIGHED, FAR_UNSEEN], ids=["all links", "outer links"])
def test_the_null_space_objective_is_what_the_planners_minimise_and_so_is_its_gradient(settings):
    ours, planners = both(settings)
    for case in cases(20):
        (value, gradient), (negative, predicted) = ours(*case), planners(*case)
        np.testing.assert_allclose(value, -negative, atol=1e-14)
        np.testing.assert_allclose(gradient, -predicted, atol=1e-12)


def test_its_gradient_costs_no_more_operations_than_the_closed_form_and_fewer_than_autodiff_through_the_arm():
    """Compare the compiler's operation counts at one configuration; only the derivative differs."""
    scene, x = (*made_once.scene()[:2], made_once.nominal()), jnp.asarray(made_once.START)

    def operations(function):
        return made_once.quick_jit(function).lower(x).compile().cost_analysis()["flops"]

    ours = operations(jax.value_and_grad(partial(htcp_jax.minimum_clearance, *scene)))
    rows = operations(partial(clearance_rows, *scene))
    assert ours <= rows  # only D, as in J2, compared with the rows that every step QP linearises
    closed = operations(lambda x: closed_form(*scene, x))
    through = operations(jax.jacfwd(lambda x: contacts(*scene, x).distance))
    assert rows - closed <= 0.07 * (through - closed) and through > 1.05 * closed


def closed_form(robot, obstacles, where, x):
    """Distances and their gradients n' (J_body - J_other), without autodiff."""
    touch = contacts(robot, obstacles, where, x)
    return touch.distance, slopes(robot, x, rows_of(robot, obstacles), touch.normal, touch.point, touch.witness)


def test_its_gradient_is_that_of_differences():
    J2, _ = both(WEIGHED)
    h, off = 1e-6, []
    for where, x_ref, w in cases(20):
        gradient = np.asarray(J2(where, x_ref, w)[1])
        sides = [[float(J2(where, x_ref, w + sign * h * axis)[0]) for sign in (1, -1)] for axis in np.eye(3)]
        off.append(np.abs(np.subtract(*np.transpose(sides)) / (2 * h) - gradient).max())
    assert np.sort(off)[-2] < 1e-8  # one of them may be at a kink of D


def test_many_directions_at_once_are_each_as_alone():
    where, x_ref, _ = next(cases(1))
    w = np.concatenate([np.eye(3), -np.eye(3)])
    J2 = partial(objective(WEIGHED), where, x_ref)
    together = made_once.quick_jit(jax.vmap(J2))(w)
    np.testing.assert_allclose(together, [both(WEIGHED)[0](where, x_ref, one)[0] for one in w], atol=1e-15)
    assert len(set(together.tolist())) == 6


def test_without_settings_it_is_minus_the_clearance_for_an_arm_of_any_number_of_joints(tmp_path):
    arm, obstacle, where = made_once.seven_joints(tmp_path), made_once.scene().obstacles, made_once.nominal()
    x_ref, w = jnp.asarray(np.full(7, 0.3)), jnp.asarray(np.eye(4)[0])

    def J2_and_clearance(x_ref, w):
        x = x_ref + 0.1 * htcp_jax.null_basis(htcp_jax.jacobian(arm, x_ref)) @ w
        J2 = htcp_jax.null_space_objective(arm, obstacle, where, x_ref, w)
        return J2, htcp_jax.minimum_clearance(arm, obstacle, where, x)

    J2, clearance = made_once.quick_jit(J2_and_clearance)(x_ref, w)
    np.testing.assert_allclose(J2, -clearance, atol=1e-14)
    with pytest.raises(InputError, match="q_weights has 6 values, but the robot seven has 7 joints"):
        htcp_jax.null_space_objective(arm, obstacle, where, x_ref, w, Settings())


# The public interface

LISTS_AND_BATCHES = """
import numpy as np, htcp_jax
arm, start = htcp_jax.gp50(), [0.0, -2.3, 0.5, 0.0, 0.5, -2.0]
cloud = np.random.default_rng(0).normal(size=(50, 3)) + [3, 0, 0]
part = htcp_jax.load_workpiece(cloud, [[2.0, 0.0, 0.5]], interior="none", neutral_translation=(0, 0, 0))
scene = arm, htcp_jax.make_obstacle(part), htcp_jax.make_scenario(arm, part, start, rotation=(0, 0))
x, w = np.array(start), np.array([1.0, 0, 0])
calls = {
    "tcp_position": lambda x: htcp_jax.tcp_position(arm, x),
    "jacobian": lambda x: htcp_jax.jacobian(arm, x),
    "capsule_segments": lambda x: htcp_jax.capsule_segments(arm, x)[0],
    "clearance": lambda x: htcp_jax.minimum_clearance(*scene, x),
    "linearise": lambda x: htcp_jax.linearise(*scene, x).clearance.gradient,
    "reanchor": lambda x: htcp_jax.reanchor(arm, x, [1.1, 0, 1.4], 1e-6)[0],
    "objective": lambda x: htcp_jax.null_space_objective(*scene, x, w.tolist()),
}
for name in ("tcp_position", "clearance"):
    assert np.array_equal(calls[name](start), calls[name](x)), name
for name, call in calls.items():
    for wrong in (x[None], x[:4], [start, start]):
        try:
            call(wrong)
        except htcp_jax.InputError as error:
            assert "(6,); for a batch, use jax.vmap" in str(error) and "\\n" not in str(error), name
        else:
            raise AssertionError(name)
for call in (
    lambda: htcp_jax.null_space_objective(*scene, x, np.eye(3)),
    lambda: htcp_jax.null_basis(np.zeros((2, 3, 6))),
    lambda: htcp_jax.reanchor(arm, x, np.zeros((2, 3)), 1e-6),
):
    try:
        call()
    except htcp_jax.InputError as error:
        assert "jax.vmap" in str(error)
    else:
        raise AssertionError
assert htcp_jax.capsule_point_distance([0, 0, 0], [0, 0, 1], 0.25, [2, 0, 0.5]) == 1.75
"""


def test_lists_are_taken_and_a_batch_is_refused_in_one_line_that_names_vmap():
    """Regression: these raised bare TypeErrors. Runs in a separate process, where annotations are not checked."""
    done = subprocess.run([sys.executable, "-c", LISTS_AND_BATCHES], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_mathematics_is_there_by_name_and_no_package_has_the_name_of_a_function():
    for name in ("tcp_position", "tcp_pose", "jacobian", "capsule_segments", "minimum_clearance", "linearise"):
        assert callable(getattr(htcp_jax, name)) and name in htcp_jax.__all__
    packages = [folder.parent.name for folder in Path(htcp_jax.__file__).parent.glob("*/__init__.py")]
    assert "clearance" in packages and not {*packages} & {*htcp_jax.__all__}


@pytest.mark.parametrize("module", ["numerics", "planning.tracking.null_space"])
def test_examples_in_docstrings_hold(module):
    found = doctest.testmod(importlib.import_module(f"htcp_jax.{module}"))
    assert found.attempted and not found.failed


def test_the_objective_takes_settings_as_a_mapping():
    arm, duct = made_once.robot(), made_once.duct()
    where = htcp_jax.make_scenario(arm, duct, made_once.START)
    scene = arm, htcp_jax.make_obstacle(duct), where, jnp.array(made_once.START), jnp.array([1.0, 0.0, 0.0])
    paper = Settings.paper()
    plain, weighed, same = (float(htcp_jax.null_space_objective(*scene, s)) for s in (None, {"j1_weight": 1.0}, paper))
    assert weighed == same == pytest.approx(plain + paper.alpha_rad**2, abs=1e-12)  # the paper's Q: J1 = |alpha w|^2
