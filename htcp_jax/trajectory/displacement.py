"""Bounds on the displacement of an arm's points if its joints are displaced from the proven joint path.

Each joint j is within w_j of x, and is displaced by n_j. Let r_j be the levers of a point at x, and M_j as in
`motion_bound` for joints within w + n. Then column j of the point's Jacobian has a norm of at most l_j = r_j + M_{j+1},
and its derivative by joint i at most l_max(i, j), or 0 for two slides. The point moves by no more than either of

    sum_j l_j n_j    and    |J(x) n| + sum_ij l_max(i, j) (w_i + n_i / 2) n_j.

The second bound accounts for joints that compensate each other's motion, for example if the tool stays on its path.
Both bounds also apply to a direction that is fixed to a link: hinges move its end like a point, with r_j = |z_j x
direction|, and slides do not move it. The hinges between two links move a direction in the frame of the other link;
for these hinges r_j <= 1 is used.
"""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from htcp_jax.clearance.proof import OUTSIDE_M, arm_points, lever_bounds
from htcp_jax.device import tables as device_tables
from htcp_jax.model import Feature, Robot, feature_at, kinematics, moved_by
from htcp_jax.numerics import safe_norm

ROWS = 256  # tables are padded to this number of rows times a power of two, so that few sizes are compiled


class ArmLevers(NamedTuple):
    """Levers and Jacobians of P = 2 K + 1 + F points of an arm, at k configurations.

    The points are both ends of the arm's K bodies, the TCP, and F features of a task, which may be directions.
    """

    levers: Float[np.ndarray, "k P J"]  # distance from each joint's axis [m]; 0 if it does not move the point
    jacobian: Float[np.ndarray, "k P 3 J"]  # by the joints q
    tcp: Float[np.ndarray, "k 3"]  # position in the world [m]
    hinge: Bool[np.ndarray, "J"]  # True for hinges
    turning: Float[np.ndarray, "P J"] | float = 0.0  # for the ends of bodies, see `_turning` [m/rad]
    features: int = 0  # number of features, F
    factors: Float[np.ndarray, "J N"] | None = None  # C of q = C x + d; None: no joint follows another

    def joints(self, step: Float[np.ndarray, "*S N"]) -> Float[np.ndarray, "*S J"]:
        """Return the displacements of the joints q, from those of the coordinates [rad or m]."""
        return step if self.factors is None else step @ self.factors.T

    def ranges(self, within: Float[np.ndarray, "*S N"]) -> Float[np.ndarray, "*S J"]:
        """Return bounds |C| d on the distances of the joints q, from those of the coordinates [rad or m]."""
        return within if self.factors is None else within @ np.abs(self.factors).T

    def only(self, which: np.ndarray | slice) -> "ArmLevers":
        """Return the levers at the configurations in `which`."""
        return self._replace(levers=self.levers[which], jacobian=self.jacobian[which], tcp=self.tcp[which])

    def moved(self, bounds: Float[np.ndarray, "*S P"]) -> "Displacement":
        """Return the bounds for bodies, TCP and features, from bounds on the points' displacements."""
        tcp = self.levers.shape[-2] - 1 - self.features
        return Displacement(bounds[..., :tcp].max(axis=-1), bounds[..., tcp], bounds[..., tcp + 1 :])


class Displacement(NamedTuple):
    """Upper bounds on the displacements of bodies, TCP and features."""

    bodies: Float[np.ndarray, "*S"]  # displacement of any point of any body [m]
    tcp: Float[np.ndarray, "*S"]  # displacement of the TCP [m]
    features: Float[np.ndarray, "*S F"]  # displacement of each feature: of a point [m], of a direction as a chord


def arm_at(robot: Robot, x: Float[np.ndarray, "k N"], features: tuple[Feature, ...] = ()) -> ArmLevers:
    """Return the levers and Jacobians of an arm's points at k configurations.

    Args:
        robot: The arm.
        x: Configurations [rad or m].
        features: Features of a task.
    """
    levers, slopes, tcp = in_padded_sizes(_point_slopes, robot, x)
    if features:
        more = in_padded_sizes(partial(_features, features), robot, x)[0]
        found = np.linalg.norm(more, axis=2)
        for k, feature in enumerate(features):
            if feature.seen_from is not None:
                ends = robot.tcp_link if feature.link is None else feature.link, feature.seen_from.link
                first, second = moved_by(robot.parents)[list(ends)]
                found[:, k] = (first ^ second) & ~np.array(robot.slides)
        levers = np.concatenate([levers, found], axis=1)
        slopes = np.concatenate([slopes, more], axis=1)
    hinge, turning = ~np.array(robot.slides), _turning(robot, len(features))
    factors = None if robot.coupling is None else np.asarray(robot.coupling.factors)
    return ArmLevers(levers, slopes, tcp, hinge, turning, len(features), factors)


def _turning(robot: Robot, features: int) -> Float[np.ndarray, "P J"] | float:
    """Return a bound on the motion of a convex piece's points about its capsule's axis, by hinge angle [m/rad]."""
    if robot.pieces is None:
        return 0.0
    reach = np.where(np.asarray(robot.pieces.excess_m) > 0, np.asarray(robot.capsule_radius) + OUTSIDE_M, 0.0)
    moves = moved_by(robot.parents)[np.array(robot.capsule_link)]
    bodies = reach[:, None] * (moves & ~np.array(robot.slides))
    return np.concatenate([bodies, bodies, np.zeros((1 + features, len(robot.slides)))])


def tcp_at(robot: Robot, x: Float[np.ndarray, "k N"]) -> tuple[Float[np.ndarray, "k 3"], Float[np.ndarray, "k 3 N"]]:
    """Return the TCP's positions in the world [m], and its Jacobians, at k configurations [rad or m]."""
    return in_padded_sizes(_tcp_and_jacobian, robot, x)


def displacement_bound(
    arm: ArmLevers, within: Float[np.ndarray, "*S k N"], displacement: Float[np.ndarray, "*S k N"]
) -> Float[np.ndarray, "*S k P"]:
    """Return an upper bound on each point's displacement [m].

    Args:
        arm: The arm at k configurations.
        within: Distances of the coordinates from these configurations [rad or m].
        displacement: Displacements of the coordinates [rad or m].
    """
    within, displacement = arm.ranges(within), arm.joints(displacement)
    size = np.abs(displacement)
    lever = _levers(arm, within + size)
    along = np.linalg.norm(np.einsum("kpcn,...kn->...kpc", arm.jacobian, displacement), axis=-1)
    by_axis = np.minimum((lever * size[..., None, :]).sum(-1), along + _second(arm, lever, within + 0.5 * size, size))
    return by_axis if isinstance(arm.turning, float) else by_axis + (arm.turning * size[..., None, :]).sum(-1)


def bend_bound(
    arm: ArmLevers, within: Float[np.ndarray, "k N"], rates: Float[np.ndarray, "k N"]
) -> Float[np.ndarray, "k P"]:
    """Return an upper bound on each point's second derivative along straight joint paths [m].

    Args:
        arm: The arm at k configurations.
        within: Distances of the coordinates from these configurations [rad or m].
        rates: Derivatives of the coordinates along the paths [rad or m].
    """
    own = np.abs(arm.joints(rates))
    return _second(arm, _levers(arm, arm.ranges(within)), own, own)


def _levers(arm: ArmLevers, within: np.ndarray) -> np.ndarray:
    """Return the bounds l_j, see the module, for joints within `within` of the configurations."""
    return np.stack(np.broadcast_arrays(*lever_bounds(arm.levers, within, arm.hinge)[0]), axis=-1)


def _second(arm: ArmLevers, lever: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return sum_ij l_max(i, j) a_i b_j, without pairs of slides."""
    turned_a, turned_b = a * arm.hinge, b * arm.hinge
    before_a, before_b = np.cumsum(turned_a, axis=-1) - turned_a, np.cumsum(turned_b, axis=-1) - turned_b
    pairs = a * before_b + b * before_a + turned_a * turned_b
    return (lever * pairs[..., None, :]).sum(-1)


def in_padded_sizes(function: Callable, robot: Robot, *tables: Float[np.ndarray, "k ..."]) -> tuple[np.ndarray, ...]:
    """Return a function's results for the rows of tables, padded so that only a few sizes are compiled."""
    rows = len(tables[0])
    most = ROWS * 2 ** max(0, int(np.ceil(np.log2(rows / ROWS))))
    return tuple(
        np.asarray(part)[:rows] for part in function(robot, *(device_tables.pad(table, most, most) for table in tables))
    )


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def _point_slopes(robot: Robot, x):
    points, links = arm_points(robot, x)
    slopes = kinematics.by_joint(robot, x, points, links)
    return safe_norm(slopes.swapaxes(1, 2)), slopes, points[-1]


@jax.jit
@partial(jax.vmap, in_axes=(None, 0))
def _tcp_and_jacobian(robot: Robot, x):
    return kinematics.tcp_position(robot, x), kinematics.jacobian(robot, x)


@partial(jax.jit, static_argnums=0)
@partial(jax.vmap, in_axes=(None, None, 0))
def _features(features: tuple[Feature, ...], robot: Robot, x):
    robot, q = kinematics.with_free_joints(robot), kinematics.joint_positions(robot, x)
    return (jnp.stack([jax.jacfwd(partial(feature_at, robot, feature=feature))(q) for feature in features]),)
