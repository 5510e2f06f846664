"""Distances of convex pieces: a plain reference's, FCL's and MuJoCo's, with correct contacts and gradients."""

from functools import cache
from itertools import product

import fcl
import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
from made_once import quick_jit
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from trimesh.triangles import closest_point

from htcp_jax.clearance.distance.convex_pieces import (
    Body,
    PieceContact,
    PlacedPiece,
    face_contact,
    piece_contact,
)
from htcp_jax.clearance.distance.segments import nearest_points
from htcp_jax.clearance.distance.solids import Box, Cylinder, HalfSpace, Rod
from htcp_jax.model import ConvexPiece, kinematics
from htcp_jax.model.convex_piece import body_pieces, make_piece, stack_pieces

HALF = np.array([3.0, 5.0, 8.0]) / 64
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
COUNT = 100  # of rows, in all tests: one compiled function per kind of body
RADIUS, LENGTH = 0.06, 0.1  # of a capsule and a cylinder; half of its length
SOLIDS = ("capsule", "sphere", "solid box", "cylinder", "half-space")


def shapes() -> dict[str, np.ndarray]:
    """Points of pieces, from solid ones to a single point; exact in 32 bits, as MuJoCo's meshes are."""
    rng = np.random.default_rng(0)
    found = {
        "blob": rng.normal(size=(24, 3)) * [0.1, 0.06, 0.12],
        "tetrahedron": rng.normal(size=(4, 3)) * 0.1,
        "box": CORNERS * HALF,
        "triangle": rng.normal(size=(3, 3)) * 0.1,
        "polygon": np.column_stack([rng.normal(size=(9, 2)) * 0.1, np.zeros(9)]),
        "segment": rng.normal(size=(2, 3)) * 0.1,
        "point": np.full((1, 3), 0.02),
    }
    return {name: points.astype(np.float32).astype(float) for name, points in found.items()}


@cache
def pieces() -> dict[str, ConvexPiece]:
    stacked = stack_pieces([make_piece(points) for points in shapes().values()])
    return {name: jax.tree.map(lambda leaf, k=k: jnp.asarray(leaf[k]), stacked) for k, name in enumerate(shapes())}


def poses(count: int, seed: int, spread: float) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.random(count, rng=rng).as_matrix(), rng.uniform(-spread, spread, (count, 3))
    return T


def placed(points: np.ndarray, T: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]


def bodies(kind: str, T: np.ndarray) -> Body:
    """Return a solid of a cell, or the piece of that name, at every pose."""
    R, t, z = T[:, :3, :3], T[:, :3, 3], LENGTH * T[:, :3, 2]
    many = lambda value: np.tile(value, (len(T), *[1] * np.ndim(value)))  # noqa: E731
    if kind in pieces():
        return PlacedPiece(jax.tree.map(many, pieces()[kind]), T)
    if kind == "half-space":
        return HalfSpace(T[:, :3, 2], np.sum(T[:, :3, 2] * t, axis=1))
    if kind == "solid box":
        return Box(R, t, many(HALF))
    if kind == "cylinder":
        return Cylinder(R, t, many(RADIUS), many(LENGTH))
    return Rod(t - z, t + z, many(RADIUS)) if kind == "capsule" else Rod(t, t, many(RADIUS))


@quick_jit
def measured(piece: ConvexPiece, T, others: Body) -> PieceContact:
    return jax.lax.map(lambda row: piece_contact(PlacedPiece(piece, row[0]), row[1]), (T, others))


def heights(piece: ConvexPiece, T, points):
    """Heights of points over the planes that enclose a piece."""
    planes = body_pieces([jax.tree.map(np.asarray, piece)], np.zeros(1)).planes[0]
    own = np.einsum("nji,nj->ni", T[:, :3, :3], np.asarray(points) - T[:, :3, 3])
    return np.max(own @ planes[:, :3].T - planes[:, 3], axis=1)


def contacts(name: str, kind: str, T: np.ndarray, U: np.ndarray) -> PieceContact:
    return jax.tree.map(np.asarray, measured(pieces()[name], T, bodies(kind, U)))


def reference(a: np.ndarray, b: np.ndarray) -> float:
    """Signed distance of the hulls of two sets of points: of the origin from the hull of all differences."""
    differences = (a[:, None] - b[None]).reshape(-1, 3)
    hull = ConvexHull(differences)
    if (height := hull.equations[:, 3].max()) <= 0:
        return height
    triangles = differences[hull.simplices]
    return np.linalg.norm(closest_point(triangles, np.zeros((len(triangles), 3))), axis=1).min()


def by_fcl(name: str, kind: str, T: np.ndarray, U: np.ndarray) -> np.ndarray:
    """Distances of bodies that are apart; -1 of others."""

    def geometry(kind):
        solids = {"capsule": fcl.Capsule(RADIUS, 2 * LENGTH), "cylinder": fcl.Cylinder(RADIUS, 2 * LENGTH)}
        solids |= {"sphere": fcl.Sphere(RADIUS), "solid box": fcl.Box(*2 * HALF)}
        if kind in solids:
            return solids[kind]
        points = shapes()[kind]
        hull = ConvexHull(points)
        corners = points[hull.simplices]
        turned = np.sum(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * hull.equations[:, :3], 1
        )
        faces = np.where(turned[:, None] < 0, hull.simplices[:, ::-1], hull.simplices)
        return fcl.Convex(points, len(faces), np.insert(faces, 0, 3, axis=1).astype(np.int32).ravel())

    one, other = geometry(name), geometry(kind)
    moved = lambda T: fcl.Transform(T[:3, :3], T[:3, 3])  # noqa: E731
    return np.array(
        [
            fcl.distance(fcl.CollisionObject(one, moved(a)), fcl.CollisionObject(other, moved(b)))
            for a, b in zip(T, U, strict=True)
        ]
    )


def by_mujoco(name: str, kind: str, T: np.ndarray, U: np.ndarray) -> np.ndarray:
    """Signed distances; a box is a mesh, as MuJoCo's own routine is less exact."""
    spec, shape = mujoco.MjSpec(), mujoco.mjtGeom
    spec.option.ccd_tolerance, spec.option.ccd_iterations = 1e-12, 500
    types = {"capsule": shape.mjGEOM_CAPSULE, "sphere": shape.mjGEOM_SPHERE, "cylinder": shape.mjGEOM_CYLINDER}
    for number, own in enumerate((name, "box" if kind == "solid box" else kind)):
        holder = spec.worldbody.add_body(mocap=True)
        if own in types:
            holder.add_geom(type=types[own], size=[RADIUS, LENGTH, 0])
        else:
            mesh = spec.add_mesh(name=f"{number}")
            mesh.uservert = shapes()[own].ravel()
            holder.add_geom(type=shape.mjGEOM_MESH, meshname=mesh.name)
    model = spec.compile()
    data, found = mujoco.MjData(model), []
    for pair in zip(T, U, strict=True):
        for number, pose in enumerate(pair):
            data.mocap_pos[number] = pose[:3, 3]
            mujoco.mju_mat2Quat(data.mocap_quat[number], pose[:3, :3].ravel())
        mujoco.mj_kinematics(model, data)
        found.append(mujoco.mj_geomDistance(model, data, 0, 1, 10.0, None))
    return np.array(found)


def compare(kind: str, count: int) -> None:
    T, U = poses(count, 1, 0.15), poses(count, 2, 0.15)
    ours = contacts("blob", kind, T, U).distance
    assert (ours < -0.03).sum() > 0.05 * count < (ours > 0.03).sum()
    np.testing.assert_allclose(ours, by_mujoco("blob", kind, T, U), atol=1e-7)
    apart, theirs = ours > 1e-6, by_fcl("blob", kind, T, U)
    above = theirs[apart] - ours[apart]  # FCL's nearest points are not always quite the nearest
    assert (above > -1e-9).all() and (above < 0.01).all()
    assert kind in ("capsule", "sphere", "cylinder") or np.mean(above < 1e-9) > 0.995


@pytest.mark.parametrize("kind", ["capsule", "sphere", "solid box", "cylinder", "tetrahedron", "blob"])
def test_the_distance_of_a_piece_is_mujocos_and_fcls(kind):
    compare(kind, COUNT)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["capsule", "sphere", "solid box", "cylinder", "tetrahedron", "blob"])
def test_ten_thousand_distances_are_mujocos_and_fcls(kind):
    compare(kind, 10_000)


@pytest.mark.parametrize("kind", list(shapes()))
def test_the_distance_of_two_pieces_is_that_of_the_origin_from_their_differences(kind):
    for name in ("blob", "box"):
        T, U = poses(COUNT, 3, 0.12), poses(COUNT, 4, 0.12)
        found = contacts(name, kind, T, U).distance
        expected = [reference(placed(shapes()[name], a), placed(shapes()[kind], b)) for a, b in zip(T, U, strict=True)]
        assert 5 < np.sum(found < 0) < 95
        np.testing.assert_allclose(found, expected, atol=1e-10)


def test_flat_pieces_are_measured_too():
    T, U = poses(COUNT, 5, 0.1), poses(COUNT, 6, 0.1)
    for name, kind in product(("triangle", "polygon"), ("triangle", "polygon", "segment")):
        expected = [reference(placed(shapes()[name], a), placed(shapes()[kind], b)) for a, b in zip(T, U, strict=True)]
        np.testing.assert_allclose(contacts(name, kind, T, U).distance, expected, atol=1e-10)
    ends = np.concatenate([[placed(shapes()["segment"], pose).ravel() for pose in own] for own in (T, U)], axis=0)
    p, q, r, s = (ends[own, part] for own in (slice(COUNT), slice(COUNT, None)) for part in (slice(3), slice(3, 6)))
    expected = nearest_points(*map(jnp.asarray, (p, q, r, s)))
    found = contacts("segment", "segment", T, U).distance
    np.testing.assert_allclose(found, np.linalg.norm(expected.on_first - expected.on_second, axis=1), atol=1e-10)
    points = np.array([placed(shapes()["point"], pose)[0] for pose in U])
    triangles = np.array([placed(shapes()["triangle"], pose) for pose in T])
    expected = np.linalg.norm(closest_point(triangles, points) - points, axis=1)
    np.testing.assert_allclose(contacts("triangle", "point", T, U).distance, expected, atol=1e-10)
    expected = np.linalg.norm(T[:, :3, :3] @ shapes()["point"][0] + T[:, :3, 3] - points, axis=1)
    np.testing.assert_allclose(contacts("point", "point", T, U).distance, expected, atol=1e-10)


def outermost(kind: str, T: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """Support function of a body at each pose along each normal."""
    own = np.einsum("nji,nj->ni", T[:, :3, :3], normal)
    if kind in shapes():
        extent = (own @ shapes()[kind].T).max(axis=1)
    elif kind == "solid box":
        extent = np.abs(own) @ HALF
    elif kind == "cylinder":
        extent = RADIUS * np.hypot(own[:, 0], own[:, 1]) + LENGTH * np.abs(own[:, 2])
    elif kind == "half-space":
        extent = np.where(own[:, 2] > 1 - 1e-12, 0.0, np.inf)
    else:
        extent = RADIUS + LENGTH * np.abs(own[:, 2]) * (kind == "capsule")
    return extent + np.sum(normal * T[:, :3, 3], axis=1)


@pytest.mark.parametrize("kind", [*SOLIDS, *shapes()])
def test_every_distance_is_proven_by_its_normal_and_points(kind):
    """Check both bounds: planes along the normal are that far apart, and so are points of both bodies."""
    T, U = poses(COUNT, 7, 0.15), poses(COUNT, 8, 0.15)
    for name in ("blob", "polygon"):
        d, n, point, witness = contacts(name, kind, T, U)
        np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1, atol=1e-12)
        np.testing.assert_allclose(-outermost(name, T, -n) - outermost(kind, U, n), d, atol=1e-12)
        np.testing.assert_allclose(point - witness, d[:, None] * n, atol=1e-12)
        assert (heights(pieces()[name], T, point) < 1e-9).all()
        assert kind not in shapes() or (heights(pieces()[kind], U, witness) < 1e-9).all()


def test_bodies_that_touch_and_parallel_faces_are_exact():
    gaps = np.array([1.0, 1e-3, 1e-6, 1e-8, 1e-9, 1e-10, 1e-13, 0, -1e-13, -1e-10, -1e-9, -1e-8, -1e-6, -1e-3, -0.04])
    gaps = np.resize(gaps, COUNT)
    ways = {  # rotation of the second box, and the offset at which both touch
        "faces": (np.eye(3), [2 * HALF[0], 0.01, 0.02]),
        "faces, edges in line": (np.eye(3), [2 * HALF[0], 0, 0]),
        "a face and an edge": (
            Rotation.from_euler("z", 45, degrees=True).as_matrix(),
            [HALF[0] + (HALF[0] + HALF[1]) / 2**0.5, 0, 0],
        ),
    }
    for R, touching in ways.values():
        T = np.tile(np.eye(4), (len(gaps), 1, 1))
        T[:, :3, :3], T[:, :3, 3] = R, touching
        T[:, 0, 3] += gaps
        for kind in ("box", "solid box"):
            found = contacts("box", kind, np.tile(np.eye(4), (len(gaps), 1, 1)), T)
            np.testing.assert_allclose(found.distance, gaps, atol=1e-11)
            np.testing.assert_allclose(found.normal[np.abs(gaps) > 1e-8, 0], -1, atol=1e-6)
            assert np.isfinite(found.normal).all() and np.isfinite(found.point).all()


def test_a_distance_changes_by_no_more_than_the_piece_moves():
    T, rng = poses(COUNT, 9, 0.15), np.random.default_rng(0)
    moved = T.copy()
    turn = Rotation.from_rotvec(rng.normal(size=(COUNT, 3)) * rng.choice([1e-6, 0.01, 0.3], (COUNT, 1))).as_matrix()
    moved[:, :3, :3] = turn @ T[:, :3, :3]
    moved[:, :3, 3] += rng.normal(size=(COUNT, 3)) * rng.choice([1e-7, 0.01, 0.1], (COUNT, 1))
    by = [
        np.linalg.norm(placed(shapes()["blob"], a) - placed(shapes()["blob"], b), axis=1).max()
        for a, b in zip(T, moved, strict=True)
    ]
    for kind in ("capsule", "solid box", "cylinder", "half-space", "tetrahedron", "polygon"):
        U = poses(COUNT, 10, 0.1)
        change = contacts("blob", kind, moved, U).distance - contacts("blob", kind, T, U).distance
        assert (np.abs(change) <= np.array(by) + 1e-12).all()


def turned(T, by):
    """Return poses moved by a small twist: rotation about the origin [rad] and translation [m]."""
    x, y, z = by[:3]
    zero = jnp.zeros_like(x)
    W = jnp.stack([jnp.stack([zero, -z, y]), jnp.stack([z, zero, -x]), jnp.stack([-y, x, zero])])
    return jnp.concatenate([T[:3] + jnp.concatenate([W @ T[:3, :3], (W @ T[:3, 3] + by[3:])[:, None]], 1), T[3:]])


@pytest.mark.parametrize("kind", ["capsule", "solid box", "cylinder", "half-space", "tetrahedron"])
def test_gradients_are_those_of_finite_differences(kind):
    """Check the slopes along twists of the piece and, where it can move, of the other body."""
    T, U = poses(COUNT, 11, 0.2), poses(COUNT, 12, 0.5 if kind == "half-space" else 0.2)
    both = [False] * 6 if kind in ("solid box", "cylinder", "half-space") else [False, True] * 6
    units = np.repeat(np.eye(6), len(both) // 6, axis=0)

    def distance(by, T, U, other, moves):
        if kind == "capsule":
            p, q = (jnp.where(moves, turned(jnp.eye(4), by)[:3, :3] @ end + by[3:], end) for end in (other.p, other.q))
            other = other._replace(p=p, q=q)
        elif kind == "tetrahedron":
            other = other._replace(T_world=jnp.where(moves, turned(U, by), U))
        return piece_contact(PlacedPiece(pieces()["blob"], jnp.where(moves, T, turned(T, by))), other).distance

    slope = quick_jit(
        lambda moves, *rows: jax.lax.map(lambda row: jax.jacfwd(distance)(jnp.zeros(6), *row, moves), rows)
    )
    compared = 0
    for unit, moves in zip(units, both, strict=True):
        ahead, behind = (
            contacts("blob", kind, *((T, moved(U, s * unit)) if moves else (moved(T, s * unit), U)))
            for s in (1e-6, -1e-6)
        )
        lasts = np.abs(ahead.normal - behind.normal).max(axis=1) < 1e-3  # not between two nearest places
        finite = (ahead.distance - behind.distance) / 2e-6
        ours = np.asarray(slope(moves, T, U, bodies(kind, U))) @ unit
        np.testing.assert_allclose(ours[lasts], finite[lasts], atol=1e-5)
        compared += np.mean(lasts[ahead.distance > 0]) + np.mean(lasts[ahead.distance < 0])
    assert compared > 1.8 * len(both)


def moved(T: np.ndarray, by: np.ndarray) -> np.ndarray:
    return np.asarray(jax.vmap(turned, in_axes=(0, None))(T, jnp.asarray(by)))


def test_a_gradient_in_the_configuration_is_that_of_finite_differences():
    """Check a piece on a link against one that moves with the link before."""
    robot = made_once.robot()
    x = made_once.configurations(robot, 24)
    links = jax.vmap(lambda x: kinematics.link_poses(robot, x))(x)
    held = jnp.asarray(np.linalg.inv(links[:, 3]) @ np.asarray(links[:, 4]) @ poses(24, 12, 0.2))

    def contact(x, T_link):
        T = kinematics.link_poses(robot, x)
        return piece_contact(PlacedPiece(pieces()["blob"], T[4]), PlacedPiece(pieces()["tetrahedron"], T[3] @ T_link))

    @quick_jit
    def values(x, held):
        return jax.lax.map(lambda row: jax.jacfwd(lambda x: (contact(x, row[1]),) * 2, has_aux=True)(row[0]), (x, held))

    ours, here = values(x, held)
    assert 3 < np.sum(here.distance < 0) < 22
    for joint, unit in enumerate(np.eye(x.shape[1])):
        ahead, behind = (values(x + s * unit, held)[1] for s in (1e-6, -1e-6))
        lasts = np.abs(np.asarray(ahead.normal - behind.normal)).max(axis=1) < 1e-3
        assert lasts.sum() > 18
        finite = np.asarray(ahead.distance - behind.distance) / 2e-6
        np.testing.assert_allclose(ours.distance[lasts, joint], finite[lasts], atol=1e-5)


def test_a_contact_by_faces_is_exact_apart_and_no_less_deep_where_pieces_overlap():
    T, U = poses(COUNT, 17, 0.2), poses(COUNT, 18, 0.2)
    by_faces = quick_jit(
        jax.vmap(lambda T, U: face_contact(PlacedPiece(pieces()["blob"], T), PlacedPiece(pieces()["tetrahedron"], U)))
    )
    found, exact = by_faces(T, U), contacts("blob", "tetrahedron", T, U)
    apart = exact.distance > 0
    assert 10 < apart.sum() < 90 and (found.distance[~apart] <= exact.distance[~apart] + 1e-12).all()
    np.testing.assert_allclose(found.distance[apart], exact.distance[apart], atol=1e-9)
    assert (np.sign(found.distance) == np.sign(exact.distance)).all()
    np.testing.assert_allclose(found.point - found.witness, found.distance[:, None] * found.normal, atol=1e-12)


def test_rows_do_not_affect_each_other():
    T, U = poses(COUNT, 13, 0.15), poses(COUNT, 14, 0.15)
    together = quick_jit(
        jax.vmap(lambda T, U: piece_contact(PlacedPiece(pieces()["blob"], T), PlacedPiece(pieces()["tetrahedron"], U)))
    )
    order = np.random.default_rng(0).permutation(COUNT)
    far = U.copy()
    far[1::2, :3, 3] += 5
    for leaf, shuffled, others in zip(together(T, U), together(T[order], U[order]), together(T, far), strict=True):
        np.testing.assert_array_equal(np.asarray(leaf)[order], shuffled)
        np.testing.assert_array_equal(leaf[::2], others[::2])


def test_a_radius_brings_a_piece_nearer_and_a_height_is_a_lower_bound():
    T, U = poses(COUNT, 15, 0.15), poses(COUNT, 16, 0.15)
    thick = pieces()["blob"]._replace(radius=jnp.asarray(0.01))
    for kind in ("capsule", "half-space", "tetrahedron"):
        found = measured(thick, T, bodies(kind, U))
        np.testing.assert_allclose(found.distance, contacts("blob", kind, T, U).distance - 0.01, atol=1e-12)
        np.testing.assert_allclose(found.point - found.witness, found.distance[:, None] * found.normal, atol=1e-12)
    points = U[:, :3, 3]
    exact = measured(thick, T, Rod(points, points, np.zeros(COUNT))).distance
    height = heights(thick, T, points)
    assert (height <= exact + 1e-12).all() and 20 < np.sum(exact < 0)
    np.testing.assert_allclose(height[exact < -0.01], exact[exact < -0.01], atol=1e-12)
