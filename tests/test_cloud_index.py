"""Nearest-point index: the same distance as brute force in numpy, to the last bits, for any segment."""

from functools import cache

import jax
import jax.numpy as jnp
import made_once
import numpy as np
import pytest

from htcp_jax.backend import Backend, compiled_for, triton
from htcp_jax.clearance.distance.cloud_tree import TOP, body_within, build_index, nearest_body, nearest_rows
from htcp_jax.clearance.distance.cloud_tree_gpu import nearest_leaves
from htcp_jax.clearance.distance.clusters import FAN, as_segments, bounding_discs, lower_bounds, single, with_axes

LANES = 8  # segments per search, as the capsules of a configuration
EPS = np.finfo(float).eps


def distances(p, q, points):
    """Distances of every point to every segment (K, P), in plain numpy."""
    d = q - p
    square = np.sum(d * d, axis=1)
    arm = points[None] - p[:, None]
    s = np.einsum("kpi,ki->kp", arm, d) / np.where(square > 0, square, 1.0)[:, None]
    return np.linalg.norm(arm - np.clip(s, 0, 1)[..., None] * d[:, None], axis=2)


def smallest_distances(p, q, points):
    """Smallest distance of each segment (K,): of the points that 32-bit floats cannot exclude, exactly."""
    if len(points) * len(p) < 1e5:
        return distances(p, q, points).min(1)
    middle, exact = points.mean(axis=0), np.empty(len(p))
    x, y, z = np.ascontiguousarray((points - middle).T, np.float32)
    extent = np.abs(points - middle).max()
    for k, (a, b) in enumerate(zip(p - middle, q - middle, strict=True)):
        d = b - a
        square = d @ d
        (ax, ay, az), (dx, dy, dz) = a.astype(np.float32), d.astype(np.float32)
        u, v, w = x - ax, y - ay, z - az
        s = np.clip((u * dx + v * dy + w * dz) * np.float32(1 / square if square > 1e-30 else 0.0), 0, 1)
        u, v, w = u - s * dx, v - s * dy, w - s * dz
        square = u * u + v * v + w * w
        most = np.sqrt(square.min()) + 1e-5 * (extent + np.abs(a).max() + np.abs(b).max())
        exact[k] = distances(p[[k]], q[[k]], points[square <= most**2]).min()
    return exact


@cache
def cloud(name: str) -> np.ndarray:
    """Clouds of 1 to 127,000 points: ordinary ones, and ones that are hard to split into a tree."""
    rng = np.random.default_rng(len(name))
    made = {
        "one": lambda: rng.normal(size=(1, 3)),
        "four": lambda: rng.normal(size=(4, 3)),
        "seventeen": lambda: rng.normal(size=(17, 3)),
        "three hundred": lambda: rng.normal(size=(300, 3)),
        "all the same": lambda: np.repeat(rng.normal(size=(1, 3)), 300, axis=0),
        "each five times": lambda: np.repeat(rng.normal(size=(120, 3)), 5, axis=0),
        "on a line": lambda: np.linspace(-1, 1, 600)[:, None] * np.array([[0.6, -0.3, 0.74]]) + 0.2,
        "on a plane": lambda: rng.normal(size=(2000, 3)) * np.array([[1.0, 1.0, 0.0]]),
        "on a grid": lambda: np.stack(np.meshgrid(*[np.arange(9) / 8] * 3), axis=-1).reshape(-1, 3),
        "far apart": lambda: np.concatenate([rng.normal(size=(400, 3)) * 0.01 + c for c in ((9, 0, 0), (-9, 3, 1))]),
        "as many as two levels take": lambda: rng.normal(size=(TOP * FAN**2, 3)),
        "as few as take four levels": lambda: rng.normal(size=(TOP * FAN**3 + 1, 3)) * np.array([[1.0, 1.0, 0.01]]),
        "duct": lambda: made_once.duct().cloud,
    }
    return made[name]()


SMALL = [
    "one", "four", "seventeen", "three hundred", "all the same", "each five times", "on a line", "on a plane",
    "on a grid", "far apart",
]  # fmt: skip


def segments(points, count, seed):
    """Random segments near, far, touching and crossing the cloud, from zero to huge length."""
    rng = np.random.default_rng(seed)
    middle, extent = points.mean(0), np.ptp(points, axis=0).max() + 0.1
    near = points[rng.integers(len(points), size=count)]
    offset = rng.normal(size=(count, 3))
    offset *= (10.0 ** rng.uniform(-9, 0, count) * (rng.random(count) < 0.8))[:, None]  # one in five starts on a point
    p = np.where(rng.random((count, 1)) < 0.6, near + offset, middle + extent * rng.normal(size=(count, 3)))
    length = np.choose(
        rng.integers(5, size=count),
        [np.zeros(count), 10.0 ** rng.uniform(-30, -6, count), *np.geomspace(1e-2, 15.0, 3)[:, None] + np.zeros(count)],
    )
    direction = rng.normal(size=(count, 3))
    q = p + length[:, None] * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    # Some also end on a point, and some start at the origin, where rounding does not affect a tiny length.
    other = points[rng.integers(len(points), size=count)]
    q = np.where(rng.random((count, 1)) < 0.15, other, q)
    home = rng.random((count, 1)) < 0.05
    return np.where(home, 0.0, p), np.where(home, length[:, None] * direction, q)


_NEAREST = made_once.quick_jit(lambda index, p, q: jax.lax.map(lambda s: nearest_rows(index, *s), (p, q)))


def nearest(index, p, q):
    """Rows of the nearest points, for LANES segments at a time."""
    batches = (np.reshape(a, (-1, LANES, *a.shape[1:])) for a in (p, q))
    return np.asarray(_NEAREST(index, *batches)).ravel()


def check(points, count, seed):
    p, q = segments(points, count, seed)
    rows = nearest(build_index(points), p, q)
    assert (rows >= 0).all() and (rows < len(points)).all()
    found = np.array([distances(p[k : k + 1], q[k : k + 1], points[rows[k] : rows[k] + 1])[0, 0] for k in range(count)])
    exact = smallest_distances(p, q, points)
    scale = np.maximum(1.0, np.maximum(np.abs(p).max(1), np.abs(q).max(1)))
    worst = np.argmax((found - exact) / scale)
    assert (found - exact <= EPS * scale).all(), (p[worst], q[worst], found[worst], exact[worst])


@pytest.mark.parametrize("name", SMALL)
def test_the_nearest_point_is_the_nearest_of_all(name):
    check(cloud(name), 400, seed=1)


@pytest.mark.parametrize(("name", "levels"), [("as many as two levels take", 2), ("as few as take four levels", 4)])
def test_trees_of_other_depths_find_the_nearest_point(name, levels):
    assert len(build_index(cloud(name)).levels) == levels
    check(cloud(name), 80, seed=9)


@pytest.mark.parametrize("name", ["three hundred", "all the same", "on a plane", "on a line", "duct"])
def test_no_point_of_a_cluster_is_nearer_than_its_disc(name):
    points = cloud(name)
    groups = points[np.random.default_rng(1).integers(len(points), size=(60, 1))] + 0.02 * points[:48].reshape(1, -1, 3)
    p, q = segments(groups.reshape(-1, 3), 64, seed=2)
    bound = lower_bounds(
        with_axes(single(as_segments(jnp.asarray(p), jnp.asarray(q))), 1),
        jnp.asarray(bounding_discs(groups).T[:, None, :], jnp.float32),
    )
    exact = np.stack([smallest_distances(p, q, group) for group in groups], axis=1)
    assert (np.asarray(bound) <= exact).all()
    assert np.median(exact - np.asarray(bound)) < 0.05


def test_the_nearest_point_of_the_duct_is_the_nearest_of_all():
    check(cloud("duct"), 3000, seed=2)


@pytest.mark.parametrize("length", 10.0 ** -np.arange(12, 200, 9))
def test_a_segment_shorter_than_rounding_is_a_point(length):
    """Segments whose squared length, or its inverse, exceeds the range of 32-bit or 64-bit floats."""
    p = np.zeros((LANES, 3))
    q = p + length * np.concatenate([np.eye(3), -np.eye(3), [[1, 1, 0], [0.3, -0.2, 0.1]]])
    for points in (np.eye(3)[:1], cloud("on a grid"), cloud("on a grid") - 0.3, cloud("three hundred")):
        rows = nearest(build_index(points), p, q)
        assert (rows >= 0).all()
        found, exact = np.linalg.norm(points[rows], axis=1), np.linalg.norm(points, axis=1).min()
        np.testing.assert_allclose(found, exact, rtol=0, atol=2 * length + EPS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_the_nearest_point_of_the_duct_is_the_nearest_of_all_100_000_times(seed):
    check(cloud("duct"), 10_000, seed=10 + seed)


def test_the_order_of_the_points_changes_no_distance():
    points = cloud("three hundred")
    p, q = segments(points, 160, seed=3)
    turned = points[::-1].copy()
    rows, mirrored = nearest(build_index(points), p, q), nearest(build_index(turned), p, q)
    np.testing.assert_array_equal(points[rows], turned[mirrored])


@pytest.mark.parametrize("name", ["three hundred", "each five times", "duct"])
def test_within_a_limit_a_point_is_found_and_beyond_it_none(name):
    points = cloud(name)
    p, q = segments(points, 400, seed=4)
    exact = smallest_distances(p, q, points)
    factor = np.tile([0.0, 0.5, 1 - 1e-9, 1 + 1e-9, 1.001, 3.0, 1e3, 1e9], 50)
    limit = factor * exact
    rows = np.asarray(bodies_within(build_index(points), p[:, None], q[:, None], limit[:, None]).row)
    inside = (factor > 1) & (exact > 1e-12)
    apart = exact > 1e-12  # for touching segments only rounding decides
    np.testing.assert_array_equal((rows >= 0)[apart], inside[apart])
    found = np.linalg.norm(points[rows] - closest_points(p, q, points[rows]), axis=1)
    assert (found[inside] <= limit[inside] + 16 * EPS).all()


def closest_points(p, q, points):
    d = q - p
    square = np.sum(d * d, axis=1)
    s = np.clip(np.sum((points - p) * d, axis=1) / np.where(square > 0, square, 1.0), 0, 1)
    return p + s[:, None] * d


def test_a_batch_of_searches_equals_one_after_the_other():
    index = build_index(cloud("three hundred"))
    p, q = (a.reshape(20, LANES, 3) for a in segments(cloud("three hundred"), 20 * LANES, seed=6))
    together = made_once.quick_jit(jax.vmap(nearest_rows, in_axes=(None, 0, 0)))(index, p, q)
    np.testing.assert_array_equal(np.ravel(together), nearest(index, p.reshape(-1, 3), q.reshape(-1, 3)))


@made_once.quick_jit
def nearest_bodies(index, p, q, radius):
    return jax.lax.map(lambda s: nearest_body(index, *s), (p, q, radius))


@made_once.quick_jit
def bodies_within(index, p, q, reach):
    return jax.lax.map(lambda s: body_within(index, *s), (p, q, reach))


@pytest.mark.parametrize("name", ["one", "four", "three hundred", "far apart", "duct"])
def test_the_nearest_body_is_the_one_with_the_smallest_distance_less_its_radius(name):
    """One search for all bodies with any radii; a pair is found within the radii if there is one."""
    points, count = cloud(name), 100
    p, q = (a.reshape(count, LANES, 3) for a in segments(points, count * LANES, seed=7))
    radius = np.random.default_rng(8).choice([0.0, 0.03, 0.4], (count, LANES))
    exact = smallest_distances(p.reshape(-1, 3), q.reshape(-1, 3), points).reshape(count, LANES) - radius
    index = build_index(points)

    body, row = nearest_bodies(index, p, q, radius)
    mine = np.arange(count), np.asarray(body)
    found = np.linalg.norm(closest_points(p[mine], q[mine], points[row]) - points[row], axis=1) - radius[mine]
    scale = np.maximum(1.0, np.abs(np.concatenate([p, q], axis=1)).max((1, 2)))
    assert (np.abs(found - exact.min(1)) <= 16 * EPS * scale).all()
    assert (exact.min(1) < -0.02).any() or name == "one"

    # All radii changed by the same amount, so that the smallest distance is just below or just above the limit.
    short = np.tile([1e-9, -1e-9, 0.1, -0.1], count // 4)
    reach = radius + (exact.min(1) + short)[:, None]
    body, row = map(np.asarray, bodies_within(index, p, q, reach))
    np.testing.assert_array_equal(row >= 0, short > 0)
    np.testing.assert_array_equal(body >= 0, short > 0)
    mine, row = (np.flatnonzero(short > 0), body[short > 0]), row[short > 0]
    found = np.linalg.norm(closest_points(p[mine], q[mine], points[row]) - points[row], axis=1)
    assert (found <= reach[mine] + 16 * EPS * scale[mine[0]]).all()


def test_the_only_body_near_the_cloud_is_found_among_any_number_of_bodies():
    """Regression: bodies from number 32 on were not searched, as their bits were lost."""
    index, count = build_index(cloud("three hundred")), 40
    p, q = segments(cloud("three hundred"), count, seed=9)
    reach = np.full(count, -1.0)
    reach[35] = 10.0
    (body,), (row,) = bodies_within(index, p[None], q[None], reach[None])
    assert body == 35 and row >= 0


def test_no_gradient_passes_through_the_search():
    index, points, p = build_index(cloud("four")), cloud("four"), segments(cloud("four"), LANES, seed=8)[0]

    def square(p):
        row = nearest_rows(index, p, p + 0.1)
        return jnp.sum((p - jnp.asarray(points)[row]) ** 2)

    expected = 2 * (p - points[nearest(index, p, p + 0.1)])
    for gradient in made_once.quick_jit(lambda p: (jax.jacrev(square)(p), jax.jacfwd(square)(p)))(p):
        np.testing.assert_allclose(gradient, expected, atol=1e-14)


@pytest.mark.skipif(triton() is None, reason="this JAX has no Triton backend of Pallas")
@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("name", ["one", "three hundred", "on a plane", "far apart"])
def test_the_kernel_for_gpus_finds_the_same_leaves(name, shared):
    """Compare the GPU kernel, interpreted: both searches end at a leaf with a point as near as the nearest one."""
    rng = np.random.default_rng(0)
    index, radius = build_index(cloud(name)), rng.uniform(0, 0.1, LANES)
    p, q = (a.reshape(-1, LANES, 3) for a in segments(cloud(name), 5 * LANES, seed=5))
    limit = np.where(rng.random((5, LANES)) < 0.7, 1e150, 0.01)
    limit = np.broadcast_to(limit[:, :1], limit.shape) if shared else limit
    search = made_once.quick_jit(jax.vmap(lambda p, q, limit: nearest_leaves(index, p, q, radius, limit, shared)))
    with compiled_for(Backend("gpu", has_kernels=True, interprets=True)):
        leaves = np.asarray(search(p, q, limit))
    clearance = smallest_distances(p.reshape(-1, 3), q.reshape(-1, 3), cloud(name)).reshape(-1, LANES) - radius
    expected = clearance < limit
    if shared:
        expected &= np.arange(LANES) == clearance.argmin(1)[:, None]
    np.testing.assert_array_equal(leaves >= 0, expected)
    for lane, body in zip(*np.nonzero(expected), strict=True):
        points = np.asarray(index.points)[leaves[lane, body]].T
        found = distances(p[lane, [body]], q[lane, [body]], points).min() - radius[body]
        assert found - clearance[lane, body] <= 4 * EPS * max(1.0, np.abs(p[lane]).max(), np.abs(q[lane]).max())
