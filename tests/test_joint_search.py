"""Joint-space path search: every path found is proven clear, and none is found where none exists."""

from dataclasses import replace
from functools import cache, partial

import jax
import made_once
import numpy as np
import pytest
from sphere_references import place
from test_clearance import few_points

from htcp_jax.clearance import Scene
from htcp_jax.clearance.obstacles.of_workpiece import make_obstacle
from htcp_jax.clearance.obstacles.tip_guard import make_tip_guard
from htcp_jax.clearance.proof.bisection import PathVerdict
from htcp_jax.device import Executor
from htcp_jax.errors import InputError
from htcp_jax.io.parts.workpiece_source import load_workpiece
from htcp_jax.io.robots.loading import load_robot
from htcp_jax.model.scenario import stack
from htcp_jax.model.scenario_setup import make_scenario
from htcp_jax.motion import CollisionChecker
from htcp_jax.motion.joint_search import _JointTree, _Nodes, join
from htcp_jax.motion.lane_inputs import lane_inputs
from htcp_jax.settings import Settings, settings_of
from htcp_jax.spec import GP50
from htcp_jax.validation.mujoco_arm import MujocoArm
from htcp_jax.validation.mujoco_clearance import CheckedScene, Wall

PLACES = 1000
KNOWN = 10  # parts of a step at whose ends all is measured, from which most of the other places are known to be clear
NUMBERS = 49, 53, 3, 78, 86, 109, 112, 113, 153  # recorded configurations in the duct, all clear but one
SETTINGS = Settings(search_rounds=150)


@cache
def checker(guard=None):
    return CollisionChecker(Executor(made_once.scene(), SETTINGS), SETTINGS, guard)


@cache
def scenarios():
    """Scenarios with the pose of each recorded configuration."""
    nominal = jax.tree.map(np.asarray, made_once.nominal())
    poses = [jax.tree.map(np.asarray, place(k)[0]) for k in NUMBERS]
    return stack(
        [
            replace(
                nominal,
                T_world_workpiece=where.T_world_workpiece,
                interior_plane=where.interior_plane,
                number=np.array(k, np.int32),
            )
            for k, where in zip(NUMBERS, poses, strict=True)
        ]
    )


def ends():
    """Path ends: the start, outside, and the recorded configuration in the duct."""
    b = np.stack([np.asarray(place(k)[1]) for k in NUMBERS])
    return np.broadcast_to(np.array(made_once.START), b.shape).copy(), b


def joined(which, settings=SETTINGS, pair=0, guard=None):
    which = np.asarray(which, int)
    a, b = (end[which] for end in ends())
    return join(checker(guard), scenarios(), which, np.full(len(which), pair), a, b, settings)


@cache
def found():
    return joined(range(len(NUMBERS)))


def paths(via_points=None):
    """Paths found, as (scenario, configurations from end to end)."""
    a, b = ends()
    via_points = found() if via_points is None else via_points
    return [(s, np.concatenate([a[s][None], own, b[s][None]])) for s, own in enumerate(via_points) if own is not None]


def verdicts(s, a, b):
    which = np.full(len(a), s)
    return checker().edges(lane_inputs(scenarios(), which, np.zeros_like(which)), a, b).verdict


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()


def _at_places(path, u):
    """Configurations of a path at places u, from 0 at its start to the number of its steps."""
    step = np.minimum(u.astype(int), len(path) - 2)
    return path[step] + (u - step)[:, None] * (path[step + 1] - path[step])


def test_another_engine_finds_nothing_that_touches_at_a_thousand_places_of_every_step():
    duct, arm, several = made_once.duct(), MujocoArm(GP50, 0.0, "simulation"), 0
    wall = Wall(np.asarray(duct.cloud), "hull")
    for s, path in paths():
        T = scenarios().T_world_workpiece[s]
        scene = CheckedScene(arm, wall, T[:3, :3], T[:3, 3], duct.interior_depth_m)
        known = scene.at(_at_places(path, np.linspace(0, len(path) - 1, KNOWN * (len(path) - 1) + 1)))
        assert known.clearance.min() > 0
        u = (np.arange(len(path) - 1)[:, None] + np.linspace(0, 1, PLACES)).ravel()
        row = np.minimum((KNOWN * u).astype(int), len(known.clearance) - 2)
        _, clearance = scene.between(_at_places(path, u), row, known, 0.0)
        assert np.isinf(clearance).all()
        several += len(path) > 3
    assert several >= 3


def test_every_step_is_proven_and_within_the_limits():
    """Check with the lane function that verifies the segments of plans; no two successive configurations are equal."""
    lower, upper = checker().executor.limits
    for s, path in paths():
        assert (verdicts(s, path[:-1], path[1:]) == PathVerdict.VALID).all()
        assert (path >= lower).all() and (path <= upper).all()
        assert (np.diff(path, axis=0) != 0).any(axis=1).all()


def test_where_the_straight_joint_path_is_proven_there_are_no_via_points_and_elsewhere_there_are():
    a, b = ends()
    straight = [(verdicts(s, a[s][None], b[s][None]) == PathVerdict.VALID).all() for s, _ in paths()]
    assert [len(path) == 2 for _, path in paths()] == straight and not all(straight)
    near = a + 1e-3
    (none, same) = join(
        checker(), scenarios(), np.arange(2), np.zeros(2, int), a[:2], np.stack([near[0], a[1]]), SETTINGS
    )
    assert none.shape == same.shape == (0, a.shape[1])


def test_an_end_in_collision_is_joined_with_nothing():
    """Check a collision at either end; all other pairs, whose ends are clear, are joined."""
    a, b = ends()
    clear = [(verdicts(s, b[s][None], b[s][None]) == PathVerdict.VALID).all() for s in range(len(NUMBERS))]
    assert [own is not None for own in found()] == clear and not all(clear)
    s = np.array([clear.index(False)])
    assert join(checker(), scenarios(), s, s, b[s], a[s], SETTINGS) == [None]


def test_another_pair_number_and_another_seed_are_other_searches():
    s = max(paths(), key=lambda path: len(path[1]))[0]
    others = [joined([s], pair=1)[0], joined([s], replace(SETTINGS, seed=5))[0]]
    assert not any(np.array_equal(other, found()[s]) for other in others)
    assert all((verdicts(s, *_steps(s, other)) == PathVerdict.VALID).all() for other in others)


def _steps(s, via_points):
    a, b = ends()
    path = np.concatenate([a[s][None], via_points, b[s][None]])
    return path[:-1], path[1:]


def test_shortcuts_make_a_way_shorter_and_never_longer():
    """Compare path lengths over rounds of shortcuts; without shortcuts, no step is longer than `search_step_rad`."""
    before, longest = None, 0.0
    for rounds in (0, 1, 4, 8):
        now = [path for _, path in paths(joined(range(len(NUMBERS)), replace(SETTINGS, search_shortcuts=rounds)))]
        if before is None:
            steps = [np.linalg.norm(np.diff(path, axis=0), axis=1).max() for path in now if len(path) > 2]
            longest = max(steps)
        else:
            assert all(length(new) <= length(old) for new, old in zip(now, before, strict=True))
            assert sum(map(length, now)) < sum(map(length, before))
        before = now
    assert longest <= SETTINGS.search_step_rad + 1e-12


def columns(*angles):
    """Points of upright columns around an arm's base."""
    height = np.arange(-0.3, 0.31, 0.02)
    return np.concatenate([np.column_stack([np.full((len(height), 2), _at(angle)), height]) for angle in angles])


def _at(angle, radius=0.35):
    return radius * np.array([np.cos(angle), np.sin(angle)])


@pytest.mark.parametrize(("angles", "path"), [((-1.0, 1.0), False), ((-1.0, -1.05), True)])
def test_an_arm_between_two_columns_does_not_get_out_and_next_to_one_it_does(angles, path, tmp_path):
    """The first link extends beyond the columns and cannot turn past 175 degrees to get around them."""
    links = "".join(
        f'<body pos="{0.5 * (k > 0)} 0 0"><joint name="j{k}" axis="0 0 1" range="-175 175"/>'
        '<geom type="capsule" size="0.05" fromto="0 0 0 0.5 0 0"/>'
        for k in range(3)
    )
    file = tmp_path / "planar.xml"
    site = '<site name="tcp" pos="0.6 0 0"/>'
    file.write_text(f"<mujoco><worldbody>{links}{site}{'</body>' * 3}</worldbody></mujoco>")
    robot, part = load_robot(file, limits="model"), few_points(columns(*angles))
    start, inside = np.array([2.0, 0.4, 0.0]), np.array([0.0, 0.5, -0.5])
    one = stack([make_scenario(robot, part, start, rotation=(0.0, 0.0))])
    own = CollisionChecker(Executor(Scene(robot, make_obstacle(part)), SETTINGS), SETTINGS)
    zero = np.zeros(1, int)
    for a, b in ((start, inside), (inside, start)):
        (via_points,) = join(own, one, zero, zero, a[None], b[None], replace(SETTINGS, search_rounds=60))
        assert (via_points is not None) == path


def test_the_bare_tip_keeps_out_of_the_walls():
    """Compare searches with and without the tip check: without it some paths pass through a wall, with it none."""
    guard = make_tip_guard(load_workpiece(tip_contact_m=0.01))

    def passes(s, via_points):
        a, b = _steps(s, via_points)
        inputs = lane_inputs(scenarios(), np.full(len(a), s), np.zeros(len(a), int))
        free, guarded = checker().edges(inputs, a, b), checker(guard).edges(inputs, a, b)
        assert (free.verdict == PathVerdict.VALID).all()
        return (guarded.verdict == PathVerdict.IN_COLLISION).any()

    which = [s for s, own in enumerate(found()) if own is not None][::2]
    few = replace(SETTINGS, search_rounds=20, search_shortcuts=1)
    heedful = dict(zip(which, joined(which, few, guard=guard), strict=True))
    assert any(own is not None for own in heedful.values())
    assert not any(passes(s, own) for s, own in heedful.items() if own is not None)
    assert any(passes(s, found()[s]) for s in which)


@pytest.mark.parametrize(("name", "value"), [("search_rounds", 0), ("search_step_rad", 0.0), ("search_step_rad", 4.0)])
def test_settings_out_of_range_are_refused(name, value):
    with pytest.raises(InputError, match=name):
        settings_of({name: value})
    assert settings_of({"search_shortcuts": 0}).search_shortcuts == 0


def test_of_each_scenario_s_pairs_that_is_joined_which_takes_least_whoever_else_is_joined():
    """Check two far ends and one a step away: the near one is joined, and the other searches are cancelled."""
    a, b = ends()
    s = np.flatnonzero([own is not None and len(own) > 0 for own in found()])[:2]
    scenario, pair = np.repeat(s, 3), np.tile(np.arange(3), 2)
    to = np.stack([b[s], b[s], a[s] + 1e-3], axis=1).reshape(6, -1)
    of = partial(join, checker(), scenarios())
    paths = of(scenario, pair, a[scenario], to, SETTINGS, soonest=True)
    assert [path is None for path in paths] == [True, True, False] * 2
    far = np.arange(6) % 3 < 2  # only the two long searches, where the one with fewer queries wins
    every = of(scenario[far], pair[far], a[scenario[far]], to[far], SETTINGS)
    sooner = of(scenario[far], pair[far], a[scenario[far]], to[far], SETTINGS, soonest=True)
    for k in range(2):
        mine = slice(2 * k, 2 * k + 2)
        (kept,) = [n for n in (2 * k, 2 * k + 1) if sooner[n] is not None]
        np.testing.assert_array_equal(sooner[kept], every[kept])
        alone = of(scenario[far][mine], pair[far][mine], a[scenario[far][mine]], to[far][mine], SETTINGS, soonest=True)
        np.testing.assert_array_equal(alone[kept - 2 * k], sooner[kept])


def test_the_pair_kept_is_the_one_with_the_fewest_rounds_and_others_are_abandoned_when_it_is_known(monkeypatch):
    """Compare with the calls of each pair alone: the others take part until the kept pair's path is found."""
    a, b = ends()
    s = np.flatnonzero([own is not None and len(own) > 0 for own in found()])[:1].repeat(4)
    pair, lanes, call = np.arange(4), [], Executor.__call__

    def counted(self, function, *tables):
        lanes.append(len(tables[1]))
        return call(self, function, *tables)

    monkeypatch.setattr(Executor, "__call__", counted)

    def joined_of(which, **how):
        lanes.clear()
        return join(checker(), scenarios(), s[which], pair[which], a[s[which]], b[s[which]], SETTINGS, **how), [*lanes]

    alone = [joined_of(np.array([k])) for k in pair]
    rounds, kept = min((len(calls), k) for k, (paths, calls) in enumerate(alone) if paths[0] is not None)
    reported = []
    paths, together = joined_of(pair, soonest=True, report=reported.append)
    assert [k for k in pair if paths[k] is not None] == [kept] and len(together) == rounds and sum(reported) == 1
    found_in = rounds - SETTINGS.search_shortcuts
    others = sum(sum(calls[:found_in]) for k, (_, calls) in enumerate(alone) if k != kept)
    assert found_in > 2 and sum(together) == sum(alone[kept][1]) + others


def test_a_tree_whose_first_round_proves_no_step_keeps_its_root():
    root = np.zeros(3)
    root.flags.writeable = False  # as arrays of JAX are
    tree = _JointTree(root, backwards=False)
    assert len(tree.add(_Nodes(np.zeros((0, 3)), np.zeros(0, int)))) == 0
    assert tree.add(_Nodes(np.ones((2, 3)), np.zeros(2, int))).tolist() == [1, 2]
    np.testing.assert_array_equal(tree.path_to(2), [[0, 0, 0], [1, 1, 1]])
