"""Proof that a joint path is a motion: the arm is clear along it, and the TCP stays in a tube about a line.

The proof is by bisection. An interval of the path is proven if every body's free radius at the middle is larger than
the motion of the body's points within the interval, relative to the obstacle, and the TCP can neither leave the tube
nor reverse. It is refuted if the middle itself is in collision, outside the tube, or moving backwards. Otherwise it is
halved or, if the proven clearance is not recorded, divided into up to eight equal parts, as many as the ratio of motion
to free radius suggests. There are three results: proven, refuted at a place, and undecided at the finest subdivision.

The TCP p(s) is bounded to second order. With |p''| <= A on an interval of half-width h about m,

    |p(s) - p(m) - (s - m) p'(m)| <= A h^2 / 2        |p'(s) - p'(m)| <= A h,

As the distance to a line is convex, the ends of the straight piece p(m) +- h p'(m) bound the distance on the piece.

The task's other rows are bounded in the same way, see `row_proof`. The clearance must be at least the tube's margin,
which may depend on the TCP's position, see `margin`.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike

from htcp_jax.clearance.obstacles.obstacle import HasWorkpiecePose, Scene
from htcp_jax.clearance.proof.bisection import Bisection, PathVerdict, Proof, moved_on
from htcp_jax.clearance.proof.interval import on_interval
from htcp_jax.clearance.proof.joint_path import JointPath, StraightPath
from htcp_jax.clearance.proof.known_rows import KnownRows
from htcp_jax.clearance.proof.margin import Margin
from htcp_jax.clearance.proof.motion_bound import ROUNDING_M, JointSweep, tcp_sweep
from htcp_jax.clearance.proof.row_proof import between, row_slacks
from htcp_jax.numerics import capsule_point_distance, product, safe_norm
from htcp_jax.types import Array, Bool, Float, Int, Joints, Scalar, Vector3

RESOLUTION_M = 1e-5  # penetration that `path_clear` may miss, as proofs of grazing paths take many halvings
KEPT_DEPTH = 6  # maximum number of halvings to increase the proven clearance
HALVED_DEPTH = 6  # from here on intervals are only halved: a contact is found at a middle, and halving has more of them
DEEPEST = 30  # maximum number of halvings; on the shortest interval a joint moves by less than 1e-8 rad


class Tube(NamedTuple):
    """Allowed region of the TCP: within `radius` of the line from `start` to `end`, along which it only advances.

    If start and end are one point, the TCP may move in any direction. With an infinite radius the TCP may be anywhere.
    In the tube, the arm must have the clearance `margin`.
    """

    start: Vector3  # world [m]
    end: Vector3
    radius: Scalar  # [m]
    goals: Float[Array, "2 G"] | None = None  # goals of the task at both targets; None: the paper's task
    required: Bool[Array, ""] | None = None  # True: the goals are required on all of the segment
    margin: Margin | None = None  # required clearance; None: only D > 0


def query_on(
    scene: Scene,
    where: HasWorkpiecePose,
    path: JointPath,
    tube: Tube | None,
    resolution_m: Float[ArrayLike, ""],
    deepest: Int[ArrayLike, ""],
    kept: Float[ArrayLike, ""],
) -> Callable[[Bisection, KnownRows | None], tuple[Bisection, KnownRows | None]]:
    """Return a function that checks the next interval of the bisection of a joint path.

    Repeated from `initial_state()` as long as the bisection is going, it proves or refutes that the path is clear, and
    that the TCP stays in the tube, if any, with the tube's margin. Its second argument and result are rows
    measured before, see `known_rows`; with None, all rows are measured in every interval. They do not change the proof.

    Args:
        scene: The scene.
        where: A scenario, or another `HasWorkpiecePose`.
        path: The joint path; goals of the task can be required on a straight one only.
        tube: Allowed region of the TCP; None: anywhere.
        resolution_m: The proof is D > -resolution_m on all of the path, and D > 0 at the sampled configurations. A
            larger clearance is proven where the tube's margin requires it.
        deepest: Maximum number of halvings. With fewer halvings, more paths near obstacles remain undecided.
        kept: Share of D at an interval's middle that must be proven on all of the interval [1]. Otherwise the interval
            is halved further, up to KEPT_DEPTH times. With 0, the recorded clearance is the required one.
    """
    line = jnp.zeros(3) if tube is None else tube.end - tube.start
    length = safe_norm(line)
    forwards = line / jnp.where(length > 0, length, 1.0)
    requested = None if tube is None or tube.goals is None else between(scene.task, tube.goals)
    if requested is not None and not isinstance(path, StraightPath):
        raise ValueError("goals of the task can be required on a straight joint path only")

    def check_next_interval(search: Bisection, known: KnownRows | None) -> tuple[Bisection, KnownRows | None]:
        index, depth, proof = search.index, search.depth, search.proof
        half = 0.5 * jnp.ldexp(1.0, -depth)
        place = (2 * index + 1).astype(half.dtype) * half
        x, sweep = path.about(place, half)
        stays, broken = jnp.full((), True), jnp.full((), int(PathVerdict.VALID), jnp.int32)
        if tube is not None:
            stays, broken = _in_tube(scene, tube, forwards, x, sweep)
        if requested is not None:
            rows = row_slacks(scene.robot, scene.task.parts, requested, x, sweep.rates, half)
            stays &= jnp.all(rows.left >= 0) | ~tube.required
            out = jnp.any(rows.broken) & tube.required
            broken = jnp.where((broken == PathVerdict.VALID) & out, int(PathVerdict.OFF_PATH), broken)
        keeps, going_on = depth < KEPT_DEPTH, stays & (broken == PathVerdict.VALID)
        least, at_middle = -resolution_m, -jnp.inf
        if tube is not None and tube.margin is not None:
            p, v, bend, off = tcp_sweep(scene.robot, x, sweep)
            at_middle, travel = tube.margin.at(p), half * safe_norm(v) + 0.5 * bend * half * half + ROUNDING_M
            travel = travel if off is None else travel + off
            least = jnp.maximum(least, tube.margin.at(p, travel))
        there, known = on_interval(scene.robot, scene.obstacles, where, x, sweep, least, kept, keeps, going_on, known)
        proven = stays & there.proven
        nearer = (broken == PathVerdict.VALID) & (there.middle < at_middle - ROUNDING_M)
        broken = jnp.where(nearer, int(PathVerdict.BELOW_MARGIN), broken)
        verdict = jnp.where(there.middle <= 0, int(PathVerdict.IN_COLLISION), broken)
        verdict = jnp.where(
            (verdict == PathVerdict.VALID) & ~proven & (depth >= deepest), int(PathVerdict.UNDECIDED), verdict
        )
        found = Proof(
            verdict,
            jnp.where(verdict == PathVerdict.VALID, 1.0, place),
            jnp.where(proven, jnp.minimum(proof.clearance, there.clear), proof.clearance),
            proof.queries + 1,
            jnp.maximum(proof.depth, depth.astype(jnp.int32)),
        )
        most = jnp.where(depth < HALVED_DEPTH, jnp.maximum(deepest - depth, 1), 1)
        halvings = jnp.minimum(there.halvings, most)
        return moved_on(search, proven, halvings, found), known

    return check_next_interval


def _in_tube(scene: Scene, tube: Tube, forwards: Vector3, x: Joints, sweep: JointSweep):
    """Return True if the TCP is proven to stay in the tube on an interval about x, and the `PathVerdict` at x."""
    p, v, bend, away = tcp_sweep(scene.robot, x, sweep)
    half, bend = sweep.half, bend * sweep.half
    off, before, after = _off_line(tube, jnp.stack([p, p - half * v, p + half * v]))
    farthest = jnp.maximum(before, after) + 0.5 * bend * half + ROUNDING_M
    stays = (farthest if away is None else farthest + away) <= tube.radius
    speed, is_line = product(forwards, v), jnp.any(forwards != 0)
    inside = stays & (~is_line | (speed >= bend))
    verdict = jnp.where(is_line & (speed < 0), int(PathVerdict.REVERSES), int(PathVerdict.VALID))
    verdict = jnp.where(off > tube.radius, int(PathVerdict.OFF_PATH), verdict).astype(jnp.int32)
    bounded = jnp.isfinite(tube.radius)
    return inside | ~bounded, jnp.where(bounded, verdict, int(PathVerdict.VALID))


def _off_line(tube: Tube, points: Float[Array, "n 3"]) -> Float[Array, "n"]:
    start, end = (jnp.broadcast_to(point, points.shape) for point in (tube.start, tube.end))
    return capsule_point_distance(start, end, 0.0, points)
