"""Rotations: exponential and logarithm map, quaternions, and the smallest rotation between directions.

jaxlie also has these maps, but stores a rotation as a quaternion: matrices would be converted, with other rounding
errors. It also depends on jax_dataclasses and tyro.
"""

import jax.numpy as jnp
import numpy as np
import scipy

from htcp_jax.numerics import product, safe_norm
from htcp_jax.types import Array, Float, Scalar, Vector3


def axis_angle_matrix(axis: Float[Array, "n 3"], turn: Float[Array, "n"]) -> Float[Array, "n 3 3"]:
    """Return the rotation matrices about unit axes by angles [rad]: the exponential map, by Rodrigues' formula.

    The matrix is I + sin(turn) K + (1 - cos(turn)) K^2, where K v = axis x v.
    """
    x, y, z = axis.T
    o = jnp.zeros_like(x)
    K = jnp.stack([o, -z, y, z, o, -x, -y, x, o], axis=1).reshape(-1, 3, 3)
    sin, cos = jnp.sin(turn)[:, None, None], jnp.cos(turn)[:, None, None]
    return jnp.eye(3, dtype=axis.dtype)[None] + sin * K + (1.0 - cos) * product(K, K)


def rotation_vector(rotation: Float[Array, "3 3"]) -> Vector3:
    """Return the rotation vector of a matrix: its axis times its angle, 0 to pi [rad]; the logarithm map."""
    twice = jnp.stack([
        rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1],
    ])  # fmt: skip
    sine, cosine = 0.5 * safe_norm(twice), 0.5 * (jnp.trace(rotation) - 1.0)
    turn = jnp.arctan2(sine, cosine)
    flat = sine < 1e-12
    small = 0.5 * twice * jnp.where(flat, 1.0, turn / jnp.where(flat, 1.0, sine))
    # Near an angle of pi the sine does not determine the axis; the symmetric part is (1 - cos) axis axis' + cos I.
    symmetric = 0.5 * (rotation + rotation.T) - cosine * jnp.eye(3)
    best = jnp.argmax(jnp.diagonal(symmetric))
    column = jnp.where(cosine < -0.5, symmetric[:, best], jnp.array([1.0, 0.0, 0.0]))
    axis = column / jnp.maximum(safe_norm(column), 1e-12) * jnp.where(twice[best] < 0, -1.0, 1.0)
    return jnp.where(cosine < -0.5, turn * axis, small)


def quaternion_matrix(quaternion: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """Return the rotation matrix of a unit quaternion w, x, y, z (Siciliano et al., Robotics, section 2.6)."""
    w, x, y, z = quaternion
    return jnp.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip


def sine_error(now: Float[Array, "3 3"], wanted: Float[Array, "3 3"]) -> Vector3:
    """Return the axis of the rotation between two orientations, times sin(angle) up to pi / 2, times 1 beyond.

    The product axis sin(angle) is half of sum_k r_k x t_k over the columns of both matrices (Siciliano et al.,
    Robotics, section 3.7.3).
    """
    v = 0.5 * jnp.sum(jnp.cross(now.T, wanted.T), axis=0)
    size = safe_norm(v)
    return jnp.where(jnp.sum(now * wanted) < 1.0, v / jnp.maximum(size, 1e-9), v)


def angle(a: Vector3, b: Vector3) -> Scalar:
    """Return the angle between two unit directions, 0 to pi [rad]; accurate near 0 and pi, with gradient 0 there."""
    return jnp.arctan2(safe_norm(jnp.cross(a, b)), product(a, b))


def axis_error(axis: Vector3, direction: Vector3) -> Float[Array, "2"]:
    """Return the rotation vector from one unit direction to another, the logarithm map, as two components [rad].

    The components are along two axes perpendicular to `direction`. For opposite directions the result is a rotation by
    pi about an arbitrary perpendicular axis.
    """
    least = jnp.argmin(jnp.abs(direction))
    first = jnp.cross(direction, jnp.where(jnp.arange(3) == least, 1.0, 0.0))
    first = first / safe_norm(first)
    across = jnp.stack([first, jnp.cross(direction, first)])
    square = jnp.cross(axis, direction)
    sine, cosine = safe_norm(square), product(axis, direction)
    flat = sine < 1e-12
    turn = jnp.where(flat, 1.0, jnp.arctan2(sine, cosine) / jnp.where(flat, 1.0, sine))
    opposite = flat & (cosine < 0)
    return turn * product(across, square) + jnp.where(opposite, jnp.array([jnp.pi, 0.0]), 0.0)


def least_turn(a: Float[np.ndarray, "3"], b: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the shortest rotation vector from unit direction a to b [rad]; its axis is arbitrary if b = -a."""
    square, cosine = np.cross(a, b), float(a @ b)
    if (sine := float(np.linalg.norm(square))) < 1e-12:
        square, sine = np.cross(a, np.eye(3)[np.abs(a).argmin()]), 1.0
        square = square / np.linalg.norm(square)
        return square * (0.0 if cosine > 0 else np.pi)
    return square / sine * np.arctan2(sine, cosine)


def turned_directions(
    a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "n 3"], share: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 3"]:
    """Interpolate unit directions: rotate a by a share of the smallest rotation to b; share 0 is a, 1 is b."""
    turns = np.array([least_turn(one, other) for one, other in zip(a, b, strict=True)]).reshape(-1, 3)
    return scipy.spatial.transform.Rotation.from_rotvec(share[:, None] * turns).apply(a) if len(a) else a


def turned_frames(
    a: Float[np.ndarray, "n 3 3"], b: Float[np.ndarray, "n 3 3"], share: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n 3 3"]:
    """Interpolate rotation matrices: rotate a by a share of the smallest rotation to b; share 0 is a, 1 is b."""
    if not len(a):
        return a
    return scipy.spatial.transform.Rotation.from_rotvec(share[:, None] * frame_turns(a, b)).as_matrix() @ a


def frame_turns(a: Float[np.ndarray, "n 3 3"], b: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n 3"]:
    """Return the shortest rotation vectors, in the world, from rotation matrices a to b [rad]."""
    if not len(a):
        return np.zeros((0, 3))
    return scipy.spatial.transform.Rotation.from_matrix(b @ np.swapaxes(a, 1, 2)).as_rotvec()
