"""The step QP, equation (9), in the step y = x - x_ref, and the interface of its solvers.

    minimise    1/2 y' diag(P) y + q' y
    subject to  A y = b          the task, linearised (7) with sigma = 0
                G y <= h         the clearance rows (8), then the task's bands and cones
                lb <= y <= ub

A solver takes a batch of step QPs on the host, and returns steps and statuses. INFEASIBLE is a normal result: the arm
is stuck. FAILED means that the solver did not converge or returned NaN; it is not treated as infeasible.

Only the ratios of the weights matter, and short steps are as accurate as long ones. Therefore solvers with absolute
tolerances get the QP of `scaled`, whose weights, step and bounds are of about 1. Powers of two scale all but the
weights, so that no constraint is rounded.
"""

import enum
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from htcp_jax.settings import Settings
from htcp_jax.types import Array, Float, Int, Joints, Scalar

UNLIMITED = 1e6  # finite joint limits of this magnitude count as none [rad or m]
SHORTEST, LONGEST = 2.0**-20, 1.0  # shorter and longer steps are scaled like these [rad or m]
UNIT = 0.25  # length of a unit relative to the step: Clarabel then is accurate to 1e-7 steps, at the fewest iterations


class QPStatus(enum.IntEnum):
    """Result of one QP; stored as int32."""

    SOLVED = 0
    INFEASIBLE = 1
    FAILED = 2


class StepQP(NamedTuple):
    """One step QP, see the module's docstring; in a batch every field has a leading axis."""

    P: Joints  # diagonal of the cost's matrix
    q: Joints
    A: Float[Array, "M N"]
    b: Float[Array, "M"]
    G: Float[Array, "R N"]
    h: Float[Array, "R"]
    lb: Joints
    ub: Joints


class QPSolution(NamedTuple):
    """Solution of a step QP."""

    y: Joints  # the step; zeros if the QP is not solved
    status: Int[Array, ""]  # number of a `QPStatus`


class ScaledQP(NamedTuple):
    """A batch of B step QPs, scaled for solvers on the host, with the step y = size * u.

    minimise 1/2 u' diag(P) u + q' u with M equations, rows @ u = bound, and inequalities, rows @ u <= bound.
    """

    P: Float[np.ndarray, "B N"]  # the largest entry is 2
    q: Float[np.ndarray, "B N"]
    rows: Float[np.ndarray, "B S N"]  # A, then G, upper limits and lower limits; zeros if there is no bound
    bound: Float[np.ndarray, "B S"]  # of inequalities less than 2
    size: Float[np.ndarray, "B 1"]  # length of a unit, a power of two [rad or m]


@runtime_checkable
class QPSolver(Protocol):
    """Solver of a batch of step QPs given as numpy arrays with a leading axis B.

    Results must not depend on the batch.
    """

    def solve(self, qps: StepQP) -> QPSolution:
        """Return the solutions of the batch, as numpy arrays with the same leading axis B."""


def assemble(
    settings: Settings,
    x_ref: Joints,
    x_previous: Joints,
    to_target: Float[Array, "M"],
    task_jacobian: Float[Array, "M N"],
    clearance: Float[Array, "R"],
    gradient: Float[Array, "R N"],
    margin_m: Scalar,
    lower: Joints,
    upper: Joints,
    slack: Float[Array, "B"] | None = None,
    slack_gradient: Float[Array, "B N"] | None = None,
) -> StepQP:
    """Return the step QP (9) about x_ref.

    Args:
        settings: The weights of J1 are used, `cost_about`, which is x_ref (9) or x_{t-1} (4), and `clearance_rows`: all
            rows (8), or only the row with the smallest D (9).
        x_ref: The current configuration [rad or m].
        x_previous: The configuration at the previous target, x_{t-1} [rad or m].
        to_target: Delta C = C_next - C_ref [m].
        task_jacobian: Jac(x_ref) [m/rad or m/m].
        clearance: D of every row [m].
        gradient: Gradients of D [m/rad or m/m].
        margin_m: Required clearance.
        lower: Lower joint limits [rad or m].
        upper: Upper joint limits [rad or m].
        slack: Slack of the task's bands and cones [m]; None: the task has none.
        slack_gradient: Gradient of the slack [m/rad or m/m].
    """
    weights = jnp.asarray(scaled_weights(settings))
    about = x_ref if settings.cost_about == "reference" else x_previous
    if settings.clearance_rows == "smallest":
        body = jnp.argmin(clearance)
        clearance, gradient = clearance[body][None], gradient[body][None]
    G, h = -gradient, clearance - margin_m
    if slack is not None and len(slack):
        G, h = jnp.concatenate([G, -slack_gradient]), jnp.concatenate([h, slack])
    return StepQP(
        P=2 * weights,
        q=2 * weights * (x_ref - about),
        A=task_jacobian,
        b=to_target,
        G=G,
        h=h,
        lb=jnp.where(lower > -UNLIMITED, lower, -jnp.inf) - x_ref,
        ub=jnp.where(upper < UNLIMITED, upper, jnp.inf) - x_ref,
    )


def scaled_weights(settings: Settings) -> Float[np.ndarray, "N"]:
    """Return `q_weights` divided by the power of four next to the largest weight.

    The square root of such a power is a power of two, so a factorisation has the same bits as without the scaling.
    """
    weights = np.asarray(settings.q_weights)
    return weights / 4.0 ** np.round(np.log2(weights.max()) / 2)


def scaled(qps: StepQP) -> ScaledQP:
    """Return a batch of step QPs with weights, steps and bounds of about 1.

    The results are bitwise the same in any batch.

    Args:
        qps: Numpy arrays with a leading axis B.
    """
    (batch, n), equations = qps.q.shape, qps.b.shape[1]
    eye = np.broadcast_to(np.eye(n), (batch, n, n))
    rows = np.concatenate([qps.A, qps.G, eye, -eye], axis=1)
    bound = np.concatenate([qps.b, qps.h, qps.ub, -qps.lb], axis=1)

    # The longest step that the cost or one constraint alone requires
    required = np.concatenate([np.abs(qps.q), np.abs(qps.b), -bound[:, equations:]], axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        required /= np.concatenate([qps.P, np.abs(rows).max(axis=2)], axis=1)
    longest = np.fmax.reduce(required, axis=1, keepdims=True)
    size = UNIT * _power_of_two(np.fmin(np.fmax(longest, SHORTEST), LONGEST))

    bound /= size
    limited = bound[:, equations:]
    far = np.isposinf(limited)
    share = 2 / _power_of_two(np.where(far, 1.0, np.maximum(limited, 1.0)))
    limited[...] = np.where(far, 1.0, share * limited)
    rows[:, equations:] *= np.where(far, 0.0, share)[:, :, None]
    per_weight = 2 / qps.P.max(axis=1, keepdims=True)
    return ScaledQP(per_weight * qps.P, per_weight * qps.q / size, rows, bound, size)


def _power_of_two(value: np.ndarray) -> np.ndarray:
    """Return powers of two, larger than positive values by a factor of at most two."""
    return np.ldexp(1.0, np.frexp(value)[1])


def row_count(settings: Settings, rows: int, bands: int = 0) -> int:
    """Return the number of inequality rows of one step QP, without the bounds.

    Args:
        settings: Settings of the planner.
        rows: Number of clearance rows.
        bands: Number of bands and cones in the task.
    """
    return (1 if settings.clearance_rows == "smallest" else rows) + bands
