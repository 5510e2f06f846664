"""Tool orientations that may be clear with the tip on a target, as a cover of cells.

Cells that certainly collide, or violate a row of the task about the tool's orientation, are excluded. Orientations are
unit quaternions; q and -q are the same rotation. They are projected onto four faces of a cube in four dimensions: on
each face one component is 1, and the others are between -1 and 1. A face is subdivided into cubes, which are halved.
The projection maps straight lines to great circles, so the unit quaternions of a cube are the convex hull of those at
its corners on the sphere. Of all rotations in a cube, one at a corner is the farthest from the rotation at the centre.

A proof that a target has no clear configuration also uses the arm behind the tool. For an arm with an elbow and a
spherical wrist, a cell of orientations has up to eight branches of configurations. A branch is excluded if it certainly
collides or violates a joint limit; a cell is excluded if it has no branch left (`branch_exclusion`).

For other arms with a wrist there is a second cover: boxes of values of the joints before the wrist. At each step the
cells of the smaller cover are halved. A cell is removed if it certainly collides, or if its wrist position cannot
coincide with that of any cell in the other cover (`exclusion`). An arm without a wrist has only the first cover.

`exclusions` names the fewest bodies of the arm with which a target is proven to have no clear configuration.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Bool, Float, Int

from htcp_jax.clearance import Scene
from htcp_jax.clearance.proof import branch_exclusion, exclusion
from htcp_jax.device import Executor, lane_function, tables
from htcp_jax.model import Robot, kinematics, quaternion_matrix
from htcp_jax.motion.lane_inputs import LaneInputs
from htcp_jax.settings import Settings
from htcp_jax.status import Exclusion

MANY = lane_function.DeviceSizes(
    cpu=lane_function.BatchSize(1024, 1), gpu=lane_function.BatchSize(4096, 4096)
)  # for calls with thousands of lanes
FACES = 4
FINEST = 2.0**-24  # smallest half side of a cube
ROUNDING_RAD = 1e-8  # upper bound on the rounding error of any angle
SMALLEST_FIRST = {
    exclusion.Bodies.NONE: Exclusion.OUT_OF_REACH,
    exclusion.Bodies.TOOL: Exclusion.TOOL,
    exclusion.Bodies.WRIST: Exclusion.WRIST,
}


class Cells(NamedTuple):
    """Cells of a cover: cubes, and bounds on the wrist's position in each."""

    lane: Int[np.ndarray, "n"]  # index of the target
    face: Int[np.ndarray, "n"]  # index of the face; 0 in the second cover
    cube: Float[np.ndarray, "n d"]  # centres, each coordinate between -1 and 1
    half: Float[np.ndarray, "n"]  # half side
    wrist: Float[np.ndarray, "n 3"]  # position of the wrist in one configuration of the cell, world [m]
    moves: Float[np.ndarray, "n"]  # maximum distance of the wrist from this position [m]
    branches: Int[np.ndarray, "n"]  # bit k is set if branch k is not excluded, see `branch_exclusion`

    @property
    def quaternion(self) -> Float[np.ndarray, "n 4"]:
        """Orientations at the centres, w, x, y, z."""
        q = np.ones((len(self.face), FACES))
        others = np.array([[k for k in range(FACES) if k != one] for one in range(FACES)])[self.face]
        np.put_along_axis(q, others, self.cube, axis=1)
        return _unit(q)

    @property
    def radius_rad(self) -> Float[np.ndarray, "n"]:
        """Largest angle between the rotation at a cube's centre and any other rotation in the cube."""
        corners = self.cube[:, None] + self.half[:, None, None] * _signs(self.cube.shape[1])
        away = _unit(np.insert(corners, 0, 1.0, axis=-1)) - _unit(np.insert(self.cube, 0, 1.0, axis=-1))[:, None]
        return 4 * np.arcsin(0.5 * np.linalg.norm(away, axis=-1).max(axis=1))

    def halves(self) -> "Cells":
        """Return the 2^d halves of every cube; their wrist positions are not set yet."""
        signs = _signs(self.cube.shape[1])
        cube = (self.cube[:, None] + 0.5 * self.half[:, None, None] * signs).reshape(-1, signs.shape[1])
        return tables.gather(self, np.repeat(np.arange(len(self.lane)), len(signs)))._replace(
            cube=cube, half=0.5 * np.repeat(self.half, len(signs))
        )


def tool(settings: Settings, scene: Scene, lane: LaneInputs, quaternion, rho, bodies) -> exclusion.CellBounds:
    """Return the `CellBounds` of the tool's orientations within `rho` of a quaternion.

    An orientation that violates a row of the task counts as colliding.

    Args:
        settings: Not used.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        quaternion: Orientation of the last link (4,), w first.
        rho: Radius [rad].
        bodies: The bodies that the proof may use, see `exclusion.Bodies`.
    """
    robot, task = scene.robot, scene.task
    cell = exclusion.ToolCell(task.tcp_place(lane.target), quaternion, rho)
    bounds = exclusion.tool_cell(scene, lane, cell, bodies)
    turn = task.least_turn(robot, quaternion_matrix(quaternion), lane.target)
    return bounds._replace(collides=bounds.collides | (turn > rho + ROUNDING_RAD))


def cell_bounds(settings: Settings, scene: Scene, lane: LaneInputs, cube, half, bodies) -> exclusion.CellBounds:
    """Return the `CellBounds` of a box of the coordinates that move the joints before the wrist.

    The box is a cube in which -1 to 1 is each coordinate's range; the range of a hinge is one revolution at most.

    Args:
        settings: Not used.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        cube: Centre of the cube (d,), no unit.
        half: Half of the cube's side, no unit.
        bodies: The bodies that the proof may use, see `exclusion.Bodies`.
    """
    robot = scene.robot
    lower = jnp.where(jnp.isfinite(robot.lower), robot.lower, -jnp.pi)
    periodic = kinematics.is_periodic(robot)
    upper = jnp.where(jnp.array(~periodic), robot.upper, jnp.minimum(robot.upper, lower + 2 * jnp.pi))
    if robot.coupling is None:
        cube = jnp.pad(cube, (0, exclusion.WRIST))
    else:
        free = exclusion.before_wrist(robot)
        cube = jnp.where(free, cube[jnp.cumsum(free) - 1], 0.0)
    x = 0.5 * (lower + upper + (upper - lower) * cube)
    turns = 0.5 * (upper - lower) * half
    return exclusion.arm_cell(scene, lane, scene.task.tcp_place(lane.target), x, turns, bodies)


def branch(settings: Settings, scene: Scene, lane: LaneInputs, quaternion, rho, number, bodies):
    """Return True if a branch is excluded, for all tool orientations within `rho` of a quaternion.

    Args:
        settings: Not used.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        quaternion: Orientation of the last link (4,), w first.
        rho: Radius [rad].
        number: Index of the branch.
        bodies: The bodies that the proof may use, see `exclusion.Bodies`.
    """
    cell = exclusion.ToolCell(scene.task.tcp_place(lane.target), quaternion, rho)
    return branch_exclusion.branch_collides(scene, lane, cell, number, bodies)


TOOL, ARM = lane_function.LaneFunction("tool", tool, MANY), lane_function.LaneFunction("arm", cell_bounds, MANY)
BRANCH = lane_function.LaneFunction("branch", branch, MANY)


def tool_cells(
    executor: Executor,
    inputs: LaneInputs,
    resolution_rad: float,
    most: int,
    robot: Robot | None = None,
    bodies: exclusion.Bodies = exclusion.Bodies.ARM,
) -> Cells:
    """Return the cells in which the tool may be clear, for n targets.

    Cells are halved down to the resolution, or as long as a target's cover has at most `most` cells. A target without
    cells has no configuration that satisfies the margin.

    Args:
        executor: Compiled functions of the scene.
        inputs: The lanes' inputs, one row per target.
        resolution_rad: Radius of a cell below which it is not halved.
        most: Maximum number of cells in either cover at a target.
        robot: The arm, to use the joints behind the tool as well; None: only the tool.
        bodies: The bodies that may exclude a cell.
    """
    lanes = len(inputs.row)
    by_branch = robot is not None and branch_exclusion.has_branches(robot)
    covers = [_complete_cover(lanes, FACES, 3)]
    if robot is not None and not by_branch and exclusion.has_wrist(robot):
        covers.append(_complete_cover(lanes, 1, int(np.asarray(exclusion.before_wrist(robot)).sum())))
    going, done = np.ones(lanes, bool), []
    while going.any():
        smaller = np.argmin([np.bincount(cells.lane, minlength=lanes) for cells in covers], axis=0)
        halved = [_halved_cells(executor, inputs, k, cells, smaller == k, bodies) for k, cells in enumerate(covers)]
        if by_branch:
            halved = [_with_branches(executor, inputs, halved[0], bodies)]
        halved = [tables.gather(own, _meets(own, other)) for own, other in zip(halved, halved[::-1], strict=True)]
        counts = np.array([np.bincount(cells.lane, minlength=lanes) for cells in halved])
        too_many = (counts > most).any(axis=0)
        small = _largest(halved[0], halved[0].radius_rad, lanes) <= resolution_rad
        tiny = np.min([_largest(cells, cells.half, lanes) for cells in halved], axis=0) < FINEST
        done.append(tables.gather(covers[0], too_many[covers[0].lane]))
        done.append(tables.gather(halved[0], (~too_many & (small | tiny))[halved[0].lane]))
        going &= ~(too_many | small | tiny)
        covers = [tables.gather(cells, going[cells.lane]) for cells in halved]
    found = tables.concatenate(done)
    return tables.gather(found, np.argsort(found.lane, kind="stable"))


def excluded(
    executor: Executor,
    robot: Robot | None,
    inputs: LaneInputs,
    most: int,
    bodies: exclusion.Bodies = exclusion.Bodies.ARM,
) -> Bool[np.ndarray, "n"]:
    """Return True for each of n targets that is proven to have no configuration that satisfies the margin.

    Args:
        executor: Compiled functions of the scene.
        robot: The arm; None: the proof does not use the joints behind the tool.
        inputs: The lanes' inputs, one row per target.
        most: Maximum number of cells in either cover at a target.
        bodies: The bodies that the proof uses.
    """
    clear = tool_cells(executor, inputs, 0.0, most, robot, bodies)
    return ~np.isin(np.arange(len(inputs.row)), clear.lane)


def _signs(d: int) -> Float[np.ndarray, "m d"]:
    """Return the corners of a cube with d coordinates, each of them -1 or 1."""
    return np.stack(np.meshgrid(*[[-1.0, 1.0]] * d, indexing="ij"), axis=-1).reshape(-1, d)


def _unit(q: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n d"]:
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def _complete_cover(lanes: int, faces: int, numbers: int) -> Cells:
    """Return the initial cover of each target: all cells, with unbounded wrist positions."""
    lane, face = np.repeat(np.arange(lanes), faces), np.tile(np.arange(faces), lanes)
    n = len(lane)
    every = np.full(n, 2**branch_exclusion.BRANCHES - 1)
    return Cells(lane, face, np.zeros((n, numbers)), np.ones(n), np.zeros((n, 3)), np.full(n, np.inf), every)


def _largest(cells: Cells, column: np.ndarray, lanes: int) -> np.ndarray:
    """Return the maximum of a column over each target's cells; 0 for a target without cells."""
    largest = np.zeros(lanes)
    np.maximum.at(largest, cells.lane, column)
    return largest


def _halved_cells(
    executor: Executor, inputs: LaneInputs, number: int, cells: Cells, at: np.ndarray, bodies: exclusion.Bodies
) -> Cells:
    """Return cover number 0 or 1 after halving its cells `at` some targets, without halves that certainly collide."""
    now = at[cells.lane]
    fresh = tables.gather(cells, now).halves()
    if not len(fresh.lane):
        return cells
    lane_function, cell = (ARM, (fresh.cube, fresh.half)) if number else (TOOL, (fresh.quaternion, fresh.radius_rad))
    use = np.full(len(fresh.lane), int(bodies))
    found = executor(lane_function, tables.gather(inputs, fresh.lane), *cell, use)
    fresh = tables.gather(fresh._replace(wrist=found.wrist, moves=found.moves), ~found.collides)
    return tables.concatenate([tables.gather(cells, ~now), fresh])


def _with_branches(executor: Executor, inputs: LaneInputs, cells: Cells, bodies: exclusion.Bodies) -> Cells:
    """Return the cells that have a branch left, after excluding branches."""
    row, number = np.nonzero(cells.branches[:, None] >> np.arange(branch_exclusion.BRANCHES) & 1)
    if not len(row):
        return cells
    where, use = (cells.quaternion[row], cells.radius_rad[row], number), np.full(len(row), int(bodies))
    out = executor(BRANCH, tables.gather(inputs, cells.lane[row]), *where, use)
    branches = cells.branches - np.bincount(row, (1 << number) * out, minlength=len(cells.lane)).astype(int)
    return tables.gather(cells._replace(branches=branches), branches > 0)


def _meets(own: Cells, other: Cells) -> Bool[np.ndarray, "n"]:
    """Return True for each cell whose wrist positions can meet those of a cell in the other cover."""
    meets = np.zeros(len(own.lane), bool)
    for k in np.unique(other.lane):
        here, there = own.lane == k, other.lane == k
        away = scipy.spatial.cKDTree(other.wrist[there]).query(own.wrist[here])[0]
        meets[here] = away <= own.moves[here] + other.moves[there].max()
    return meets


def exclusions(executor: Executor, robot: Robot, inputs: LaneInputs, cells: int) -> Int[np.ndarray, "n"]:
    """Return, for each of n targets, why it has no clear configuration: an `Exclusion`, NONE without a proof.

    Args:
        executor: Compiled functions of the scene, whose task fixes the TCP's position.
        robot: The arm, without the scenarios' tool extensions.
        inputs: The lanes' inputs, one row per target.
        cells: Maximum number of cells of a proof, see `tool_cells.excluded`.
    """
    found = np.where(_beyond(executor, robot, inputs), Exclusion.OUT_OF_REACH, Exclusion.NONE).astype(int)
    of, proofs = Exclusion.NONE, {exclusion.Bodies.ARM: Exclusion.ARM} | SMALLEST_FIRST
    for bodies, reason in proofs.items():
        left = np.flatnonzero(found == of)
        if len(left):
            found[left[excluded(executor, robot, tables.gather(inputs, left), cells, bodies)]] = reason
        of = Exclusion.ARM
    return found


def _beyond(executor: Executor, robot: Robot, inputs: LaneInputs) -> Bool[np.ndarray, "n"]:
    """Return True for targets farther away from the base than the length of the arm."""
    task = executor.task
    away = np.linalg.norm(task.tcp_place(inputs.target) - np.asarray(robot.T_parent_joint)[0, :3, 3], axis=1)
    return away > kinematics.max_reach(robot) + inputs.tool_extension_m + task.tolerance_m
