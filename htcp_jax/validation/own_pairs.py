"""Pairs of an arm's capsules that need no self-collision check, determined by MuJoCo from independent samples.

A pair is excluded only if the model excludes it, if it nearly always overlaps in these samples, or if it overlaps and
belongs to adjacent links. If an arm's file excludes a pair because its meshes do not touch (rule c), the meshes are
tested at every validated configuration, provided that their files exist.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from htcp_jax.io.robots import LinkMeshes
from htcp_jax.model import robot
from htcp_jax.validation.mujoco_arm import ArmPoses, MujocoArm

SAMPLES, SEED = 10_000, 1
ALWAYS, NEARLY = 0.95, 0.93  # minimum share of samples within NEAR_M, without rule b in a list and with it
NEAR_M = 1e-3 + 1e-9  # a pair always within 1 mm could not satisfy a usual margin
Pair = tuple[int, int]
Distances = Callable[[ArmPoses, list[Pair]], Float[np.ndarray, "n R"]]


class OwnPairs(NamedTuple):
    """Pairs of an arm's capsules, by index: checked, tested by their meshes, and excluded."""

    checked: list[Pair]
    by_mesh: list[Pair]  # pairs whose meshes are tested
    excluded: list[Pair]


def own_pairs(arm: MujocoArm, measured: Distances) -> OwnPairs:
    """Return the pairs of an arm's capsules, classified by how they are checked.

    Args:
        arm: The arm.
        measured: Function that returns the distances of capsule pairs at the arm's poses [m].
    """
    stated, excluded = arm.stated, arm.excluded
    found, left = OwnPairs([], [], sorted(excluded)), [pair for pair in arm.apart if pair not in excluded]
    doubtful = [pair for pair in left if not arm.is_listed(pair) or pair in stated or arm.is_tool(pair)]
    distance = measured(arm.arm_poses(arm.random(SAMPLES, SEED)), doubtful)
    overlap, near = distance <= 0, dict(zip(doubtful, (distance <= NEAR_M).mean(axis=0).tolist(), strict=True))
    share = dict(zip(doubtful, overlap.mean(axis=0).tolist(), strict=True))
    for pair in left:
        rule = stated.get(pair)
        always = near.get(pair, 0.0) >= (NEARLY if rule == "b" else ALWAYS)
        joined = (arm.slides(pair) or (rule == "b" and arm.adjacent(pair))) and (
            overlap[:, [arm.same_links(pair, each) for each in doubtful]].any(axis=1).mean()
        )
        if always or rule == "a" or (not arm.is_tool(pair) and share.get(pair, 0.0) and joined >= ALWAYS):
            found.excluded.append(pair)
        elif rule == "c":
            (found.by_mesh if arm.meshes else found.excluded).append(pair)
        elif not arm.is_listed(pair) and not arm.is_tool(pair) and arm.adjacent(pair) and share.get(pair, 0.0):
            found.excluded.append(pair)
        else:
            found.checked.append(pair)
    return found


def touch_m(arm: MujocoArm, pair: Pair, x: Float[np.ndarray, "N"]) -> float:
    """Return the penetration depth of a pair's meshes [m]; depths up to TOUCHING_M count as 0.

    Args:
        arm: The arm, with meshes.
        pair: The pair of capsules whose meshes are tested.
        x: The configuration [rad or m].
    """
    meshes: LinkMeshes = arm.meshes
    deep = meshes.deepest_m(*(arm.names[k] for k in pair), meshes.poses(x[None]))
    return 0.0 if deep <= robot.TOUCHING_M else deep
