"""Distances between capsules and the solids of a cell: equal to MuJoCo's, with correct contacts and gradients."""

import threading
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
from made_once import prove
from published import MODELS, path_of

from benchmarks import cell_distances
from htcp_jax.clearance import Scene, clearances, contacts, is_clear, rows_of
from htcp_jax.clearance.obstacles.contact_model import hold_contacts, predict_distances
from htcp_jax.clearance.obstacles.fixtures import Fixtures
from htcp_jax.clearance.obstacles.obstacles import clearance_rows
from htcp_jax.clearance.obstacles.of_cell import make_fixtures, solid_of
from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.io.cell import load_cell
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.model.kinematics import capsule_segments
from htcp_jax.pytree import without_labels
from htcp_jax.spec import GP50

POSE = 'pos="0.1 -0.2 0.3" euler="20 30 40"'
WEDGE = "0 0 0  0.3 0 0  0 0.2 0  0 0 0.4  0.2 0.15 0.1  0.1 0.1 0.35"
SHAPES = {  # with the tolerance relative to MuJoCo
    "plane": (f'<geom name="it" type="plane" size="1 1 1" {POSE}/>', 1e-9),
    "sphere": (f'<geom name="it" type="sphere" size="0.2" {POSE}/>', 1e-9),
    "capsule": (f'<geom name="it" type="capsule" size="0.1 0.3" {POSE}/>', 1e-9),
    "box": (f'<geom name="it" type="box" size="0.1 0.3 0.2" {POSE}/>', 1e-6),
    "cylinder": (f'<geom name="it" type="cylinder" size="0.15 0.3" {POSE}/>', 1e-6),
    "mesh": (f'<geom name="it" type="mesh" mesh="wedge" {POSE}/>', 1e-6),
}
KINDS = tuple(SHAPES)
BOX = " ".join(f"{x} {y} {z}" for x in (-0.1, 0.1) for y in (-0.3, 0.3) for z in (-0.2, 0.2))


def cell_of(kind: str, folder):
    file = folder / "cell.xml"
    asset = f'<asset><mesh name="wedge" vertex="{BOX if kind == "box as mesh" else WEDGE}"/></asset>'
    geom = SHAPES["mesh" if kind == "box as mesh" else kind][0]
    file.write_text(f"<mujoco>{asset}<worldbody>{geom}</worldbody></mujoco>")
    return file


def segments(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ends (count, 3) and radii of random segments around the solid, from short to long."""
    rng = np.random.default_rng(seed)
    p = rng.uniform(-0.7, 0.9, (count, 3))
    q = p + rng.normal(size=(count, 3)) * rng.choice([0.02, 0.2, 0.5], (count, 1))
    return p, q, rng.choice([0.01, 0.05, 0.2], count)


def by_mujoco(file, p, q, radius) -> np.ndarray:
    """Signed distances of free capsules to the geom `it`."""
    spec = mujoco.MjSpec.from_file(str(file))
    body = spec.worldbody.add_body(name="probe", mocap=True)
    body.add_geom(name="probe", type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[0.1, 0.1, 0])
    spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-10, 500
    model = spec.compile()
    data, probe, it = mujoco.MjData(model), model.geom("probe").id, model.geom("it").id
    found, turn = np.empty(len(p)), np.empty(4)
    for k in range(len(p)):
        along = q[k] - p[k]
        length = np.linalg.norm(along)
        mujoco.mju_quatZ2Vec(turn, along / length)
        data.mocap_pos[0], data.mocap_quat[0] = (p[k] + q[k]) / 2, turn
        model.geom_size[probe, :2] = radius[k], length / 2
        model.geom_rbound[probe] = radius[k] + length / 2
        mujoco.mj_kinematics(model, data)
        found[k] = mujoco.mj_geomDistance(model, data, probe, it, 100.0, None)
    return found


def seen(kind: str, folder, p, q):
    solid = jax.tree.map(jnp.asarray, solid_of(load_cell(cell_of(kind, folder))[0]))
    return each_seen(solid, p, q)


@made_once.quick_jit
def each_seen(solid, p, q):
    return jax.vmap(solid.contact)(p, q)


def compare(kind: str, folder, count: int) -> None:
    p, q, radius = segments(count)
    ours = np.asarray(seen(kind, folder, p, q).distance) - radius
    theirs = by_mujoco(cell_of(kind, folder), p, q, radius)
    inside = ours < -radius - 1e-9  # the axis itself is partly inside
    assert inside.sum() > 0.005 * count and (~inside).sum() > 0.2 * count
    if kind == "box":  # MuJoCo's capsule-box routine is unreliable where the axis crosses the box
        theirs[inside] = by_mujoco(cell_of("box as mesh", folder), p, q, radius)[inside]
    np.testing.assert_allclose(ours, theirs, atol=SHAPES[kind][1])


@pytest.mark.parametrize("kind", KINDS)
def test_the_distance_of_a_capsule_is_mujocos(kind, tmp_path):
    compare(kind, tmp_path, 500)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_ten_thousand_distances_are_mujocos(kind, tmp_path):
    compare(kind, tmp_path, 10_000)


def crossing(kind: str, folder, count: int) -> tuple:
    """Segments that cross a solid or lie in it, and their contacts.

    Some pass near its middle, some are parallel to axes, some are points.
    """
    shape, rng = load_cell(cell_of(kind, folder))[0], np.random.default_rng(1)
    p = rng.uniform(-0.25, 0.25, (count, 3)) * rng.choice([0.02, 1], (count, 1))
    q = p + rng.normal(size=(count, 3)) * rng.choice([0.003, 0.1, 0.5], (count, 1))
    q[::9, 2], q[1::9, :2], q[2::9] = p[::9, 2], p[1::9, :2], p[2::9]
    R, t = shape.T_world[:3, :3], shape.triangles.mean(axis=(0, 1)) if kind == "mesh" else shape.T_world[:3, 3]
    p, q = (x * (0.3 if kind == "mesh" else 1) @ R.T + t for x in (p, q))
    found = jax.tree.map(np.asarray, seen(kind, folder, p, q))
    assert found.plane.mean() > 0.4
    return p, q, found, shape


def outermost(shape, normals: np.ndarray) -> np.ndarray:
    """Support function h(n) of a solid along directions, world."""
    if shape.kind == "mesh":
        return (normals @ shape.triangles.reshape(-1, 3).T).max(axis=-1)
    own, size = normals @ shape.T_world[:3, :3], shape.size
    if shape.kind == "box":
        reach = np.abs(own) @ size
    else:
        reach = size[0] * np.hypot(own[..., 0], own[..., 1]) + size[1] * np.abs(own[..., 2])
    return reach + normals @ shape.T_world[:3, 3]


@pytest.mark.parametrize("kind", ["box", "cylinder", "mesh"])
def test_of_a_segment_that_crosses_no_other_normal_is_better(kind, tmp_path):
    """Check that the depth along the returned normal is optimal.

    None of 2,000 other directions, nor ever closer ones around the best of them, gives a better one.
    """
    rng = np.random.default_rng(4)
    sphere = rng.normal(size=(2000, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    p, q, found, shape = crossing(kind, tmp_path, 200)
    p, q, found = jax.tree.map(lambda leaf: leaf[found.plane], (p, q, found))

    def depth(normals):  # (n, m, 3)
        ends = np.minimum(np.einsum("nmi,ni->nm", normals, p), np.einsum("nmi,ni->nm", normals, q))
        return ends - outermost(shape, normals)

    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(depth(found.normal[:, None])[:, 0], found.distance, atol=1e-12)
    tried = np.broadcast_to(sphere, (len(p), *sphere.shape))
    for closer in (0.1, 0.03, 0.01, 3e-3, 1e-3, 1e-4, 1e-5):
        each = depth(tried)
        assert (each.max(axis=1) <= found.distance + 1e-12).all()
        best = np.take_along_axis(tried, each.argmax(axis=1)[:, None, None], axis=1)
        tried = best + closer * rng.normal(size=(len(p), 200, 3)) * rng.choice([0, 1], (len(p), 200, 1))
        tried = tried / np.linalg.norm(tried, axis=2, keepdims=True)
    assert np.quantile(found.distance - depth(tried).max(axis=1), 0.5) < 1e-3  # the search around it is fine enough


@pytest.mark.parametrize("kind", ["box", "cylinder", "mesh"])
def test_of_a_segment_that_crosses_the_depth_changes_where_it_is_said_to_be_held(kind, tmp_path):
    """Check by finite differences: an end that moves changes the depth in proportion to its share of the contact."""
    p, q, found, _ = crossing(kind, tmp_path, 200)
    rng, h = np.random.default_rng(0), 1e-7
    dp, dq = rng.normal(size=(2, *p.shape))
    ahead, behind = (seen(kind, tmp_path, p + s * dp, q + s * dq) for s in (h, -h))
    slope = np.asarray(ahead.distance - behind.distance) / (2 * h)
    moved = (1 - found.t)[:, None] * dp + found.t[:, None] * dq
    lasts = np.abs(np.column_stack([ahead.normal - behind.normal, ahead.t - behind.t])).max(axis=1) < 1e-3
    lasts &= found.plane  # excludes two equally good normals or places
    assert lasts.sum() > 50 and (lasts & (found.t > 0) & (found.t < 1)).sum() > 10
    np.testing.assert_allclose(np.sum(found.normal * moved, axis=1)[lasts], slope[lasts], atol=1e-5)


def test_segments_along_faces_and_edges_and_points_are_measured_too(tmp_path):
    """Compare degenerate segments with 51 points on each: no closed form divides by zero."""
    rng = np.random.default_rng(2)
    for kind in ("box", "cylinder", "mesh"):
        T = load_cell(cell_of(kind, tmp_path))[0].T_world
        p = rng.integers(-2, 3, (200, 3)) * np.array([0.1, 0.15, 0.2])
        q = p + rng.integers(-1, 2, (200, 3)) * 0.3
        p, q = (x @ T[:3, :3].T + T[:3, 3] for x in (p, q))
        found = seen(kind, tmp_path, p, q)
        assert all(np.isfinite(leaf).all() for leaf in found)
        places = p[:, None] + np.linspace(0, 1, 51)[:, None] * (q - p)[:, None]
        each = np.asarray(seen(kind, tmp_path, *2 * [places.reshape(-1, 3)]).distance).reshape(200, 51).min(axis=1)
        clear = np.asarray(found.distance) > 1e-9
        assert (found.distance <= each + 1e-12).all() and clear.sum() > 50
        np.testing.assert_allclose(found.distance[clear], each[clear], atol=1e-3)


def compare_arm(file, folder, count: int) -> None:
    """Compare a complete arm with MuJoCo, by the benchmark that does so at more configurations."""
    for row in cell_distances.compare(file, folder, count):
        assert row.off_m <= (1e-6 if row.kind in ("box", "cylinder", "piece") else 1e-9)
        assert row.others == 0 < row.touching < row.count


def test_an_arm_is_as_far_from_a_cell_and_itself_as_mujoco_says(tmp_path):
    compare_arm(GP50, tmp_path, 100)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "fetch", "ur5e"])
def test_published_arms_are_as_far_from_a_cell_and_themselves_as_mujoco_says(name, tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(arm_xml(import_robot(path_of(name), MODELS[name].tcp), name))
    compare_arm(file, tmp_path, 1000)
    ring = cell_distances.compare_ring(file, tmp_path, 50)
    assert ring.wrong == 0 and ring.above_m <= 1e-9 and ring.below_m < 0.02


ROWS = 100  # configurations per call, in all tests


@cache
def everything() -> Fixtures:
    """All shapes, in several sizes, next to the default arm."""
    geoms = "".join(
        geom.replace('"it"', f'"{kind}"').replace(POSE, f'pos="{np.cos(k)} {np.sin(k)} 1.1" euler="20 30 40"')
        for k, (kind, (geom, _)) in enumerate(SHAPES.items())
    )
    more = '<geom type="mesh" mesh="tent" pos="1.6 -0.4 -1"/><geom type="mesh" mesh="wedge" pos="-1.5 0.4 1"/>'
    asset = f'<mesh name="wedge" vertex="{WEDGE}"/><mesh name="tent" vertex="0 0 0 1 0 0 0 1 0 0 0 1"/>'
    geoms = geoms.replace('pos="1.0 0.0 1.1" euler="20 30 40"', 'pos="0 0 -1.3"')  # the plane's
    with TemporaryDirectory() as folder:
        file = Path(folder) / "cell.xml"
        file.write_text(f"<mujoco><asset>{asset}</asset><worldbody>{geoms}{more}</worldbody></mujoco>")
        (found,) = make_fixtures(made_once.robot(), load_cell(file))
    return found


def to_each(robot, obstacles, where, x):
    """Distances of every capsule to every solid."""
    return obstacles[0].distances(robot, *capsule_segments(robot, x))


def through(robot, obstacles, where, x):
    """Gradients without the rule for the derivative."""
    return jax.jacfwd(lambda x: contacts(robot, obstacles, where, x).distance)(x)


@cache
def answered() -> list:
    """Configurations and answers to all queries there: the first 25 are random, and so are the other 6."""
    robot = made_once.robot()
    x = np.concatenate([made_once.configurations(robot, 25), made_once.configurations(robot, 6, seed=3)])
    queries = clearances, is_clear, to_each, clearance_rows, contacts, through
    return [x, *(answer(query, x) for query in queries)]  # one program for all compiles longer


def answer(query, x):
    """Answer to a query next to everything, at every x."""
    jit = jax.jit if query in (clearances, is_clear) else made_once.quick_jit  # others: only a few configurations
    return made_once.in_rows(query, ROWS, jit)((made_once.robot(), (everything(),), made_once.nominal()), x)


def test_of_many_solids_the_nearest_decides_whatever_is_searched_first():
    robot, own = made_once.robot(), everything()
    assert len(own.names) - own.names.count("") == 8 and own.pieces is not None  # "" is a row of padding
    touching = 0
    for x, found, clear, each, *_ in zip(*(leaf[:25] for leaf in answered()[:4]), strict=True):
        every = np.where(own.is_checked, each, np.inf)
        expected = every.min(axis=0)
        np.testing.assert_allclose(found, expected, atol=1e-14)
        assert clear == (expected.min() > 0)
        touching += int(expected.min() <= 0)
        row = int(expected.argmin())
        nearest = own.names[every[:, row].argmin()]
        assert made_once.nearest_name(robot, own, row, x) == f"the fixture {nearest!r}"
    assert 3 < touching < 22


def boxes(folder, robot, *x) -> Fixtures:
    """A floor, and boxes at several places."""
    file = folder / "boxes.xml"
    geoms = "".join(f'<geom name="box {k}" type="box" size="0.1 0.2 0.3" pos="{at} 2 0"/>' for k, at in enumerate(x))
    floor = '<geom name="floor" type="plane" size="1 1 1" pos="0 0 -2"/>'
    file.write_text(f"<mujoco><worldbody>{floor}{geoms}</worldbody></mujoco>")
    (found,) = make_fixtures(robot, load_cell(file))
    return found


def test_another_cell_of_the_same_kinds_has_the_shapes_of_the_first_so_that_it_compiles_nothing(tmp_path):
    def shapes(*x):
        leaves, structure = jax.tree.flatten(without_labels(boxes(tmp_path, made_once.robot(), *x)))
        return structure, [(leaf.shape, leaf.dtype) for leaf in leaves]

    assert shapes(1.0) == shapes(-1.0, 0.0, 1.0, 2.0) != shapes(*range(5))


def test_the_fixtures_of_another_arm_compile_nothing(tmp_path):
    boxes(tmp_path, made_once.robot(), 1.0)
    compiled, thread = [], threading.get_ident()

    def note(event: str, duration_s: float, **about) -> None:
        if "backend_compile" in event and threading.get_ident() == thread:
            compiled.append(about)

    jax.monitoring.register_event_duration_secs_listener(note)
    try:
        found = boxes(tmp_path, made_once.seven_joints(tmp_path), 1.0, 2.0, 3.0)
    finally:
        jax.monitoring.unregister_event_duration_listener(note)
    assert list(filter(None, found.names)) == ["floor", "box 0", "box 1", "box 2"] and not compiled


def test_gradients_and_what_is_held_are_those_of_the_distance():
    """Compare gradients with finite differences where the nearest point stays the same.

    A fixed contact never predicts less than the true distance, except for planes.
    """
    robot, rows, rng = made_once.robot(), rows_of(made_once.robot(), (everything(),)), np.random.default_rng(0)
    x, _, _, _, found, touches, by_autodiff = jax.tree.map(lambda leaf: leaf[25:], answered())
    np.testing.assert_allclose(by_autodiff, found.gradient, atol=1e-9)
    near = x + np.stack([rng.uniform(-0.1, 0.1, 6) for _ in x])
    steps = 1e-6 * np.concatenate([np.eye(6), -np.eye(6)])
    around = answer(clearances, np.concatenate([near, (x[:, None] + steps).reshape(-1, 6)]))
    ahead, behind = around[6:].reshape(6, 2, 6, -1).transpose(1, 0, 3, 2)
    assert (np.abs((ahead - behind) / 2e-6 - found.gradient) > 1e-4).any(axis=2).sum() <= 4

    @made_once.quick_jit
    def predicted(x, near, touch):
        held = hold_contacts(robot, x, rows, touch)
        return [predict_distances(robot, place, rows, held)[0] for place in (x, near)]

    for k in range(6):
        touch = jax.tree.map(lambda leaf, k=k: leaf[k], touches)
        here, there = predicted(x[k], near[k], jax.tree.map(jnp.asarray, touch))
        np.testing.assert_allclose(here, touch.distance, atol=1e-12)
        assert (np.asarray(there) >= around[k] - 1e-12)[~touch.plane].all()


def test_joint_paths_next_to_solids_are_proven_and_refuted_as_they_are():
    robot, rng = made_once.robot(), np.random.default_rng(1)
    a = made_once.configurations(robot, 24)
    b = a + np.stack([rng.uniform(-0.3, 0.3, 6) for _ in a])
    places = (a[:, None] + np.linspace(0, 1, 51)[:, None] * (b - a)[:, None]).reshape(-1, 6)
    scene, where = Scene(robot, (everything(),)), made_once.nominal()
    found = made_once.quick_jit(lambda *scene: jax.lax.map(lambda path: prove(*scene, *path, kept=0.5), (a, b)))(
        scene, where
    )
    truth = answer(clearances, places).reshape(24, -1).min(axis=1)
    at_place = answer(clearances, a + np.asarray(found.place)[:, None] * (b - a)).min(axis=1)
    valid, colliding = (np.asarray(found.verdict) == each for each in (PathVerdict.VALID, PathVerdict.IN_COLLISION))
    assert (truth >= np.asarray(found.clearance) - 1e-9)[valid].all() and (truth > 0)[valid].all()
    assert (np.asarray(found.clearance) > 1e-9)[valid].all()
    assert (at_place <= 0)[colliding].all()
    np.testing.assert_array_equal(answer(is_clear, places).reshape(24, -1).all(axis=1), truth > 0)
    assert valid.sum() >= 3 and colliding.sum() >= 3
