"""Search for a collision-free configuration at a target, complete at a given resolution of tool orientations.

With its tip on the target, an arm with six joints has three degrees of freedom left: the tool's orientation. Cells of a
given radius (`motion.tool_cells`) cover all orientations, except those in which the tool certainly collides. For each
cell, Newton's method solves for the orientation at the cell's centre. It starts from several seeds, those of many
configurations with known poses that are nearest, to find all IK branches (elbow up or down and so on). The results are
moved onto the target. The clearest ones that are far apart are then pushed clear by null-space steps. An arm with more
joints has further redundancy, which only the seeds cover.

If a task does not constrain the tip's position, there are no cells: configurations spread over the joint limits are
moved onto the target, and the search is not complete.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy
from jaxtyping import Float, Int

from htcp_jax.clearance import Scene, minimum_clearance
from htcp_jax.device import lane_function, tables
from htcp_jax.model import Robot, damped_step, kinematics, moved_by, quaternion_matrix, reanchor, sine_error
from htcp_jax.model import robot as robots
from htcp_jax.motion import CollisionChecker, configurations, lane_inputs, step_functions, tool_cells
from htcp_jax.numerics import product
from htcp_jax.planning.tracking import stages
from htcp_jax.settings import Settings

CELLS = 20_000  # maximum number of cells per target; the resolution is coarsened if there would be more
SEEDS, KNOWN = 12, 2**15  # numbers of seeds of Newton's method per cell, and of known configurations to select from
SPREAD = 2**13  # number of known configurations that are tried if there are no cells
STEPS, DAMPING = 12, 1e-5  # iterations of Newton's method, and its damping [m2/rad2]
PUSHED = 64  # maximum number of configurations pushed clear at a target
APART_RAD = 0.2  # configurations closer than this are treated as one
CARRIED = 6  # maximum number of configurations carried from a target to the next
HOPS, HOPPED = 2, 8  # rounds of random moves, and number of the clearest configurations moved in each
HOP = 0.15  # standard deviation of the moves in the first round [rad or m]
LENGTH_M = 0.3  # distance of the tool's tip that is equivalent to a rotation of the tool by 1 rad
TURN_M = LENGTH_M / np.sqrt(2)  # the same for rotation matrices, whose distance is sqrt(2) times the angle

OnTarget = tuple[Int[np.ndarray, "m"], Float[np.ndarray, "m N"]]  # indices of targets, and configurations on them


class SearchResult(NamedTuple):
    """Result of a search at n targets, each by itself."""

    at: step_functions.State  # (n, PUSHED, ...): pushed configurations, clearest first; unused rows have clearance -inf
    resolution_rad: Float[np.ndarray, "n"]  # radius of the cells; 0 where the tool collides in every orientation


def aim(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x, quaternion) -> step_functions.State:
    """Return a configuration on the target, with the last link as close as possible to a given orientation.

    The method is damped least squares within the joint limits (Siciliano et al., Robotics, section 3.7).

    Args:
        settings: Not used.
        scene: Arm, obstacles and task.
        lane: The lane's inputs.
        x: Configuration to start from (N,) [rad or m].
        quaternion: Orientation of the last link (4,), w first.

    Returns:
        The configuration and its residual; the clearance is not measured.
    """
    robot, task = scene.robot, scene.task
    place, turned = task.tcp_place(lane.target), quaternion_matrix(quaternion)

    def step(_, x):
        turn = sine_error(_last_rotation(robot, x), turned)
        error = jnp.concatenate([place - kinematics.tcp_position(robot, x), LENGTH_M * turn])
        jac = jnp.concatenate([kinematics.jacobian(robot, x), LENGTH_M * _angular_velocity(robot, x)])
        return damped_step(robot, x, error, jac, DAMPING)

    x = jax.lax.fori_loop(0, STEPS, step, x)
    x, residual = reanchor(robot, x, lane.target, task.fine_m, task=task)
    return step_functions.State(x, clearance=jnp.zeros(()), residual=residual)


def measure(settings: Settings, scene: Scene, lane: lane_inputs.LaneInputs, x):
    """Return the clearance D at x (N,) [rad or m]."""
    return minimum_clearance(scene.robot, scene.obstacles, lane, x)


AIM = lane_function.LaneFunction("aim", aim, tool_cells.MANY)
MEASURE = lane_function.LaneFunction("measure", measure, tool_cells.MANY)


def _scaled_pose(robot: Robot, x):
    """Return the TCP's position and the last link's rotation matrix, both scaled to metres."""
    return jnp.concatenate([kinematics.tcp_position(robot, x), TURN_M * _last_rotation(robot, x).ravel()])


def _last_rotation(robot: Robot, x):
    """Return the rotation matrix of the last link, which carries the TCP."""
    return kinematics.link_poses(robot, x)[robot.tcp_link, :3, :3]


class ConfigurationSearch:
    """Searches for collision-free configurations at targets, each by itself.

    Args:
        checker: Collision checker of the scene.
        robot: The arm, without the scenarios' tool extensions.
        extensions_m: Tool extensions of the scenarios (S,).
    """

    def __init__(self, checker: CollisionChecker, robot: Robot, extensions_m: np.ndarray):
        self.checker, self.robot, self._executor = checker, robot, checker.executor
        # Configurations spread evenly within the joint limits (Halton), and a tree of their poses for each extension
        lower, upper = np.maximum(robot.lower, -np.pi), np.minimum(robot.upper, np.pi)
        self._known = lower + (upper - lower) * scipy.stats.qmc.Halton(len(lower), scramble=False).random(KNOWN)
        pose = jax.jit(jax.vmap(_scaled_pose, in_axes=(None, 0)))
        tools = {float(own_m): robots.lengthen_tool(robot, float(own_m)) for own_m in np.unique(extensions_m)}
        self._trees = {own_m: scipy.spatial.cKDTree(np.asarray(pose(own, self._known))) for own_m, own in tools.items()}

    def search(self, inputs: lane_inputs.LaneInputs, resolution_rad: float) -> SearchResult:
        """Return collision-free configurations at n targets.

        Args:
            inputs: The lanes' inputs, one row per target.
            resolution_rad: Radius of the cells of tool orientations.
        """
        lanes, joints = len(inputs.row), self._known.shape[1]
        x, best = np.zeros((lanes, PUSHED, joints)), np.full((lanes, PUSHED), -np.inf)
        if self.checker.task.holds_tcp:
            cells = tool_cells.tool_cells(self._executor, inputs, resolution_rad, CELLS)
            lane, radius_rad, on = cells.lane, cells.radius_rad, self._aimed(inputs, cells)
        else:
            lane, radius_rad, on = np.arange(lanes), np.full(lanes, np.pi), self._settled(inputs)
        self._push(inputs, x, best, *self._clearest_apart(inputs, *on))
        for round_ in range(HOPS):
            lost = np.flatnonzero((best[:, 0] < inputs.margin_m) & (best[:, 0] > -np.inf)).tolist()
            moves = [_random_moves(inputs, k, round_, joints) for k in lost]
            aside = [
                np.repeat(x[k, :HOPPED], PUSHED // HOPPED, axis=0) + own for k, own in zip(lost, moves, strict=True)
            ]
            self._push(inputs, x, best, np.repeat(lost, PUSHED), np.concatenate([np.empty((0, joints)), *aside]))
        coarsest = np.zeros(lanes)
        np.maximum.at(coarsest, lane, radius_rad)
        residual = np.where(best > -np.inf, 0.0, np.inf)  # infinite for empty rows
        return SearchResult(step_functions.State(x, clearance=best, residual=residual), coarsest)

    def carried(self, inputs: lane_inputs.LaneInputs, beam: list[np.ndarray]) -> list[np.ndarray]:
        """Push each target's `beam` clear at the target; return the clear, distinct configurations, clearest first."""
        lane = np.repeat(np.arange(len(beam)), [len(own) for own in beam])
        here = self._executor(stages.PUSH, tables.gather(inputs, lane), np.concatenate(beam))
        return self._clear(inputs, lane, len(beam), here)

    def searched(self, inputs: lane_inputs.LaneInputs, here: step_functions.State) -> list[np.ndarray]:
        """Return, for each target, the clear and distinct configurations found by a search, clearest first."""
        lanes = len(here.x)
        lane = np.repeat(np.arange(lanes), PUSHED)
        at = jax.tree.map(lambda table: table.reshape(len(lane), *table.shape[2:]), here)
        return self._clear(inputs, lane, lanes, at)

    def _clear(
        self, inputs: lane_inputs.LaneInputs, lane: np.ndarray, lanes: int, here: step_functions.State
    ) -> list[np.ndarray]:
        good = self.checker.valid(tables.gather(inputs, lane), here)
        return [_dispersed(here.x[own], here.clearance[own]) for own in (good & (lane == k) for k in range(lanes))]

    def _push(
        self, inputs: lane_inputs.LaneInputs, x: np.ndarray, best: np.ndarray, lane: np.ndarray, start: np.ndarray
    ) -> None:
        """Push the configurations `start` clear, and merge the clearest of each target into `x` and `best`."""
        if not len(lane):
            return
        pushed = self._executor(stages.PUSH, tables.gather(inputs, lane), start)
        on = np.where(self.checker.task.reached(pushed.residual), pushed.clearance, -np.inf)
        for k in np.unique(lane):
            own = lane == k
            D, both = np.concatenate([best[k], on[own]]), np.concatenate([x[k], pushed.x[own]])
            order = np.argsort(-D, kind="stable")[:PUSHED]
            x[k], best[k] = both[order], D[order]

    def _aimed(self, inputs: lane_inputs.LaneInputs, cells: tool_cells.Cells) -> OnTarget:
        """Return configurations on the targets, found by Newton's method for all cells of tool orientations."""
        which, seeds = self._seeds(inputs, cells)
        lane = cells.lane[which]
        if not len(lane):
            return lane, seeds
        at = self._executor(AIM, tables.gather(inputs, lane), seeds, cells.quaternion[which])
        on = self.checker.task.reached(at.residual)
        return lane[on], at.x[on]

    def _settled(self, inputs: lane_inputs.LaneInputs) -> OnTarget:
        """Return configurations on the targets, found by inverse kinematics from seeds spread over the joint limits."""
        lanes = len(inputs.row)
        lane, seeds = np.repeat(np.arange(lanes), SPREAD), np.tile(self._known[:SPREAD], (lanes, 1))
        x = self.checker.project(tables.gather(inputs, lane), seeds)
        on = self.checker.task.reached(self.checker.states(tables.gather(inputs, lane), x).residual)
        return lane[on], x[on]

    def _clearest_apart(self, inputs: lane_inputs.LaneInputs, lane: np.ndarray, x: np.ndarray) -> OnTarget:
        """Return up to PUSHED configurations per target, the clearest first, at least APART_RAD apart."""
        kept: list[np.ndarray] = [np.empty(0, int)]
        for k in np.unique(lane):
            own = np.flatnonzero(lane == k)
            own = own[np.unique(np.round(x[own] / (0.5 * APART_RAD)).astype(int), axis=0, return_index=True)[1]]
            D = self._executor(MEASURE, tables.gather(inputs, lane[own]), x[own])
            own = own[np.argsort(-D, kind="stable")]
            kept.append(own[configurations.first_apart(x[own], 0, PUSHED, APART_RAD)])
        return tables.gather((lane, x), np.concatenate(kept))

    def _seeds(self, inputs: lane_inputs.LaneInputs, cells: tool_cells.Cells):
        """Return the known configurations whose poses are nearest to each cell, and the index of each one's cell."""
        which, seeds = [], []
        extension, place = inputs.tool_extension_m[cells.lane], self.checker.task.tcp_place(inputs.target)
        R = scipy.spatial.transform.Rotation.from_quat(cells.quaternion, scalar_first=True).as_matrix().reshape(-1, 9)
        for own_m, tree in self._trees.items():
            own = np.flatnonzero(extension == own_m)
            near = tree.query(np.hstack([place[cells.lane[own]], TURN_M * R[own]]), SEEDS)[1]
            which.append(np.repeat(own, SEEDS))
            seeds.append(self._known[near.ravel()])
        return np.concatenate(which), np.concatenate(seeds)


def _dispersed(x: np.ndarray, clearance: np.ndarray) -> np.ndarray:
    """Return up to CARRIED configurations: the clearest, then each time the one farthest from those selected so far."""
    if not len(x):
        return x
    return x[configurations.farthest_first(x, int(np.argmax(clearance)), CARRIED, APART_RAD)]


def _random_moves(inputs: lane_inputs.LaneInputs, k: int, round_: int, joints: int) -> np.ndarray:
    """Return random joint displacements for target k [rad or m], independent of other targets."""
    own = np.random.default_rng([inputs.seed[k], inputs.number[k], inputs.row[k], round_])
    return HOP * 0.6**round_ * own.normal(size=(PUSHED, joints))


def _angular_velocity(robot: Robot, x):
    """Return the last link's angular velocity per unit velocity of each joint, (3, N)."""
    poses = kinematics.link_poses(robot, x)
    axes = product(poses[:, :3, :3], robot.axis[:, :, None])[..., 0]
    turns = moved_by(robot.parents)[robot.tcp_link] & ~jnp.asarray(robot.slides)
    return kinematics.by_coordinates(robot, jnp.where(turns[:, None], axes, 0.0).T)
