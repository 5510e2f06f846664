"""Self-collision: pairs of capsules as MuJoCo measures them, and joint paths proven clear of them."""

import dataclasses
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import made_once
import mujoco
import numpy as np
import pytest
from made_once import prove
from test_joint_path import rail

from htcp_jax.clearance import Scene, clearances
from htcp_jax.clearance.distance.segments import nearest_columns, nearest_points
from htcp_jax.clearance.obstacles.obstacles import clearance_rows, contacts
from htcp_jax.clearance.obstacles.self_collision import FEW_PAIRS, SelfCollision, make_self_collision
from htcp_jax.clearance.obstacles.self_exclusions import candidates, distances, samples
from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.clearance.proof.motion_bound import JointSweep, pair_travel_bound, travel_bound
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.io.robots.mjcf import arm_xml
from htcp_jax.io.robots.vendor_import import import_robot
from htcp_jax.model import Robot
from htcp_jax.model.kinematics import capsule_segments, link_poses
from htcp_jax.spec import GP50

PLACES = 1000
PIPE = Path(__file__).parents[1] / "configs/pipe"


def arm(name: str, folder) -> tuple[Robot, mujoco.MjModel]:
    """A robot, and MuJoCo's own reading of its file."""
    if name == "seven":
        return made_once.seven_joints(folder), mujoco.MjModel.from_xml_path(str(folder / "seven.xml"))
    file = GP50 if name == "gp50" else rail(folder)
    return load_robot(file), mujoco.MjModel.from_xml_path(str(file))


def mujoco_distances(model: mujoco.MjModel, pairs, configurations) -> np.ndarray:
    """Distances of all pairs of geoms at all configurations (n, R)."""
    data, found = mujoco.MjData(model), np.empty((len(configurations), len(pairs)))
    for k, x in enumerate(configurations):
        data.qpos[:] = x
        mujoco.mj_kinematics(model, data)
        found[k] = [mujoco.mj_geomDistance(model, data, a, b, 1e3, None) for a, b in pairs]
    return found


@pytest.mark.parametrize("name", ["gp50", "seven", "rail"])
def test_the_distances_of_pairs_are_mujocos(name, tmp_path):
    robot, model = arm(name, tmp_path)
    own, configurations = make_self_collision(robot), made_once.configurations(robot, 300)
    ours = made_once.quick_jit(jax.vmap(partial(clearances, robot, (own,), made_once.nominal())))(configurations)
    theirs = mujoco_distances(model, own.pairs, configurations)
    crossing = theirs < -0.99 * np.asarray(robot.capsule_radius)[np.array(own.pairs)].sum(axis=1)  # axis through axis
    np.testing.assert_allclose(np.where(crossing, 0, ours), np.where(crossing, 0, theirs), atol=1e-9)
    assert name == "rail" or (theirs < 0).any()


def test_nearly_parallel_segments_and_points_are_measured_as_exactly():
    """Distances of nearly parallel segments and of points, compared with scipy's bounded minimiser."""
    from scipy.optimize import minimize

    rng = np.random.default_rng(0)
    p, q, r, s = rng.uniform(-1, 1, (4, 40, 3))
    s[:20] = r[:20] + (q - p)[:20] * rng.uniform(-1.5, 1.5, (20, 1)) + 10.0 ** rng.uniform(-16, -4, (20, 1))
    q[20:30] = p[20:30]
    s[25:35] = r[25:35]
    _, _, a, b = nearest_points(*map(jnp.asarray, (p, q, r, s)))
    found = np.linalg.norm(a - b, axis=1)
    t, u, distance = nearest_columns(*map(jnp.asarray, (p.T, q.T, r.T, s.T)))
    np.testing.assert_allclose(distance, found, atol=1e-12)
    t, u = np.asarray(t)[:, None], np.asarray(u)[:, None]
    np.testing.assert_allclose(distance, np.linalg.norm(p + t * (q - p) - r - u * (s - r), axis=1), atol=1e-12)
    for k in range(40):
        along, other = (q - p)[k], (s - r)[k]

        def apart(v, k=k, along=along, other=other):
            d = p[k] + v[0] * along - r[k] - v[1] * other
            return d @ d, np.array([2 * d @ along, -2 * d @ other])

        starts = [(0, 0), (0, 1), (1, 0), (1, 1), (0.5, 0.5)]
        best = min(minimize(apart, v, jac=True, bounds=[(0, 1)] * 2, tol=1e-15).fun for v in starts)
        assert found[k] <= np.sqrt(best) + 1e-9 and found[k] >= np.sqrt(best) - 1e-5


def test_the_row_of_an_arm_with_many_capsules_is_that_of_the_row_alone():
    """Contacts of an arm whose capsules are cut in eight, compared with those of one row at a time."""
    arm, parts = made_once.gp50(), np.linspace(0, 1, 9)
    cut = lambda shares: np.concatenate([arm.capsule_p + share * (arm.capsule_q - arm.capsule_p) for share in shares])  # noqa: E731
    many = dataclasses.replace(
        arm,
        capsule_p=jnp.asarray(cut(parts[:-1])),
        capsule_q=jnp.asarray(cut(parts[1:])),
        capsule_radius=jnp.tile(arm.capsule_radius, 8),
        on_tool=jnp.tile(arm.on_tool, (8, 1)),
        capsule_names=tuple(f"{name}-{part}" for part in range(8) for name in arm.capsule_names),
        capsule_link=arm.capsule_link * 8,
    )
    pairs = tuple((a, b) for a, b in candidates(many) if a < len(arm.capsule_link))
    own, where = SelfCollision(pairs), made_once.nominal()
    assert len(pairs) > FEW_PAIRS
    measured = lambda own, x: contacts(many, (own,), where, x)  # noqa: E731
    rows, x = own.rows(many), made_once.configurations(many, 20)
    found = made_once.quick_jit(jax.vmap(partial(measured, own)))(x)
    for row in range(0, len(rows.body), 7):
        body, other = rows.body[row], rows.other[row]
        alone = SelfCollision(tuple((a, b) for a, b in pairs if a == body and many.capsule_link[b] == other))
        assert len(alone.pairs) <= FEW_PAIRS
        expected = made_once.quick_jit(jax.vmap(partial(measured, alone)))(x)
        np.testing.assert_allclose(found.distance[:, row], expected.distance[:, 0], atol=1e-12)
        np.testing.assert_allclose(found.radius[:, row], expected.radius[:, 0], atol=1e-12)
        np.testing.assert_allclose(found.point[:, row], expected.point[:, 0], atol=1e-7)
        apart = (found.distance + found.radius)[:, row, None]
        np.testing.assert_allclose(apart * found.normal[:, row], apart * expected.normal[:, 0], atol=1e-7)


def test_a_pairs_body_moves_no_further_than_the_bound_as_seen_from_the_other(tmp_path):
    """Bound on the motion of a pair's body relative to the other.

    Random joint paths, random points on them; joints up to the other's link do not count.
    """
    for name in ("gp50", "rail"):
        robot, _ = arm(name, tmp_path)
        own, rng, n = SelfCollision(((2, 0), (2, 1))), np.random.default_rng(3), len(robot.slides)
        rows, tightest = own.rows(robot), 0.0
        bound = made_once.quick_jit(partial(pair_travel_bound, robot, rows))
        everywhere = made_once.quick_jit(partial(travel_bound, robot))
        ends = made_once.quick_jit(lambda x, robot=robot: (link_poses(robot, x), *capsule_segments(robot, x)))
        for _ in range(100):
            x, rates = rng.uniform(-1, 1, n), rng.normal(size=n)
            half = rng.choice([0.01, 0.1, 0.5])
            most = np.asarray(bound(x, JointSweep(rates, half)))
            still = np.where(np.arange(n) <= rows.other[0], 0.0, rates)
            np.testing.assert_allclose(most[0], np.asarray(everywhere(x, JointSweep(still, half)))[2], rtol=1e-12)
            seen = []
            for y in (x, x + rng.uniform(-1, 1) * half * rates):
                T, p, q = map(np.asarray, ends(y))
                seen.append([[(end[2] - T[link][:3, 3]) @ T[link][:3, :3] for end in (p, q)] for link in rows.other])
            moved = np.linalg.norm(np.array(seen[0]) - np.array(seen[1]), axis=-1).max(axis=1)
            assert (moved <= most + 1e-12).all()
            tightest = max(tightest, float((moved / most).max()))
        assert tightest > 0.8


def test_a_proven_joint_path_keeps_the_pairs_apart_at_a_thousand_places_and_a_refuted_one_does_not(tmp_path):
    robot, model = arm("seven", tmp_path)
    own, where, rng = make_self_collision(robot), made_once.nominal(), np.random.default_rng(0)
    proof = made_once.quick_jit(lambda a, b: prove(Scene(robot, (own,)), where, a, b, kept=0.5))
    verdicts = []
    for a in made_once.configurations(robot, 24):
        b = a + rng.uniform(-0.6, 0.6, 7)
        found = proof(a, b)
        places = a + np.linspace(0, 1, PLACES if found.verdict == PathVerdict.VALID else 2)[:, None] * (b - a)
        if found.verdict == PathVerdict.VALID:
            assert mujoco_distances(model, own.pairs, places).min() >= float(found.clearance) - 1e-9 > 0
        elif found.verdict == PathVerdict.IN_COLLISION:
            there = (a + float(found.place) * (b - a))[None]
            assert mujoco_distances(model, own.pairs, there).min() <= 1e-9
        verdicts.append(int(found.verdict))
    assert verdicts.count(PathVerdict.VALID) >= 3 and verdicts.count(PathVerdict.IN_COLLISION) >= 3


def test_turning_the_base_moves_no_pair_that_turns_with_it(tmp_path):
    """Rotation of the base: a single clearance query proves it, as both bodies of each pair move along."""
    robot, _ = arm("seven", tmp_path)
    own = SelfCollision(tuple(pair for pair in make_self_collision(robot).pairs if robot.capsule_link[pair[1]] >= 0))
    x = jnp.array([0.0, 0.3, 0.0, 0.3, 0.0, 0.3, 0.0])
    found = prove(Scene(robot, (own,)), made_once.nominal(), x, x + jnp.eye(7)[0] * 3.0)
    assert found.verdict == PathVerdict.VALID and found.queries == 1


def test_the_gradient_of_a_pair_is_that_of_its_distance(tmp_path):
    robot, _ = arm("seven", tmp_path)
    own, where, h = (make_self_collision(robot),), made_once.nominal(), 1e-6
    value = made_once.quick_jit(partial(clearances, robot, own, where))
    rows = made_once.quick_jit(partial(clearance_rows, robot, own, where))
    odd = 0
    for x in made_once.configurations(robot, 20, seed=4):
        slope = np.stack([(value(x + h * e) - value(x - h * e)) / (2 * h) for e in np.eye(7)], axis=1)
        odd += int((np.abs(slope - rows(x).gradient) > 1e-5).any(axis=1).sum())
        by_autodiff = jax.jacfwd(value)(jnp.asarray(x))
        np.testing.assert_allclose(by_autodiff, rows(x).gradient, atol=1e-9)
    assert odd <= 4  # other points became the nearest, within a micrometre


CHAIN = """<mujoco><worldbody>
  <body name="a"><joint axis="0 0 1" range="-2 2"/><geom name="A" type="sphere" size="0.1"/>
    <body name="b" pos="0.3 0 0"><joint axis="0 0 1" range="-2 2"/><geom name="B" type="sphere" size="0.1"/>
      <body name="c" pos="0.3 0 0"><joint axis="0 0 1" range="-2 2"/><geom name="C" type="sphere" size="{size}"/>
        <body name="d" pos="0.3 0 0"><joint axis="0 0 1" range="-2.9 2.9"/><geom name="D" type="sphere" size="0.1"/>
          <geom name="E" type="sphere" size="0.05" pos="0.55 0 0"/><site name="tcp" pos="0.6 0 0"/>
  </body></body></body></body></worldbody>{more}</mujoco>"""


RADIAN = '<compiler angle="radian"/>'  # otherwise the limit is 2 degrees


def named(robot, pairs) -> list[str]:
    return ["".join(robot.capsule_names[k] for k in pair[:2]) for pair in pairs]


@pytest.mark.parametrize(
    ("size", "more", "pairs", "excluded"),
    [
        (0.1, "", "BA CA CB DA DB DC EA EB EC", {}),
        (0.1, '<contact><exclude body1="d" body2="a"/></contact>', "BA CA CB DB DC EB EC", {"DA": "a", "EA": "a"}),
        (0.25, "", "BA CA DA DB EA EB EC", {"CB": "b", "DC": "b"}),
        (0.45, RADIAN, "BA CA DA DB EA EB", {"CB": "b", "DC": "b", "EC": "c"}),
        (0.1, '<keyframe><key qpos="0 0 0 2.9" ctrl="1"/></keyframe>', "BA CA CB DA DB DC EA EB EC", {}),
    ],
)
def test_pairs_are_checked_unless_the_model_excludes_them_or_they_nearly_always_overlap(
    size, more, pairs, excluded, tmp_path
):
    """Checked pairs: all, unless the model excludes them or they nearly always overlap.

    Overlap at zero or at a keyframe decides nothing: C of 0.45 m overlaps A where the chain is straight, and E comes
    back to B in the keyframe.
    """
    file = tmp_path / "chain.xml"
    file.write_text(CHAIN.format(size=size, more=more))
    robot = load_robot(file)
    own = make_self_collision(robot)
    assert named(robot, own.pairs) == pairs.split()
    assert dict(zip(named(robot, own.excluded), [each.rule for each in own.excluded], strict=True)) == excluded
    assert own.described(robot).startswith(f"{len(own.pairs)} pairs of bodies")


def test_the_warning_of_a_pair_with_the_tool_that_is_not_checked_gives_reason_and_remedy(tmp_path):
    (tmp_path / "chain.xml").write_text(CHAIN.format(size=0.25, more=""))
    robot = load_robot(tmp_path / "chain.xml")
    tool = dataclasses.replace(robot, mounted=(robot.capsule_names.index("C"),))
    words = "D and C; a motion in .* clear; .* at least 95 % of the sampled .* begin the tool's .*farther"
    with pytest.warns(UserWarning, match=words):
        make_self_collision(tool)


def test_a_pair_that_is_always_1_mm_apart_is_not_checked():
    """The shipped arm's wrist, a sphere on the last joint's axis, and its holder: 1 mm, give or take rounding."""
    robot = load_robot(PIPE / "arm.xml")
    pair = robot.capsule_names.index("holder"), robot.capsule_names.index("wrist")
    away = distances(robot, [pair], samples(robot))
    assert np.ptp(away) < 1e-12 and 1e-3 < away.max() < 1e-3 + 1e-12
    own = make_self_collision(robot)
    assert pair not in own.pairs and pair in {(each.first, each.second) for each in own.excluded}


def test_without_meshes_adjacent_links_that_overlap_in_some_configurations_are_not_checked(tmp_path):
    """Unchecked adjacent links without meshes: those that overlap in some configurations.

    G overlaps A where joint 2 is folded far enough; the same capsule two links out is checked.
    """
    folded = '<geom name="G" type="sphere" size="0.05" pos="0.25 0.05 0"/>'
    own = CHAIN.replace('<body name="c"', folded + '<body name="c"').replace('range="-2 2"', 'range="-2.9 2.9"')
    (tmp_path / "chain.xml").write_text(own.format(size=0.1, more=RADIAN))
    robot = load_robot(tmp_path / "chain.xml")
    excluded = make_self_collision(robot).excluded
    rules = dict(zip(named(robot, excluded), excluded, strict=True))
    assert rules["GA"].rule == "c" and 0 < rules["GA"].share < 0.5 and "EB" not in rules


def test_of_several_bodies_on_a_link_the_nearest_decides(tmp_path):
    """Rows for links with several bodies: the nearest decides.

    A row for each body and each link before it; by hand, of spheres.
    """
    first = '<geom name="A" type="sphere" size="0.1"/>'
    more = [f'<geom name="{name}" type="sphere" size="0.1" pos="0 {y} 0"/>' for name, y in (("F", 0.3), ("G", -0.3))]
    (tmp_path / "chain.xml").write_text(CHAIN.format(size=0.1, more="").replace(first, "".join([first, *more])))
    robot, where = load_robot(tmp_path / "chain.xml"), made_once.nominal()
    link, radius = robot.capsule_link, np.asarray(robot.capsule_radius)
    own = SelfCollision(tuple(pair for pair in make_self_collision(robot).pairs if link[pair[0]] > link[pair[1]] + 1))
    rows = own.rows(robot)
    assert len(own.pairs) == 11 and len(rows.body) == 5 and set(rows.other) == {0, 1}
    for x in map(jnp.asarray, np.random.default_rng(0).uniform(-2, 2, (10, 4))):
        ends = capsule_segments(robot, x)
        p, found = np.asarray(ends[0]), np.asarray(clearances(robot, (own,), where, x))
        for row, (body, link) in enumerate(zip(*rows, strict=True)):
            others = [b for a, b in own.pairs if a == body and robot.capsule_link[b] == link]
            each = [np.linalg.norm(p[body] - p[b]) - radius[body] - radius[b] for b in others]
            np.testing.assert_allclose(found[row], min(each), atol=1e-12)
            nearest = robot.capsule_names[others[int(np.argmin(each))]]
            assert made_once.nearest_name(robot, own, row, x) == f"capsule {nearest}"


def test_what_a_model_excludes_is_handed_on_to_an_imported_arm(tmp_path):
    more = '<contact><exclude body1="d" body2="a"/></contact>'
    (tmp_path / "chain.xml").write_text(CHAIN.format(size=0.1, more=more))
    (tmp_path / "arm.xml").write_text(arm_xml(import_robot(tmp_path / "chain.xml"), "chain.xml"))
    there, here = (load_robot(tmp_path / name) for name in ("chain.xml", "arm.xml"))
    assert named(there, there.exclusions) == named(here, here.exclusions) == ["DA", "EA"]
    assert make_self_collision(there) == make_self_collision(here)


def test_an_arm_of_neighbours_alone_has_nothing_to_keep_apart(tmp_path):
    file = tmp_path / "short.xml"
    body = '<body pos="0 0 {}"><joint axis="0 1 0" range="-2 2"/>{}'
    parts = [body.format(0, ""), body.format(0.2, '<geom type="sphere" size="0.15"/>'), body.format(0.2, "")]
    end = '<geom type="sphere" size="0.15"/><site name="tcp"/>' + "</body>" * 3
    file.write_text(f"<mujoco><worldbody>{''.join(parts)}{end}</worldbody></mujoco>")
    assert make_self_collision(load_robot(file)) is None
