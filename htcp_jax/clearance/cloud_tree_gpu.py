"""The search of `cloud_tree` as one GPU kernel: a program for each body, or for each configuration, walks the tree.

As a series of XLA loops every turn would be a launch, and a turn would read and write the keys of all bodies. The
kernel is written in Pallas for its Triton backend; with `interpret=True` it runs on any machine.
"""

from functools import partial

import jax
import jax.numpy as jnp
from jax.experimental import pallas as pl

from htcp_jax.clearance.bounding_discs import Segments, lower_bounds, single, squared_distance
from htcp_jax.clearance.branch_and_bound import FAN, NONE_LEFT, least_number, number_mask, order_keys
from htcp_jax.types import Array, Int

try:
    from jax.experimental.pallas import triton
except ImportError:  # JAX means to take it out
    triton = None

HAS_KERNEL = triton is not None


def nearest_leaves(index, p, q, radius, limit, shared: bool, interpret: bool = False) -> Int[Array, "K"]:
    """The leaf of each body's nearest point, -1 for none below the body's limit; with a shared limit, for the nearest
    body only."""
    bodies = p.shape[0]
    branches = index.levels[-2].transpose(1, 0, 2).reshape(8, -1)
    size = 1 << (branches.shape[1] - 1).bit_length()
    padded = jnp.pad(branches, ((0, 0), (0, size - branches.shape[1])), mode="edge")
    return pl.pallas_call(
        partial(_walk, shared, branches.shape[1], bodies),
        out_shape=jax.ShapeDtypeStruct((bodies,), jnp.int32),
        grid=(1 if shared else bodies,),
        compiler_params=triton.CompilerParams(num_warps=1),
        interpret=interpret,
    )(p, q, radius, limit, padded, index.levels[-1], index.points)


def _walk(shared, branch_count, bodies, p, q, radius, limit, branches, leaves, points, out):
    one = partial(_nearest_leaf, branch_count, p, q, radius, branches, leaves, points)
    if not shared:
        body = pl.program_id(0)
        out[body] = one(body, limit[body])[1]
        return

    def search(k, state):
        body = bodies - 1 - k  # the tool is nearest, most of the time
        lowest, best, found = state
        lowest, leaf = one(body, lowest)
        return lowest, jnp.where(leaf >= 0, body, best), jnp.where(leaf >= 0, leaf, found)

    _, best, found = jax.lax.fori_loop(0, bodies, search, (limit[0], jnp.int32(-1), jnp.int32(-1)))
    for body in range(bodies):
        out[body] = jnp.where(best == body, found, -1)


def _nearest_leaf(branch_count, p, q, radius, branches, leaves, points, body, limit):
    """(limit, leaf): the limit of one body lowered to what it attains, and where."""
    start = [p[body, i] for i in range(3)]
    along = [q[body, i] - start[i] for i in range(3)]
    square = along[0] * along[0] + along[1] * along[1] + along[2] * along[2]
    segment = Segments(start, along, 1 / jnp.maximum(square, 1e-30))
    r = radius[body]

    def measure(leaf, state):
        limit, found = state
        here = jnp.sqrt(jnp.min(squared_distance(segment, [points[leaf, i, :] for i in range(3)]))) - r
        return jnp.minimum(limit, here), jnp.where(here < limit, leaf, found)

    def search(load, child, state):
        """Clusters in the order of their bounds; `child` goes on with the number of one."""
        keys = order_keys(jnp.maximum(lower_bounds(single(segment), [load(i) for i in range(8)]), 0.0))
        mask = number_mask(len(keys))

        def prune(keys, limit):
            nearest = jnp.full(len(keys), jnp.minimum((limit + r) * (1 + 1e-6), 1e30), jnp.float32)
            return jnp.where(keys <= (jax.lax.bitcast_convert_type(nearest, jnp.int32) | mask), keys, NONE_LEFT)

        def take(state):
            picked, keys, limit, found = state
            limit, found = child(picked & mask, (limit, found))
            keys = prune(jnp.where(keys == picked, NONE_LEFT, keys), limit)
            return jnp.min(keys), keys, limit, found

        keys = prune(keys, state[0])
        return jax.lax.while_loop(lambda s: s[0] < NONE_LEFT, take, (jnp.min(keys), keys, *state))[2:]

    def descend(branch, state):
        branch = jnp.minimum(branch, branch_count - 1)
        return search(lambda i: leaves[branch, i, :], lambda k, s: measure(branch * FAN + k, s), state)

    def nearest_middle(load):
        return least_number(squared_distance(single(segment), [load(i) for i in range(3)]))

    # Not from nothing: the leaf whose middle is nearest gives the first limit.
    first = jnp.minimum(nearest_middle(lambda i: branches[i, :]), branch_count - 1)
    start = measure(first * FAN + nearest_middle(lambda i: leaves[first, i, :]), (limit, jnp.int32(-1)))
    return search(lambda i: branches[i, :], descend, start)
