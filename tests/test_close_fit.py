"""Closer fits, and the convex pieces that an arm's file stores: both hold every triangle."""

import dataclasses
import re

import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from enclosed import are_enclosed, from_axis
from scipy.spatial import ConvexHull

import htcp_jax
from htcp_jax.cli import main
from htcp_jax.io.robots import stored_pieces
from htcp_jax.io.robots.attached import AttachedBody, attach
from htcp_jax.io.robots.capsule_fit import Capsule, fit_capsule, hull_volume
from htcp_jax.io.robots.close_fit import cover_closely, excesses_m, surface_points, union_volume
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.model.robot import lengthen_tool

SHIFTED = trimesh.transformations.translation_matrix((0.1, 0, 0.1))
L_SHAPE = [trimesh.creation.box((0.24, 0.04, 0.04)), trimesh.creation.box((0.04, 0.04, 0.24), transform=SHIFTED)]
DRUM = [trimesh.creation.cylinder(radius=0.06, height=0.1)]
ARM = """
<mujoco model="toy">
  <asset><mesh name="hook" file="hook.stl"/></asset>
  <worldbody><body name="a"><joint name="j1"/><geom type="mesh" mesh="hook"/>
    <body name="b" pos="0.3 0 0" euler="0 90 0"><joint name="j2"/><geom type="box" size="0.1 0.02 0.03"/>
      <body name="c" pos="0.2 0 0"><joint name="j3"/>
        <body name="d" pos="0 0 0.1" euler="30 0 0"><geom type="mesh" mesh="hook"/>
          <geom name="own" type="sphere" size="0.01"/><site name="tcp" pos="0 0 0.3"/></body>
      </body></body></body></worldbody>
</mujoco>
"""


def triangles_of(parts: list[trimesh.Trimesh]) -> np.ndarray:
    return np.concatenate([np.asarray(part.triangles, float) for part in parts])


@pytest.fixture(scope="module")
def toy(tmp_path_factory):
    """A model of boxes and an L, and the arm's file."""
    folder = tmp_path_factory.mktemp("toy")
    trimesh.util.concatenate(L_SHAPE).export(folder / "hook.stl")
    (folder / "toy.xml").write_text(ARM)
    (folder / "arm.xml").write_text(arm_xml(import_robot(folder / "toy.xml"), "toy.xml"))
    return folder


@pytest.mark.parametrize("parts", [L_SHAPE, DRUM], ids=["L", "drum"])
def test_closer_capsules_hold_every_triangle_and_fill_less(parts):
    triangles = triangles_of(parts)
    one, five = ([piece.capsule for piece in cover_closely(triangles, most)] for most in (1, 5))
    assert len(one) == 1 and 1 < len(five) <= 5 and are_enclosed(triangles, five)
    assert union_volume(five) < 0.97 * union_volume(one)


def test_capsules_within_a_tolerance_are_within_it():
    triangles = triangles_of(L_SHAPE)
    capsules = [piece.capsule for piece in cover_closely(triangles, 20, 0.02)]
    mesh, away, count = trimesh.util.concatenate(L_SHAPE), [], 0
    for capsule in capsules:
        points = surface_points(capsule)
        bare = np.all([from_axis(points, other) >= other.radius - 1e-9 for other in capsules], axis=0)
        corners = np.broadcast_to(mesh.triangles, (bare.sum(), *mesh.triangles.shape)).reshape(-1, 3, 3)
        at = trimesh.triangles.closest_point(corners, points[bare].repeat(len(mesh.triangles), axis=0))
        apart = np.linalg.norm(at.reshape(bare.sum(), -1, 3) - points[bare][:, None], axis=2).min(axis=1)
        area = capsule.radius * (np.linalg.norm(capsule.q - capsule.p) + 2 * capsule.radius)
        away, count = [*away, area * (apart > 0.02).sum()], count + area * bare.sum()
    assert len(capsules) < 20 and sum(away) <= 0.0501 * count


def test_the_volume_of_a_union_and_the_distance_from_a_mesh_are_those_of_a_ball_about_a_cube():
    cube, ball = trimesh.creation.box((0.2, 0.2, 0.2)), Capsule(np.zeros(3), np.zeros(3), 0.2)
    assert union_volume([ball, ball]) == pytest.approx(ball.volume, rel=0.01)
    assert excesses_m(np.asarray(cube.triangles), [ball])[0] == pytest.approx(0.1, abs=2e-3)
    assert excesses_m(np.asarray(cube.triangles), [ball, ball._replace(radius=0.3)])[0] == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_a_reduced_piece_holds_all_points_and_its_excess_is_that_of_the_capsule(seed):
    draw = np.random.default_rng(seed)
    points = draw.normal(size=(3000, 3)) * [0.2, 0.1, 0.05]
    if seed == 3:
        points[:, 2] = 0.01  # flat
    piece, capsule = stored_pieces.reduced_piece(points), fit_capsule(points)
    assert len(piece.vertices) <= stored_pieces.MOST_VERTICES and piece.radius < 0.02
    assert piece.missed_m(points) == 0.0 and (capsule.depth(piece.vertices) > -1e-6).all()
    if seed < 3:
        faces = ConvexHull(piece.vertices).equations
        assert (points @ faces[:, :3].T + faces[:, 3] <= piece.radius + 1e-9).all()
    around = draw.normal(size=(20000, 3))
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    reach = np.maximum(around @ capsule.p, around @ capsule.q) + capsule.radius
    sampled = np.max(reach - np.max(around @ piece.vertices.T, axis=1)) - piece.radius
    assert sampled <= piece.excess_m(capsule) + 1e-9 and piece.excess_m(capsule) < sampled + 0.01


def test_pieces_are_read_back_in_the_frames_of_their_links_and_hold_every_triangle(toy):
    imported, arm = import_robot(toy / "toy.xml"), htcp_jax.load_robot(toy / "arm.xml")
    fitted = {name: cover for cover in imported.covers.values() for name in cover.pieces}
    for k, name in enumerate(arm.capsule_names):
        piece = type(arm.pieces.piece)(*(np.asarray(rows)[k] for rows in arm.pieces.piece))
        if name not in fitted:
            assert name == "own" and arm.pieces.excess_m[k] == 0
            continue
        p, q, radius = (np.asarray(rows)[k] for rows in (arm.capsule_p, arm.capsule_q, arm.capsule_radius))
        assert (from_axis(piece.vertices, Capsule(p, q, radius)) <= radius + 1e-6).all() and arm.pieces.excess_m[k] > 0
        assert hull_volume(piece.vertices) == pytest.approx(hull_volume(fitted[name].hulls[name].vertices), rel=1e-9)
        assert fitted[name].hulls[name].missed_m(fitted[name].pieces[name].triangles.reshape(-1, 3)) == 0.0


def test_a_capsule_that_was_moved_by_hand_has_no_piece(toy, tmp_path):
    text = (toy / "arm.xml").read_text()
    size = re.search(r'name="b" .*size="([^"]*)"', text)[1]
    moved = tmp_path / "moved.xml"
    moved.write_text(re.sub(r'(name="b" .*size=")[^"]*"', rf'\g<1>{0.9 * float(size)}"', text))
    before, after = htcp_jax.load_robot(toy / "arm.xml"), htcp_jax.load_robot(moved)
    b = before.capsule_names.index("b")
    assert before.pieces.excess_m[b] > 0 and after.pieces.excess_m[b] == 0
    np.testing.assert_array_equal(np.delete(after.pieces.excess_m, b), np.delete(before.pieces.excess_m, b))


def test_a_longer_tool_and_bodies_of_the_job_have_no_pieces(toy):
    arm = htcp_jax.load_robot(toy / "arm.xml")
    on_tool = np.asarray(arm.on_tool).any(axis=1)
    assert on_tool.any() and not on_tool.all()
    longer = np.asarray(lengthen_tool(arm, jnp.asarray(0.1)).pieces.excess_m)
    np.testing.assert_array_equal(longer, np.where(on_tool, 0.0, arm.pieces.excess_m))
    np.testing.assert_array_equal(lengthen_tool(arm, 0.0).pieces.excess_m, arm.pieces.excess_m)
    body = AttachedBody("camera", np.asarray(trimesh.creation.box((0.1, 0.1, 0.1)).vertices), 2)
    more = attach(arm, [body]).pieces
    assert len(more.excess_m) == len(more.piece.radius) > len(arm.capsule_names) and more.excess_m[-1] == 0
    assert htcp_jax.gp50().pieces is None and lengthen_tool(htcp_jax.gp50(), 0.1).pieces is None
    assert dataclasses.replace(arm, pieces=None).pieces is None


DAMAGED = {
    "a word": ('data="', 'data="nose ', "must be 1 to 1000 rows of 3 numbers, separated by ;"),
    "four numbers": ('data="', 'data="1 2 3 4; ', "must be 1 to 1000 rows of 3 numbers, separated by ;"),
    "infinity": ('data="', 'data="inf 0 0; ', "must be 1 to 1000 rows of 3 numbers, separated by ;"),
    "no radius": ('numeric name="radius of b"', 'numeric name="width of b"', "needs a numeric 'radius of b'"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_piece_is_one_line(toy, tmp_path, case):
    old, new, line = DAMAGED[case]
    text = (toy / "arm.xml").read_text()
    at = text.index('text name="piece of b"') if old == 'data="' else 0
    (tmp_path / "arm.xml").write_text(text[:at] + text[at:].replace(old, new, 1))
    with pytest.raises(htcp_jax.InputError, match=re.escape(line)):
        htcp_jax.load_robot(tmp_path / "arm.xml")


@pytest.mark.parametrize("length", ["0.9mm", "0.0005", "5", "5cm", "nan", "1.2.3mm", "-5mm"])
def test_a_tolerance_out_of_range_is_one_line_and_nothing_is_written(toy, tmp_path, capsys, length):
    words = ["robot", str(toy / "toy.xml"), "--out", str(tmp_path / "arm.xml"), "--fit-tolerance", length]
    assert main(words) == 2
    printed = capsys.readouterr()
    assert printed.err.count("\n") == 1 and "it must be a length of 1mm to 100mm" in printed.err
    assert not list(tmp_path.iterdir())
    with pytest.raises(htcp_jax.InputError, match=r"the tolerance of the fit is 0\.9 mm; valid: 1 to 100 mm"):
        import_robot(toy / "toy.xml", tolerance_m=0.0009)


def test_the_command_fits_the_last_two_links_within_the_tolerance(toy, tmp_path, capsys):
    out = tmp_path / "arm.xml"
    words = ["robot", str(toy / "toy.xml"), "--out", str(out), "--most", "4"]
    assert main([*words, "--fit-tolerance", "20mm"]) == 0
    arm, text = htcp_jax.load_robot(out), out.read_text()
    one = htcp_jax.load_robot(toy / "arm.xml")
    assert len(arm.capsule_names) > len(one.capsule_names) and out.with_suffix(".png").is_file()
    assert all(text.count(f'name="excess of {name}"') == 1 for name in arm.capsule_names if name != "own")
    assert all(sum(link == k for link in arm.capsule_link) <= 5 for k in range(3))  # 4, and the model's own
