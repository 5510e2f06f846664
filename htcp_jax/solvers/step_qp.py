"""The step QP, equation (9), in the step y = x - x_ref, and the interface of its solvers.

    minimise    1/2 y' diag(P) y + q' y
    subject to  A y = b          the task, linearised (7) with sigma = 0
                G y <= h         the clearance rows (8), then the task's bands and cones
                lb <= y <= ub

A solver takes a batch of step QPs on the host, and returns steps and statuses. INFEASIBLE is a normal result: the arm
is stuck. FAILED means that the solver did not converge or returned NaN; it is not treated as infeasible.

Only the ratios of the weights matter: solvers stop at an absolute gap, so the smallest weight in P is 1.
"""

import enum
from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from htcp_jax.settings import Settings
from htcp_jax.types import Array, Float, Int, Joints, Scalar

UNTESTED_M = 1e5  # larger clearances are those of bodies that are not tested, see `model.robot.FAR_M`
UNLIMITED = 1e6  # finite joint limits of this magnitude count as none [rad or m]
SPREAD = 1e-6  # smallest weight that counts, relative to the largest, in the scale of the cost


class QPStatus(enum.IntEnum):
    """Result of one QP; stored as int32."""

    SOLVED = 0
    INFEASIBLE = 1
    FAILED = 2


class StepQP(NamedTuple):
    """One step QP: minimise y' diag(P) y / 2 + q' y such that A y = b, G y <= h and lb <= y <= ub.

    y is the joint step x - x_ref of N joints [rad or m]. In a batch every field has a leading axis.

    Attributes:
        P: Diagonal of the cost's matrix (N,): 2 Q, with Q scaled so that its smallest weight is 1; no unit.
        q: Linear cost (N,) [rad or m].
        A: Task Jacobian Jac(x_ref) (M, N), a row for each equality of the task [m/rad or m/m].
        b: Error that the step must remove (M,) [m], Delta C.
        G: Negative gradients (R, N) of the clearance rows, then of the task's bands and cones [m/rad or m/m].
        h: Clearance minus m in each clearance row, then the task's slack (R,) [m].
        lb: Lower bound of the step (N,): lower joint limit minus x_ref [rad or m].
        ub: Upper bound of the step (N,): upper joint limit minus x_ref [rad or m].
    """

    P: Joints
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
        margin_m: m in (9), the clearance at which the rows aim [m]; nothing is added to it. The planner passes the
            job's `margin_m` + `settings.aim_above_m`.
        lower: Lower joint limits [rad or m].
        upper: Upper joint limits [rad or m].
        slack: Slack of the task's bands and cones [m]; None: the task has none.
        slack_gradient: Gradient of the slack [m/rad or m/m].
    """
    weights = jnp.asarray(scaled_weights(settings.q_weights))
    about = x_ref if settings.cost_about == "reference" else x_previous
    if settings.clearance_rows == "smallest":
        body = jnp.argmin(clearance)
        clearance, gradient = clearance[body][None], gradient[body][None]
    G, h = -gradient, jnp.where(clearance < UNTESTED_M, clearance, jnp.inf) - margin_m
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


def scaled_weights(weights: Sequence[float] | Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
    """Return weights divided by the smallest one, or by a millionth of the largest if that is more."""
    weights = np.asarray(weights)
    return weights / max(weights.min(), SPREAD * weights.max())


def row_count(settings: Settings, rows: int, bands: int = 0) -> int:
    """Return the number of inequality rows of one step QP, without the bounds.

    Args:
        settings: Settings of the planner.
        rows: Number of clearance rows.
        bands: Number of bands and cones in the task.
    """
    return (1 if settings.clearance_rows == "smallest" else rows) + bands
