"""Nearest points of two segments.

There are five candidates: a point of each segment's inside, or one of the four ends. All are measured. The first is
computed as by Ericson (Real-Time Collision Detection, section 5.1.9), which is inaccurate for nearly parallel segments;
but then an end is as near.

`nearest_columns` solves the same problem for many pairs in columns, so that a CPU measures several pairs at once. Its
results may differ from those of `nearest_points` in the last digit.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from htcp_jax.numerics import safe_divide, segment_parameter
from htcp_jax.types import Array, Float


class NearestPoints(NamedTuple):
    """Nearest points of two segments, row by row."""

    t: Float[Array, "*n"]  # parameter on the first segment, 0 to 1
    u: Float[Array, "*n"]  # parameter on the second segment, 0 to 1
    on_first: Float[Array, "*n 3"]  # [m]
    on_second: Float[Array, "*n 3"]  # [m]


def nearest_points(
    p: Float[Array, "*n 3"], q: Float[Array, "*n 3"], r: Float[Array, "*n 3"], s: Float[Array, "*n 3"]
) -> NearestPoints:
    """Return the nearest points of the segments p q and r s, row by row.

    The parameters have no gradient; the gradient of the distance is nevertheless exact (envelope theorem).

    Args:
        p: First ends of the first segments [m].
        q: Their second ends [m].
        r: First ends of the second segments [m].
        s: Their second ends [m].
    """
    t, u = _best_parameters(*jax.lax.stop_gradient((p, q, r, s)))
    return NearestPoints(t, u, p + t[..., None] * (q - p), r + u[..., None] * (s - r))


def nearest_columns(
    p: Float[Array, "3 n"], q: Float[Array, "3 n"], r: Float[Array, "3 n"], s: Float[Array, "3 n"]
) -> tuple[Float[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    """Return the parameters of `nearest_points` for columns of coordinates, and the distances [m]; without gradients.

    Args:
        p: First ends of the first segments [m].
        q: Their second ends [m].
        r: First ends of the second segments [m].
        s: Their second ends [m].
    """
    p, q, r, s = jax.lax.stop_gradient((p, q, r, s))
    d, e, w = q - p, s - r, p - r
    a, b, c, f, g = (_column_dot(*pair) for pair in ((d, d), (d, e), (e, e), (d, w), (e, w)))
    zero = jnp.zeros_like(a)

    def on_first(u):
        return jnp.clip(safe_divide(b * u - f, a), 0, 1)

    def on_second(t):
        return jnp.clip(safe_divide(b * t + g, c), 0, 1)

    inner = on_second(jnp.clip(safe_divide(b * g - c * f, a * c - b * b), 0, 1))
    best = on_first(inner), inner, jnp.full_like(a, jnp.inf)
    pairs = (
        (best[0], inner),
        (zero, on_second(zero)),
        (zero + 1, on_second(zero + 1)),
        (on_first(zero), zero),
        (on_first(zero + 1), zero + 1),
    )
    for t, u in pairs:
        apart = w + t[None] * d - u[None] * e
        square = _column_dot(apart, apart)
        best = tuple(jnp.where(square < best[2], new, old) for new, old in zip((t, u, square), best, strict=True))
    return best[0], best[1], jnp.sqrt(best[2])


def _column_dot(u, v):
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _best_parameters(p, q, r, s):
    d, e, w = q - p, s - r, p - r
    a, b, c = _row_dot(d, d), _row_dot(d, e), _row_dot(e, e)
    t = jnp.clip(safe_divide(b * _row_dot(e, w) - c * _row_dot(d, w), a * c - b * b), 0, 1)
    u = segment_parameter(r, s, p + t[..., None] * d)
    t = segment_parameter(p, q, r + u[..., None] * e)
    zero = jnp.zeros_like(t)
    ts = jnp.stack([t, zero, zero + 1, segment_parameter(p, q, r), segment_parameter(p, q, s)])
    us = jnp.stack([u, segment_parameter(r, s, p), segment_parameter(r, s, q), zero, zero + 1])
    apart = w[None] + ts[..., None] * d[None] - us[..., None] * e[None]
    best = jnp.argmin(_row_dot(apart, apart), axis=0)[None]
    return (jnp.take_along_axis(each, best, axis=0)[0] for each in (ts, us))


def _row_dot(u, v):
    return jnp.sum(u * v, axis=-1)
