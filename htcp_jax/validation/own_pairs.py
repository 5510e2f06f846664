"""Pairs of an arm's capsules that need no check against each other, determined by MuJoCo from its own samples.

A pair that the planner excludes is excluded here only if the model says so, if it nearly always overlaps here, too, or
if it belongs to adjacent links. If an arm's file says that meshes do not touch (rule c), the meshes are tested at every
configuration that is validated, if their files exist.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.io.robots import LinkMeshes
from htcp_jax.model import robot
from htcp_jax.validation.mujoco_arm import ArmPoses, MujocoArm

SAMPLES, SEED = 10_000, 1
ALWAYS, NEARLY = 0.95, 0.93  # smallest shares within NEAR_M, for an arm without a list; for one whose list has rule b
NEAR_M = 1e-3 + 1e-9  # pairs that are always within 1 mm could keep no usual margin; with rounding
Pair = tuple[int, int]
Distances = Callable[[ArmPoses, list[Pair]], Float[np.ndarray, "n R"]]


class OwnPairs(NamedTuple):
    """Pairs of capsules by their numbers."""

    checked: list[Pair]
    by_mesh: list[Pair]  # decided by their meshes
    excluded: list[Pair]


def own_pairs(arm: MujocoArm, measured: Distances) -> OwnPairs:
    """Classify the pairs of an arm.

    Args:
        arm: The arm.
        measured: Function for the distances of pairs of capsules at configurations [m].
    """
    stated, excluded = arm.stated, arm.excluded
    found, left = OwnPairs([], [], sorted(excluded)), [pair for pair in arm.apart if pair not in excluded]
    doubtful = [pair for pair in left if stated is None or pair in stated or arm.is_tool(pair)]
    distance = measured(arm.arm_poses(arm.random(SAMPLES, SEED)), doubtful)
    overlap, near = distance <= 0, dict(zip(doubtful, (distance <= NEAR_M).mean(axis=0).tolist(), strict=True))
    share = dict(zip(doubtful, overlap.mean(axis=0).tolist(), strict=True))
    for pair in left:
        rule = (stated or {}).get(pair)
        always = near.get(pair, 0.0) >= (NEARLY if rule == "b" else ALWAYS)
        telescopes = (
            arm.slides(pair) and overlap[:, [arm.same_links(pair, each) for each in doubtful]].any(axis=1).mean()
        )
        if always or rule == "a" or (not arm.is_tool(pair) and share.get(pair, 0.0) and telescopes >= ALWAYS):
            found.excluded.append(pair)
        elif rule == "c":
            (found.by_mesh if arm.meshes else found.excluded).append(pair)
        elif stated is None and not arm.is_tool(pair) and arm.adjacent(pair) and share.get(pair, 0.0):
            found.excluded.append(pair)
        else:
            found.checked.append(pair)
    return found


def touch_m(arm: MujocoArm, pair: Pair, x: Float[np.ndarray, "N"]) -> float:
    """Penetration depth of a pair's meshes [m]; 0 up to TOUCHING_M.

    Args:
        arm: The arm, with meshes.
        pair: The pair of capsules whose meshes are tested.
        x: The configuration [rad or m].
    """
    meshes: LinkMeshes = arm.meshes
    deep = meshes.deepest_m(*(arm.names[k] for k in pair), meshes.poses(x[None]))
    return deep if deep > robot.TOUCHING_M else 0.0
