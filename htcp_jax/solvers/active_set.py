"""The step QP solved on the device: a dual active-set method in the null space of the task, exact to rounding.

The equalities leave N - M unknowns. In coordinates u in which the cost is 1/2 |u - u0|^2, the solution is the point of
a polyhedron closest to u0, with at most N - M active rows. The method of Goldfarb and Idnani (1983) starts at u0 and
adds the most violated row in each iteration. An active row is dropped when its multiplier would become negative. The
cost increases in every iteration, so the method ends. If a violated row is a combination of active rows and all
multipliers have the wrong sign, these multipliers are Farkas' certificate that no point satisfies all rows.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.numerics import null_basis, product, safe_norm
from htcp_jax.solvers.step_qp import QPSolution, QPStatus, StepQP
from htcp_jax.types import Array, Bool, Float, Int, Scalar

ITERATIONS = 60  # maximum number of rows added or dropped; usually 4, rarely 20
PARALLEL = 1e-9  # a unit row this close to the span of the active rows is treated as lying in the span


class _Active(NamedTuple):
    """State of the active-set method: the current point, its active rows, and the entering row."""

    u: Float[Array, "D"]  # current point
    row: Int[Array, "D"]  # active rows, -1: free slot
    multiplier: Float[Array, "D"]  # multipliers of the active rows
    entering: Int[Array, ""]  # entering row, -1: none
    entering_multiplier: Scalar
    infeasible: Bool[Array, ""]  # True: no point satisfies all rows
    done: Bool[Array, ""]
    count: Int[Array, ""]  # number of iterations


def solve_step(qp: StepQP, tolerance: float = 1e-8, optional: int = 0) -> QPSolution:
    """Solve one step QP, equation (9).

    Infinite joint limits do not add rows.

    Args:
        qp: The QP.
        tolerance: Allowed violation of a row, in the row's unit.
        optional: Number of equations that may be 0 = 0, see `Task.optional`.

    Returns:
        The step and its status; FAILED if numbers are not finite or the method does not end.
    """
    n = qp.q.shape[0]
    if qp.A.shape[0] == n and not optional:
        return _only_step(qp, tolerance)
    basis = null_basis(qp.A, optional)
    y_task = _on_task(qp)
    H = product(basis.T, qp.P[:, None] * basis)
    if optional:  # columns that are not in the basis are 0
        H = H + jnp.diag(jnp.where(jnp.any(basis != 0, axis=0), 0.0, 1.0))
    inverse = _inverse_factor(H)  # z = inverse.T u
    to_y = product(basis, inverse.T)
    u0 = -product(inverse, product(basis.T, qp.P * y_task + qp.q))

    rows = jnp.concatenate([qp.G, jnp.eye(n), -jnp.eye(n)])
    bound = jnp.concatenate([qp.h, qp.ub, -qp.lb])
    has_bound = ~jnp.isposinf(bound)
    bound = jnp.where(has_bound, bound, 0.0) - product(rows, y_task)
    rows = product(rows, to_y)
    length = jnp.where(has_bound, safe_norm(rows), 0.0)
    flat = length < 1e-12  # the row does not depend on u: it is satisfied everywhere or nowhere
    normal = rows / jnp.where(flat, 1.0, length)[:, None]
    offset = jnp.where(flat, jnp.inf, bound / jnp.where(flat, 1.0, length))
    hopeless = jnp.any((flat & has_bound & (bound < -tolerance)) | jnp.isneginf(bound))

    end = _closest_point(normal, offset, tolerance / jnp.where(flat, 1.0, length), u0)
    y = y_task + product(to_y, end.u)
    usable = jnp.all(jnp.isfinite(y)) & ~jnp.any(jnp.isnan(bound)) & end.done
    infeasible = hopeless | end.infeasible
    status = jnp.where(usable, jnp.where(infeasible, QPStatus.INFEASIBLE, QPStatus.SOLVED), QPStatus.FAILED)
    return QPSolution(jnp.where(status == QPStatus.SOLVED, y, 0.0), status.astype(jnp.int32))


def _only_step(qp: StepQP, tolerance: float) -> QPSolution:
    """Return the solution for a task with as many rows as joints: the only step that satisfies it."""
    y = _on_task(qp)
    over = jnp.concatenate([product(qp.G, y) - qp.h, y - qp.ub, qp.lb - y])
    status = jnp.where(jnp.any(over > tolerance), QPStatus.INFEASIBLE, QPStatus.SOLVED)
    status = jnp.where(jnp.any(jnp.isnan(over)) | ~jnp.all(jnp.isfinite(y)), QPStatus.FAILED, status)
    return QPSolution(jnp.where(status == QPStatus.SOLVED, y, 0.0), status.astype(jnp.int32))


def _closest_point(normal, offset, tolerance, u0) -> _Active:
    """Return the point of {u : normal @ u <= offset} closest to u0; `normal` has unit rows."""
    dimension = u0.shape[0]

    def step(state: _Active) -> _Active:
        height = product(normal, state.u) - offset
        worst = jnp.argmax(jnp.where(height > tolerance, height, -jnp.inf)).astype(jnp.int32)
        entering = jnp.where(state.entering < 0, worst, state.entering)
        new = normal[entering]
        across, along = _split_normal(normal, state.row, new)

        # Step lengths at which an active multiplier becomes 0, and at which the entering row is satisfied.
        uses = (state.row >= 0) & (along > 1e-14)
        left = jnp.where(uses, state.multiplier / jnp.where(uses, along, 1.0), jnp.inf)
        leaving = jnp.argmin(left)
        square = product(across, across)
        free = square > PARALLEL**2
        to_meet = jnp.where(free, jnp.maximum(height[entering], 0.0) / jnp.where(free, square, 1.0), jnp.inf)
        length = jnp.minimum(left[leaving], to_meet)
        lost = jnp.isinf(length)
        length = jnp.where(lost, 0.0, length)
        met = to_meet <= left[leaving]

        multiplier = jnp.maximum(state.multiplier - length * along, 0.0)
        entering_multiplier = state.entering_multiplier + length
        place = jnp.where(met, jnp.argmin(state.row), leaving)  # a free slot has -1, the smallest
        here = jnp.arange(dimension) == place
        after = _Active(
            state.u - jnp.where(free, length, 0.0) * across,
            jnp.where(here, jnp.where(met, entering, -1), state.row),
            jnp.where(here, jnp.where(met, entering_multiplier, 0.0), multiplier),
            jnp.where(met, -1, entering),
            jnp.where(met, 0.0, entering_multiplier),
            lost,
            lost,
            state.count + 1,
        )
        satisfied = (state.entering < 0) & ~jnp.any(height > tolerance)
        return jax.tree.map(lambda end, more: jnp.where(satisfied, end, more), state._replace(done=True), after)

    start = _Active(
        u0, jnp.full(dimension, -1, jnp.int32), jnp.zeros(dimension), jnp.full((), -1, jnp.int32), jnp.zeros(()),
        jnp.full((), False), jnp.full((), False), jnp.zeros((), jnp.int32),
    )  # fmt: skip
    return jax.lax.while_loop(lambda state: ~state.done & (state.count < ITERATIONS), step, start)


def _split_normal(normal, rows, new):
    """Return `across` and `along` of a unit vector, with new = across + sum_k along_k normal[rows_k].

    `across` is the component orthogonal to the active rows, `along` has the coordinates in these rows. They are
    computed by Gram-Schmidt, applied twice, and back substitution.
    """
    dimension = new.shape[0]
    unit, factor = [], [[jnp.zeros(())] * dimension for _ in range(dimension)]
    for k in range(dimension):
        active = rows[k] >= 0
        v = jnp.where(active, normal[rows[k]], 0.0)
        for _ in range(2):
            for j in range(k):
                part = product(unit[j], v)
                v = v - part * unit[j]
                factor[j][k] = factor[j][k] + part
        length = safe_norm(v)
        factor[k][k] = jnp.where(length > 0, length, 1.0)
        unit.append(v / factor[k][k])
    across, parts = new, [jnp.zeros(())] * dimension
    for _ in range(2):
        for k in range(dimension):
            part = product(unit[k], across)
            across = across - part * unit[k]
            parts[k] = parts[k] + part
    along = [jnp.zeros(())] * dimension
    for k in reversed(range(dimension)):
        rest = sum((factor[k][j] * along[j] for j in range(k + 1, dimension)), start=jnp.zeros(()))
        along[k] = (parts[k] - rest) / factor[k][k]
    return across, jnp.stack(along)


def _on_task(qp: StepQP) -> Float[Array, "N"]:
    """Return a solution of A y = b in the span of A's rows."""
    y = jnp.zeros_like(qp.q)
    unit: list[Array] = []
    for row, bound in zip(qp.A, qp.b, strict=True):
        v = row
        for _ in range(2):
            for u in unit:
                v = v - product(v, u) * u
        square = jnp.maximum(product(v, v), 1e-24)
        y = y + (bound - product(row, y)) / square * v
        unit.append(v / jnp.sqrt(square))
    return y


def _inverse_factor(H: Float[Array, "D D"]) -> Float[Array, "D D"]:
    """Return L^-1 for H = L L', by unrolled Gram-Schmidt on the unit vectors in the inner product of H."""
    dimension = H.shape[0]
    rows = []
    for k in range(dimension):
        # Make e_k H-orthogonal to the previous rows, and of H-length 1.
        v = jnp.eye(dimension)[k]
        for _ in range(2):
            for r in rows:
                v = v - product(r, product(H, v)) * r
        rows.append(v / jnp.sqrt(product(v, product(H, v))))
    return jnp.stack(rows)
