"""Programs are slower near the part: joint speed and distance are measured again on the timed samples."""

import numpy as np
import pytest
import toy

import htcp_jax
from htcp_jax.status import Kind
from htcp_jax.trajectory.plan_program import program_of_plans

NEAR_M, SHARE = 0.05, 0.2
SPEED = 2.0  # [rad/s]


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    program = {"velocity": [SPEED] * 4}
    part = {"shift_m": (0.4, 0.02, -0.03), "cell": {"self_collision": False}}
    return htcp_jax.plan(toy.write_job(tmp_path_factory.mktemp("near"), 4, program=program, **part))


def timed(plan, share: float):
    program = plan.job.program.model_copy(update={"near_part_speed": share, "near_part_m": NEAR_M})
    job = plan.job.model_copy(update={"program": program})
    made = program_of_plans("toy", plan.plans, 0, job, 0.02, "beam")
    return made.program.timed(0.004)


def test_joints_are_slower_near_the_part_and_only_there(plan):
    slow, full = timed(plan, SHARE), timed(plan, 1.0)
    assert slow.time_s[-1] > full.time_s[-1]
    largest = []
    for made in (slow, full):
        D, _ = toy.measured(plan.scenario, made.x)
        free = np.isin(made.kind, (Kind.TRANSFER, Kind.APPROACH, Kind.RETRACT))
        speed = np.abs(made.velocity).max(axis=1) / SPEED
        largest.append((speed[free & (D < NEAR_M)].max(), speed[free & (D >= NEAR_M)].max()))
    assert largest[0][0] <= 1.02 * SHARE < largest[1][0]
    assert largest[0][1] > 1.5 * SHARE
    process = [(made.kind == Kind.PROCESS).sum() for made in (slow, full)]
    assert abs(process[0] - process[1]) <= 1
