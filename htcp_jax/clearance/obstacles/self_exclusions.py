"""Pairs of capsules that need no check against each other.

Capsules are larger than links, so that some overlap in every configuration. A pair is excluded only if

a  the model excludes it: an <exclude> of MJCF, a <disable_collisions> of SRDF; or
b  it overlaps, or is within NEAR_M, in at least 95 % of 10,000 random configurations within the joint limits. If the
   links are not adjacent and there are the vendor's meshes, these must overlap by more than 1 mm as often. Or it
   overlaps in some of them, its links are adjacent, and some of their capsules overlap in at least 95 % of them: the
   links are joined by a slide, as in a telescope, or the vendor's meshes overlap by more than 1 mm as often, as in a
   bearing; or
c  it overlaps in some of these configurations, but in none of them the vendor's meshes in the two capsules overlap by
   more than 1 mm. Without meshes this applies to adjacent links only.

A pair with a capsule of the job's own tool, or of a fixture on a link, is excluded only by rule b, or if

d  the job excludes the fixture from tests against the link.
"""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Int

from htcp_jax.clearance.distance.segments import nearest_points
from htcp_jax.clearance.obstacles.obstacle import Scene
from htcp_jax.model import Robot, kinematics
from htcp_jax.model import robot as robots
from htcp_jax.numerics import safe_norm
from htcp_jax.types import Float

SAMPLES, SEED = 10_000, 0
ALWAYS = 0.95
NEAR_M = 1e-3 + 1e-9  # a pair that is always within 1 mm could not satisfy a usual margin; 1e-9 is for rounding
SLIDE_M = 1.0  # range of a slide without limits, to either side
TOGETHER, AT_ONCE = 500, 20_000  # numbers of configurations and of pairs measured at a time

Pairs = tuple[tuple[int, int], ...]
Samples = Float[np.ndarray, "n N"]
Ends = Float[np.ndarray, "n K 3"]
Indices = Int[np.ndarray, "m"]
Touch = Callable[[tuple[int, int], Bool[np.ndarray, "n"]], bool]
Share = Callable[[Pairs], float]


def candidates(robot: Robot) -> Pairs:
    """Return all pairs of capsules on different links; in each pair the capsule nearer to the tool is first."""
    link, bodies = robot.capsule_link, range(len(robot.capsule_link))
    return tuple((a, b) for a in bodies for b in bodies if link[a] > link[b])


def samples(robot: Robot, count: int = SAMPLES, seed: int = SEED) -> Samples:
    """Return `count` random configurations, uniform within the joint limits [rad or m].

    Hinges without limits are sampled from -pi to pi, slides without limits from -SLIDE_M to SLIDE_M.
    """
    free = np.where(robot.sliding, SLIDE_M, np.pi)
    lower, upper = np.asarray(robot.lower), np.asarray(robot.upper)
    lower, upper = np.where(np.isfinite(lower), lower, -free), np.where(np.isfinite(upper), upper, free)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))


def distances(robot: Robot, pairs: Sequence[tuple[int, int]], x: Samples) -> Float[np.ndarray, "n R"]:
    """Return the signed distance of the capsules of every pair at every configuration [m]."""
    p, q = _sampled_segments(robot, x)
    row, pair = np.indices((len(x), len(pairs))).reshape(2, -1)
    return _distances_in(robot, p, q, row, np.array(pairs)[pair]).reshape(len(x), -1)


def overlaps(
    robot: Robot, pairs: Sequence[tuple[int, int]], x: Samples
) -> tuple[Bool[np.ndarray, "n R"], Bool[np.ndarray, "n R"]]:
    """Return two masks for every pair at every configuration: the capsules overlap; they are at most NEAR_M apart.

    The results are those of `distances`, but capsules are only measured if the spheres about them are near.
    """
    p, q = _sampled_segments(robot, x)
    each = np.array(pairs)
    (a, b), middle = each.T, (p + q) / 2
    reach = np.linalg.norm(q - p, axis=2).max(axis=0) / 2 + np.asarray(robot.capsule_radius)
    overlap, near = np.zeros((2, len(x), len(pairs)), bool)
    for first in range(0, len(x), TOGETHER):
        apart = middle[first : first + TOGETHER, a] - middle[first : first + TOGETHER, b]
        row, pair = np.nonzero((apart**2).sum(axis=2) <= (reach[a] + reach[b] + 2 * NEAR_M) ** 2)
        found = _distances_in(robot, p, q, first + row, each[pair])
        overlap[first + row, pair], near[first + row, pair] = found <= 0, found <= NEAR_M
    return overlap, near


def find_exclusions(
    robot: Robot, touch: Touch | None = None, touching_share: Share | None = None
) -> tuple[robots.Exclusion, ...]:
    """Return the pairs that rules b and c exclude, without those that the model excludes.

    Args:
        robot: The robot.
        touch: Function of a pair and of a mask of the `samples` that returns True if the vendor's meshes in the two
            capsules touch in any of the marked samples. None: there are no meshes.
        touching_share: Function of pairs that returns the share of the `samples` in which the meshes of at least one of
            them touch [1].
    """
    stated = {(each.first, each.second) for each in robot.exclusions}
    pairs = [pair for pair in candidates(robot) if pair not in stated]
    if robot.listed:
        pairs = [pair for pair in pairs if set(pair) & set(robot.mounted)]
    pairs = [pair for pair in pairs if not any(set(pair) <= set(own) for own in robot.listed_together)]
    if not pairs:
        return ()
    overlap, is_near = overlaps(robot, pairs, samples(robot))
    near, found = is_near.mean(axis=0).tolist(), []

    @cache
    def always_touch(links: tuple[int, ...]) -> bool:
        same = [k for k, pair in enumerate(pairs) if _links(robot, pair) == links and overlap[:, k].any()]
        if overlap[:, same].any(axis=1).mean() < ALWAYS:
            return False
        return robot.slides[links[0]] or bool(
            touching_share and touching_share(tuple(pairs[k] for k in same)) >= ALWAYS
        )

    for k, (pair, share) in enumerate(zip(pairs, overlap.mean(axis=0).tolist(), strict=True)):
        own, adjacent = not set(pair) & set(robot.mounted), _adjacent(robot, pair)
        always = near[k] >= ALWAYS
        if always and touching_share and own and share and not adjacent:
            always = touching_share((pair,)) >= ALWAYS
        if always or (own and share and adjacent and always_touch(_links(robot, pair))):
            found.append(robots.Exclusion(*pair, "b", near[k] if always else share))
        elif own and share and (adjacent if touch is None else not touch(pair, overlap[:, k])):
            found.append(robots.Exclusion(*pair, "c", share))
    return tuple(found)


def _links(robot: Robot, pair: tuple[int, int]) -> tuple[int, ...]:
    return tuple(robot.capsule_link[k] for k in pair)


def _adjacent(robot: Robot, pair: tuple[int, int]) -> bool:
    first, second = _links(robot, pair)
    return first >= 0 and robot.parents[first] == second


def _sampled_segments(robot: Robot, x: Samples) -> tuple[Ends, Ends]:
    padded = Scene(dataclasses.replace(robot, pieces=None), ()).for_programs().robot  # arms share a program
    p, q = (np.asarray(ends)[:, : len(robot.capsule_link)] for ends in _padded_segments(padded, x))
    return p, q


@jax.jit
def _padded_segments(robot: Robot, x: Float[jax.Array, "n N"]) -> tuple[Float[jax.Array, "n K 3"], ...]:
    return jax.lax.map(lambda x: kinematics.capsule_segments(robot, x), jnp.asarray(x), batch_size=TOGETHER)


def _distances_in(robot: Robot, p: Ends, q: Ends, row: Indices, pair: Int[np.ndarray, "m 2"]) -> Float[np.ndarray, "m"]:
    """Return the signed distances of the capsules of m pairs, each at the configuration of one row [m]."""
    radius, found = np.asarray(robot.capsule_radius)[pair].sum(axis=1), np.empty(len(row))
    for first in range(0, len(row), AT_ONCE):
        some = np.resize(np.arange(first, min(first + AT_ONCE, len(row))), AT_ONCE)  # one size: it is compiled once
        a, b = pair[some].T
        apart = np.asarray(_apart(p[row[some], a], q[row[some], a], p[row[some], b], q[row[some], b]))
        found[first : first + AT_ONCE] = apart[: len(row) - first]
    return found - radius


@jax.jit
def _apart(*segments: Float[jax.Array, "m 3"]) -> Float[jax.Array, "m"]:
    _, _, on_a, on_b = nearest_points(*segments)
    return safe_norm(on_a - on_b)
