"""Numerical primitives whose value and gradient are defined everywhere, and small linear algebra for vmap."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import count as counting
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jax.typing import ArrayLike

from htcp_jax.backend import backend
from htcp_jax.errors import InputError
from htcp_jax.types import Anywhere, Array, Float, Int, Joints, Scalar


def checked_shape(value: object, shape: tuple[int, ...], name: str) -> Float[Array, "..."]:
    """Return `value` as an array of floats; raise an error if it has another shape than required.

    The check runs at trace time and costs nothing in a compiled function.

    Args:
        value: An array, or lists of numbers.
        shape: The required shape.
        name: Name of the value in the error message.

    Raises:
        InputError: If the shape differs.
    """
    array = jnp.asarray(value, float)
    if array.shape != shape:
        raise InputError(f"{name} has the shape {array.shape}, but it must be {shape}; for a batch, use jax.vmap")
    return array


def safe_divide(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return a / b, and 0 where b is 0. The gradient contains no NaN, because of the inner `where`."""
    zero = b == 0
    return jnp.where(zero, 0.0, a / jnp.where(zero, 1.0, b))


def safe_norm(v: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Return the Euclidean norm over the last axis, exact unlike norm(v + eps), with gradient 0 at the origin."""
    square = jnp.sum(v * v, axis=-1)
    zero = square == 0
    return jnp.where(zero, 0.0, jnp.sqrt(jnp.where(zero, 1.0, square)))


def segment_parameter(
    p: Float[Array, "*batch 3"], q: Float[Array, "*batch 3"], point: Float[Array, "*batch 3"]
) -> Float[Array, "*batch"]:
    """Return s in [0, 1] for which p + s (q - p) is the point of the segment p q closest to `point`; 0 if p == q."""
    d = q - p
    s = safe_divide(jnp.sum((point - p) * d, axis=-1), jnp.sum(d * d, axis=-1))
    return jnp.clip(s, 0.0, 1.0)


def capsule_point_distance(
    p: Float[Array, "*batch 3"],
    q: Float[Array, "*batch 3"],
    radius: Float[ArrayLike, "*batch"],
    point: Float[Array, "*batch 3"],
) -> Float[Array, "*batch"]:
    """Return the signed distance from a point to the surface of a capsule [m]; negative inside.

    The closest point of the axis is computed as in Ericson, Real-Time Collision Detection, section 5.1.2. A capsule
    with p == q is a sphere. The gradient is defined everywhere: it is 0 for a point on the capsule's axis.

    Args:
        p: First end of the capsule's axis [m].
        q: Second end of the axis [m].
        radius: Radius of the capsule [m].
        point: The point [m].

    Raises:
        InputError: If the last axis of p, q or point does not have length 3, or if a value is not a number.

    ```python
    >>> import jax
    >>> import jax.numpy as jnp
    >>> from htcp_jax import capsule_point_distance
    >>> p, q = jnp.array([0.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    >>> float(capsule_point_distance(p, q, 0.25, jnp.array([2.0, 0.0, 0.5])))
    1.75
    >>> points = jnp.array([[2.0, 0.0, 0.5], [0.0, 0.0, 0.5]])
    >>> gradient = jax.grad(capsule_point_distance, argnums=3)
    >>> jax.vmap(gradient, in_axes=(None, None, None, 0))(p, q, 0.25, points).tolist()
    [[1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]

    ```
    """
    p, q, point = (_as_points(value, name) for value, name in ((p, "p"), (q, "q"), (point, "point")))
    s = segment_parameter(p, q, point)
    return safe_norm(p + s[..., None] * (q - p) - point) - jnp.asarray(radius, float)


def axis_contact(
    p: Float[Array, "K 3"], q: Float[Array, "K 3"], point: Float[Array, "K 3"]
) -> tuple[Float[Array, "K 3"], Float[Array, "K 3"]]:
    """Return the points of the segments p q nearest to `point` [m], and the unit vectors from `point` to them."""
    nearest = p + segment_parameter(p, q, point)[:, None] * (q - p)
    arm = nearest - point
    return nearest, safe_divide(arm, jnp.broadcast_to(safe_norm(arm)[:, None], arm.shape))


def _as_points(value: object, name: str) -> Float[Array, "*batch 3"]:
    try:
        array = jnp.asarray(value, float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {value!r}; it must be numbers") from None
    if array.shape[-1:] != (3,):
        raise InputError(f"{name} has the shape {array.shape}, but it must be (..., 3)")
    return array


def with_gradient(value: Callable, closed_form: Callable) -> Callable:
    """Return `value` as a function whose derivative with respect to x is given in closed form.

    `jax.grad`, `jax.jvp` and `jax.jacfwd` with respect to x evaluate the closed form only. Derivatives with respect to
    the data are computed by autodiff through `value`.

    Args:
        value: Function (x, *data) -> array of shape (R,) or ().
        closed_form: Function (x, *data) -> (value, gradient), with a gradient of shape (R, N) or (N,).
    """
    differentiable = jax.custom_jvp(value)

    def rule(primals, tangents):
        (x, *data), (dx, *d_data) = primals, tangents
        found, gradient = closed_form(x, *data)
        change = jnp.zeros_like(found) if isinstance(dx, SymbolicZero) else product(gradient, dx)
        if not all(isinstance(leaf, SymbolicZero) for leaf in jax.tree.leaves(d_data)):
            d_data = jax.tree.map(lambda d: np.zeros(d.shape, d.dtype) if isinstance(d, SymbolicZero) else d, d_data)
            change = change + jax.jvp(partial(value, x), data, d_data)[1]
        return found, change

    differentiable.defjvp(rule, symbolic_zeros=True)
    return differentiable


def value_and_jacobian(function: Callable, x: Float[Array, "N"]) -> tuple[Float[Array, "R"], Float[Array, "R N"]]:
    """Return function(x) and its Jacobian by forward-mode autodiff, from one evaluation."""

    def twice(x):
        value = function(x)
        return value, value

    jacobian, value = jax.jacfwd(twice, has_aux=True)(x)
    return value, jacobian


@jax.jit
def product(a: Float[Array, "..."], b: Float[Array, "..."]) -> Float[Array, "..."]:
    """Return a @ b for small matrices and vectors, as a plain sum of products.

    Leading axes are batch axes, as in `jnp.matmul`. On a GPU, `jnp.matmul` may call a library, which costs a separate
    launch; this function is fused into the surrounding code. It is traced once per shape.
    """
    left, right = a.ndim == 1, b.ndim == 1
    a, b = a[None, :] if left else a, b[:, None] if right else b
    c = jnp.sum(a[..., :, :, None] * b[..., None, :, :], axis=-2)
    c = c[..., 0, :] if left else c
    return c[..., 0] if right else c


@partial(jax.jit, static_argnames="floor")
def solve_spd(a: Float[Array, "n n"], b: Float[Array, "n"], floor: float = 1e-300) -> Float[Array, "n"]:
    """Return x with a x = b for a small symmetric positive definite a, by an unrolled Cholesky factorisation.

    Under vmap, LAPACK costs microseconds per 3 x 3 system; the unrolled form is fused into the surrounding code.

    Args:
        a: The matrix.
        b: The right-hand side.
        floor: Lower bound on the pivots, so that a singular matrix gives a large, finite solution and not NaN.
    """
    return jnp.stack(solve_spd_scalars(a, b, floor))


def solve_spd_scalars(a, b, floor: float) -> list[Scalar]:
    """Return the solution of `solve_spd` as a list of scalars.

    Args:
        a (list): Any object whose elements a[i, j] are scalars; only j <= i is read.
        b (list): Any sequence of scalars.
        floor: See `solve_spd`.
    """
    n = len(b)
    factor: list[list[Any]] = [[None] * n for _ in range(n)]
    for j in range(n):
        pivot = a[j, j] - sum((factor[j][k] ** 2 for k in range(j)), start=jnp.zeros(()))
        factor[j][j] = jnp.sqrt(jnp.maximum(pivot, floor))
        for i in range(j + 1, n):
            dot = sum((factor[i][k] * factor[j][k] for k in range(j)), start=jnp.zeros(()))
            factor[i][j] = (a[i, j] - dot) / factor[j][j]
    y: list[Scalar] = []
    for i in range(n):
        y.append((b[i] - sum((factor[i][k] * y[k] for k in range(i)), start=jnp.zeros(()))) / factor[i][i])
    x: list[Scalar] = [jnp.zeros(())] * n
    for i in reversed(range(n)):
        dot = sum((factor[k][i] * x[k] for k in range(i + 1, n)), start=jnp.zeros(()))
        x[i] = (y[i] - dot) / factor[i][i]
    return x


def joined(parts: Sequence[Anywhere]) -> Anywhere:
    """Return arrays one after the other; on the host if all of them are there, as in code that is not traced."""
    on_host = all(isinstance(part, np.ndarray) for part in parts)
    return np.concatenate(parts) if on_host else jnp.concatenate(parts)


def padded_count(count: int) -> int:
    """Return the smallest of 1, 2, 4, 6, 8, 12, 16, 24, 32, ... that is not less than `count`; 0 for 0.

    Arrays with one of few lengths let most scenes share executables.
    """
    return next(n for k in counting() for n in (2**k, 3 * 2**k // 2) if n >= count and n != 3) if count else 0


def table_size(count: float, least: int, factor: int = 2) -> int:
    """Return the smallest of `least`, `least` * `factor`, `least` * `factor`^2, ... that is not less than `count`."""
    return next(size for k in counting() if (size := least * factor**k) >= count)


def with_repeated(rows: np.ndarray, count: int) -> np.ndarray:
    """Return `count` rows: the given ones, and the last of them again."""
    return np.asarray(rows)[np.minimum(np.arange(count), len(rows) - 1)]


def ragged_rows(counts: Int[np.ndarray, "n"]) -> tuple[Int[np.ndarray, "m"], Int[np.ndarray, "m"]]:
    """Return the row of each element, and its index within the row, if row k has counts[k] of the m elements."""
    row = np.repeat(np.arange(len(counts)), counts)
    return row, np.arange(len(row)) - (np.cumsum(counts) - counts)[row]


def fold_keys(key: jax.Array, *data) -> jax.Array:
    """Return a random key derived from `key` and the integers `data`, such as (scenario, target).

    The integers are folded into `key` one by one. A scenario's key therefore does not depend on its batch.
    """
    values = jnp.stack([jnp.asarray(value).astype(jnp.uint32) for value in data])
    # On a CPU the loop compiles to less code. On a GPU it is unrolled, because every iteration costs a launch.
    unroll = 1 if backend().is_cpu else len(data)
    return jax.lax.scan(lambda key, value: (jax.random.fold_in(key, value), None), key, values, unroll=unroll)[0]


def one_by_one(function: Callable) -> Callable:
    """Return `function` with a custom batching rule, for searches that take different numbers of steps.

    Under vmap over the arguments, lanes run one after another on a CPU and in parallel on other devices. A plain vmap
    is slower on a CPU: every lane waits for the slowest one, and branches that are not taken are computed, too.

    Args:
        function: Function (shared, *arguments) of pytrees of arrays; `shared` must not be batched.
    """
    alone = custom_vmap(function)

    @alone.def_vmap
    def batch(axis_size, in_batched, shared, *arguments):
        if any(jax.tree.leaves(in_batched[0])):
            raise ValueError("the searched arrays must be the same for all lanes")
        leaves, structure = jax.tree.flatten(arguments)
        is_batched = jax.tree.leaves(in_batched[1:])

        def lane(own):
            own = iter(own)
            every = [next(own) if b else leaf for leaf, b in zip(leaves, is_batched, strict=True)]
            return alone(shared, *jax.tree.unflatten(structure, every))

        if backend().is_cpu:
            found = jax.lax.map(lane, [leaf for leaf, b in zip(leaves, is_batched, strict=True) if b])
        else:
            every = [
                leaf if b else jnp.broadcast_to(leaf, (axis_size, *leaf.shape))
                for leaf, b in zip(leaves, is_batched, strict=True)
            ]
            found = jax.vmap(partial(function, shared))(*jax.tree.unflatten(structure, every))
        return found, jax.tree.map(lambda _: True, found)

    return alone


@partial(jax.jit, static_argnames="optional")
def null_basis(task_jacobian: Float[Array, "M N"], optional: int = 0) -> Float[Array, "N D"]:
    """Return an orthonormal basis of a task Jacobian's null space, equation (10); D = N - M columns.

    Gram-Schmidt on the rows, then on the unit vectors. Each step takes the unit vector furthest from the span of the
    vectors found so far (the first of several), with positive sign. The basis is therefore the same on every machine,
    unlike that of a singular value decomposition. The paper prints its shape as M x (N - M), but means N x (N - M).

    Args:
        task_jacobian: The Jacobian; its rank must be M, without rows of zeros.
        optional: Number of rows that may be 0. D is N - M + optional, and columns that are not in the basis are 0.

    Raises:
        InputError: If the array is not a matrix.
    """
    task_jacobian = jnp.asarray(task_jacobian)
    if task_jacobian.ndim != 2:
        raise InputError(
            f"the Jacobian has the shape {task_jacobian.shape}, but it must be (M, N); for a batch, use jax.vmap"
        )
    m, n = task_jacobian.shape
    found: list[Joints] = []
    for row in range(m):
        v = _without(found, task_jacobian[row])
        found.append(v / jnp.maximum(safe_norm(v), 1e-12))
    for column in range(n - m + optional):
        # Squared distance of each unit vector from the span of the vectors found so far.
        furthest = jnp.argmax(1.0 - sum(u * u for u in found))
        v = _without(found, jnp.where(jnp.arange(n) == furthest, 1.0, 0.0))
        if optional:
            is_free = column < n - jnp.sum(jnp.any(task_jacobian != 0, axis=1))
            found.append(jnp.where(is_free, v, 0.0) / jnp.where(is_free, safe_norm(v), 1.0))
        else:
            found.append(v / safe_norm(v))
    return jnp.stack(found[m:], axis=1) if n - m + optional else jnp.zeros((n, 0), task_jacobian.dtype)


def _without(found: list[Joints], v: Joints) -> Joints:
    """Return v minus its components along the unit vectors `found`. Two passes reduce rounding errors."""
    for _ in range(2):
        for u in found:
            v = v - product(v, u) * u
    return v
