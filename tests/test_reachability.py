"""What is reachable: what it finds is clear and on target, and it is the same whatever the batch."""

import jax
import numpy as np
import pytest

from htcp_jax.clearance.obstacles import clearance
from htcp_jax.clearance.of_workpiece import make_obstacle
from htcp_jax.cli.main import main
from htcp_jax.planner.reachability import reachable_prefixes
from htcp_jax.scene.kinematics import tcp_position
from htcp_jax.scene.robot_file import gp50
from htcp_jax.scene.scenario import make_scenario, stack
from htcp_jax.scene.workpiece_file import load_workpiece

START = (0.0, -2.3, 0.5, 0.0, 0.5, -2.0)


@pytest.fixture(scope="module")
def found():
    robot, workpiece = gp50(), load_workpiece()
    scenarios = [make_scenario(robot, workpiece, START, rotation=pose) for pose in ((0.4, 0.1), (0.8, 0.0))]
    return robot, workpiece, scenarios, reachable_prefixes(robot, workpiece, stack(scenarios), draws=256)


def test_a_complete_scenario_is_found_reachable_and_one_that_dead_ends_is_not(found):
    _, _, scenarios, result = found
    assert result.prefix[0] == scenarios[0].count
    assert 11 <= result.prefix[1] < scenarios[1].count
    assert np.isnan(result.best[0]) and result.best[1] <= 0


def test_every_configuration_found_is_clear_and_on_its_target(found):
    robot, workpiece, scenarios, result = found
    obstacle = make_obstacle(workpiece)
    for scenario, x, prefix in zip(scenarios, result.x, result.prefix, strict=True):
        rows = np.linspace(0, prefix - 1, 7).astype(int)
        measure = jax.jit(lambda x, s=scenario: (clearance(robot, obstacle, s, x), tcp_position(robot, x)))
        for row in rows:
            D, tcp = measure(x[row])
            assert D > 0
            assert np.linalg.norm(tcp - scenario.targets[row]) <= 1e-3
        assert np.isnan(x[prefix:]).all()


def test_a_scenario_reaches_as_far_alone(found):
    robot, workpiece, scenarios, result = found
    alone = reachable_prefixes(robot, workpiece, stack(scenarios[:1]), draws=256)
    np.testing.assert_array_equal(alone.x[0], result.x[0])


def test_the_command_writes_the_prefixes_and_refuses_an_empty_number_of_draws(tmp_path, capsys):
    words = ["reachability", "sweeps/workpiece.yaml", "--limit", "1", "--draws", "1", "--out", str(tmp_path / "run")]
    assert main(words) == 0
    assert "reachable at least" in capsys.readouterr().out
    assert (tmp_path / "run" / "reachability.json").exists()
    assert main([*words[:5], "0"]) == 2
