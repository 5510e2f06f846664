"""Plans to look at: where the arm, the cloud and the targets are, target by target.

    shelf = open_shelf("out/workpiece")         # a run of htcp sweep, a plan of htcp plan, or a job to plan now
    replay = shelf.replay(12, "nspace-sqp")
    replay.x[40]                                # the posture at target 40

A picture or a viewer needs nothing else of the package than a `Replay`.
"""

from collections.abc import Callable, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int8

from htcp_jax.clearance.obstacle import Obstacles
from htcp_jax.clearance.obstacles import contacts
from htcp_jax.clearance.of_workpiece import make_obstacle
from htcp_jax.errors import InputError
from htcp_jax.formats.strict_model import validate
from htcp_jax.jobs.build import arm_of, part_of, robot_of, scene, workpiece_of
from htcp_jax.jobs.config import PlanConfig
from htcp_jax.planner.obstruction import Obstruction, last_posture, obstructions
from htcp_jax.planner.plans import Plans, is_tracked
from htcp_jax.runs.identity import refuse_changed
from htcp_jax.runs.labels import labels_of
from htcp_jax.runs.plan_folder import SUMMARY, TRAJECTORY, read_plan
from htcp_jax.runs.run_folder import MANIFEST, Run, open_run
from htcp_jax.scene.kinematics import capsule_segments, tcp_position
from htcp_jax.scene.robot import Robot, lengthen_tool
from htcp_jax.scene.scenario import Scenario, gate_of, with_own_tool
from htcp_jax.scene.surface import Surface, surface_of
from htcp_jax.scene.workpiece import Workpiece
from htcp_jax.viewer.colours import is_tool
from htcp_jax.viewer.sides import Bodies, Side, camera_side

LOOKED_AT = 5  # postures by which the side to look from is chosen
ARRAYS = tuple(name for name in Plans._fields if name not in ("compile_s", "run_s"))
XYZ = "xyz"
MOST_SHELVES = 8  # robots and workpieces of one run in memory


class Placement(NamedTuple):
    """How one scenario differs from the others of its shelf; what `clearance.Posed` asks for, and the arm's."""

    T_world_workpiece: Float[np.ndarray, "4 4"]
    gate: Float[np.ndarray, "4"]
    x_start: Float[np.ndarray, "N"]
    tool_extension_m: float


class Witness(NamedTuple):
    """The pair of points of the smallest distance, at each of T targets."""

    body: list[str]  # the capsule's name
    arm: Float[np.ndarray, "T 3"]  # on its surface, world [m]
    cloud: Float[np.ndarray, "T 3"]  # the cloud's point, or the one on the hull that the capsule's end has crossed


class Replay(NamedTuple):
    """One method's plan of one scenario. At the target that failed the arm is brought there all the same, into what is
    in the way; where nothing was attempted it stays where it was tracked last."""

    method: str
    number: int  # of the scenario
    label: str  # its number and what sets it apart
    robot: Robot  # with the scenario's tool
    surface: Surface  # of the cloud; world [m], as is all that follows
    path: int  # targets from here on are the tool path; the ones before lead to it
    target: Float[np.ndarray, "T 3"]
    status: Int8[np.ndarray, "T"]
    clearance: Float[np.ndarray, "T"]  # NaN where not tracked
    residual: Float[np.ndarray, "T"]
    x: Float[np.ndarray, "T N"]
    p: Float[np.ndarray, "T K 3"]  # ends of the capsules' axes
    q: Float[np.ndarray, "T K 3"]
    tcp: Float[np.ndarray, "T 3"]
    witness: Witness
    obstruction: Obstruction | None  # at the target that failed
    side: Side  # to look from

    @property
    def cloud(self) -> Float[np.ndarray, "P 3"]:
        """The points to draw; the clearance is to all of the workpiece's."""
        return self.surface.points

    @property
    def tracked(self) -> int:
        """The number of tracked targets."""
        return int(is_tracked(self.status).sum())

    @property
    def failed(self) -> int | None:
        """The first target that is not tracked."""
        missed = np.flatnonzero(~is_tracked(self.status))
        return int(missed[0]) if missed.size else None


class Outcome(NamedTuple):
    """What became of one scenario."""

    number: int
    tracked: int
    targets: int

    @property
    def complete(self) -> bool:
        """Whether every target is tracked."""
        return self.tracked == self.targets


class Shelf:
    """The plans of one robot and one workpiece: several scenarios by several methods.

    plans: by the name of a method, rows in the order of the scenarios' numbers from 0; -1 in its status where there
    is nothing. labels: what sets scenarios apart, by number, see `scenario_label`.
    """

    def __init__(
        self,
        name: str,
        config: PlanConfig,
        robot: Robot,
        workpiece: Workpiece,
        methods: tuple[str, ...],
        plans: Callable[[str], Plans],
        placements: dict[int, Placement],
        labels: dict[int, str] | None = None,
    ):
        self.labels = labels or {}
        self.name, self.robot, self.workpiece, self.methods = name, robot, workpiece, methods
        self._config, self._placements = config, placements
        self.plans = lru_cache(maxsize=None)(plans)

    def outcomes(self, method: str) -> list[Outcome]:
        """What became of every scenario that the method has planned; the failed ones first, each kind in order.

        Raises InputError for a method without results.
        """
        if method not in self.methods:
            raise InputError(f"{self.name} has no results of {method!r}; it has {', '.join(self.methods)}")
        status = self.plans(method).status
        there = np.flatnonzero((status >= 0).any(axis=1)).tolist()
        found = [Outcome(k, int(is_tracked(status[k]).sum()), int((status[k] >= 0).sum())) for k in there]
        return sorted(found, key=lambda outcome: outcome.complete)

    def replay(self, number: int, method: str) -> Replay:
        """The plan of a scenario by a method. Raises InputError for one that is not there, naming those that are."""
        numbers = sorted(outcome.number for outcome in self.outcomes(method))
        if number not in numbers:
            raise InputError(f"{self.name} has no scenario {number} by {method}; it has {_spans(numbers)}")
        placement = self._placements[number]
        row = {name: getattr(self.plans(method), name)[number] for name in ARRAYS}
        there = row["status"] >= 0
        x = _held(row["x"][there], placement.x_start)
        blocked = self.obstructions(method, [number]).get(number)
        if blocked is not None:
            x[last_posture(self.plans(method), number, placement.x_start)[0]] = blocked.x
        robot = lengthen_tool(self.robot, placement.tool_extension_m)
        p, q, tcp, body, near, far = map(np.asarray, _looked_at(robot, self._obstacle, placement, jnp.asarray(x)))
        names = [self.robot.capsule_names[k] for k in body.tolist()]
        surface = self._surface.placed(placement.T_world_workpiece)
        path = min(1 + self._config.workpiece.approach_to_inlet + self._config.workpiece.approach_to_path, len(x))
        target, good = row["target"][there], np.flatnonzero(is_tracked(row["status"][there]))
        shown = good[good >= path] if (good >= path).any() else good if good.size else np.zeros(1, int)
        shown = shown[np.linspace(0, len(shown) - 1, LOOKED_AT).round().astype(int)]
        arm = Bodies(p[shown], q[shown], np.asarray(robot.capsule_radius), is_tool(robot))
        return Replay(
            method=method,
            number=number,
            label=self.label(number),
            robot=robot,
            surface=surface,
            path=path,
            target=target,
            status=row["status"][there],
            clearance=row["clearance"][there],
            residual=row["residual"][there],
            x=x,
            p=p,
            q=q,
            tcp=tcp,
            witness=Witness(names, near, far),
            obstruction=blocked,
            side=camera_side(surface.points, target[path:] if len(target) > path + 1 else target, arm),
        )

    def label(self, number: int) -> str:
        """A scenario's number and what sets it apart."""
        return f"{number}: {self.labels[number]}" if self.labels.get(number) else str(number)

    def obstructions(self, method: str, numbers: Sequence[int] | None = None) -> dict[int, Obstruction]:
        """What is in the way in the scenarios that failed, of those numbers or of all; one call for hundreds."""
        plans = self.plans(method)
        there = sorted(self._placements) if numbers is None else numbers
        ends = {k: last_posture(plans, k, self._placements[k].x_start) for k in there if k < len(plans.status)}
        failed = {k: end for k, end in ends.items() if end is not None}
        if not failed:
            return {}
        where = jax.tree.map(lambda *leaves: np.stack(leaves), *(self._placements[k] for k in failed))
        x = np.stack([posture for _, posture in failed.values()])
        targets = np.stack([plans.target[k, target] for k, (target, _) in failed.items()])
        found = obstructions(self.robot, self._obstacle, where, x, targets, self._config.settings)
        return dict(zip(failed, found, strict=True))

    @cached_property
    def _obstacle(self) -> Obstacles:
        return make_obstacle(self.workpiece)

    @cached_property
    def _surface(self) -> Surface:
        return surface_of(self.workpiece.cloud)


class MixedShelf(Shelf):
    """The plans of a sweep whose scenarios differ in the robot, the workpiece or the settings: a shelf for those that
    agree in them, made when one is looked at."""

    def __init__(self, run: Run, methods: tuple[str, ...], rows: dict[int, dict[str, Any]], labels: dict[int, str]):
        points = run.points()
        self._run, self._rows, self._jobs = run, rows, {number: points[number].config for number in rows}
        self._shelf = lru_cache(maxsize=MOST_SHELVES)(self._make_shelf)
        self.labels = labels
        first = self._shelf(_alike(self._jobs[min(rows)]))
        super().__init__(str(run.folder), first._config, first.robot, first.workpiece, methods, run.plans, {}, labels)

    def replay(self, number: int, method: str) -> Replay:
        """See `Shelf.replay`."""
        if number not in self._rows:
            raise InputError(f"{self.name} has no scenario {number} by {method}; it has {_spans(sorted(self._rows))}")
        return self._shelf(_alike(self._jobs[number])).replay(number, method)

    def obstructions(self, method: str, numbers: Sequence[int] | None = None) -> dict[int, Obstruction]:
        """See `Shelf.obstructions`."""
        found = {}
        together: dict[tuple, list[int]] = {}
        for number in sorted(self._rows) if numbers is None else numbers:
            together.setdefault(_alike(self._jobs[number]), []).append(number)
        for alike, own in together.items():
            found |= self._shelf(alike).obstructions(method, own)
        return {number: found[number] for number in sorted(found)}

    def _make_shelf(self, alike: tuple) -> Shelf:
        numbers = [number for number, job in self._jobs.items() if _alike(job) == alike]
        rows = [self._rows[number] for number in numbers]
        job, run = self._jobs[numbers[0]], self._run
        return _shelf(run, job, run.methods, rows, run.plans, self.labels)


def _alike(job: PlanConfig) -> tuple:
    """What scenarios on one shelf agree in."""
    part = job.workpiece
    return arm_of(job), part_of(job), part.approach_to_inlet, part.approach_to_path, job.settings


def open_shelf(folder: str | Path) -> Shelf:
    """The plans in the folder of a sweep or of one plan. Raises InputError for any other folder, for damaged files,
    and for a cloud, path or model that has changed since the run."""
    folder = Path(folder)
    if (folder / MANIFEST).exists():
        return _of_run(open_run(folder))
    if (folder / SUMMARY).exists():
        return _of_plan(folder)
    raise InputError(f"{folder} holds neither a run of htcp sweep ({MANIFEST}) nor a plan of htcp plan ({SUMMARY})")


@runtime_checkable
class Planned(Protocol):
    """A job and what became of it, as `htcp_jax.plan` returns it; the robot has its tool."""

    job: PlanConfig
    robot: Robot
    workpiece: Workpiece
    scenario: Scenario
    plans: Plans


def shelf_of(name: str, plan: Planned) -> Shelf:
    """The shelf of one plan."""
    return _single(name, plan.job, plan.robot, plan.workpiece, plan.scenario, plan.plans)


def _single(name: str, job: PlanConfig, robot: Robot, workpiece: Workpiece, scenario: Scenario, plans: Plans) -> Shelf:
    placement = Placement(
        T_world_workpiece=np.asarray(scenario.T_world_workpiece),
        gate=np.asarray(scenario.gate),
        x_start=np.asarray(scenario.x_start),
        tool_extension_m=float(scenario.tool_extension_m),
    )
    return Shelf(name, job, robot, workpiece, (job.method,), lambda _: plans, {0: placement})


def _of_run(run: Run) -> Shelf:
    refuse_changed(run.manifest.files, run.folder)
    methods = tuple(dict.fromkeys(shard.method for shard in run.manifest.shards))
    config, table = run.config, run.scenarios(*methods)
    rows = table.to_pylist()
    # The targets are on record, so that the paths of the scenarios are not needed.
    if run.varied:
        return MixedShelf(run, methods, {row["scenario"]: row for row in rows}, labels_of(table))
    return _shelf(run, config, methods, rows, run.plans, labels_of(table))


def _shelf(
    run: Run,
    config: PlanConfig,
    methods: tuple[str, ...],
    rows: list[dict],
    plans: Callable[[str], Plans],
    labels: dict[int, str],
) -> Shelf:
    robot = robot_of(config.robot)
    workpiece = workpiece_of(config.workpiece, robot)
    placements = {row["scenario"]: _placement(row, robot, workpiece, run.manifest.joints) for row in rows}
    return Shelf(str(run.folder), config, robot, workpiece, methods, plans, placements, labels)


def _placement(row: dict[str, Any], robot: Robot, workpiece: Workpiece, joints: tuple[str, ...]) -> Placement:
    shift = tuple(row[f"shift_{axis}_m"] for axis in XYZ)
    T = workpiece.T_world(row["rotation_y_rad"], row["rotation_z_rad"], shift, row["rotation_x_rad"])
    start = np.array([row[f"start_{joint}"] for joint in joints])
    return Placement(T, gate_of(robot, workpiece, T), start, row["tool_extension_m"])


def _of_plan(folder: Path) -> Shelf:
    _, raw, files, arrays = read_plan(folder, ARRAYS)
    refuse_changed(files, folder)
    job: PlanConfig = validate(raw, PlanConfig, str(folder / SUMMARY))
    robot, workpiece, scenario = scene(job)
    if arrays["target"].shape != scenario.targets.shape or arrays["x"].shape[1:] != (len(robot.joint_names),):
        raise InputError(f"{folder / TRAJECTORY} is no plan of the configuration beside it; damaged")
    plans = Plans(**{name: array[None] for name, array in arrays.items()}, compile_s=0.0, run_s=0.0)
    robot, scenario = with_own_tool(robot, scenario)
    return _single(str(folder), job, robot, workpiece, scenario, plans)


def with_tip(
    p: Float[np.ndarray, "K 3"], q: Float[np.ndarray, "K 3"], tcp: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "2 K1 3"]:
    """Ends of the capsules and, last, of the tool's bare tip: from the nearest of these ends to the TCP."""
    ends = np.concatenate([p, q])
    nearest = ends[np.linalg.norm(ends - tcp, axis=1).argmin()]
    return np.stack([np.vstack([p, nearest]), np.vstack([q, tcp])])


@jax.jit
def _looked_at(robot: Robot, obstacle: Obstacles, where: Placement, x: Float[jax.Array, "T N"]):
    """Capsules' ends, TCP, and the witness of the smallest distance (body, point on it, point of the cloud), of every
    configuration."""

    def one(x):
        p, q = capsule_segments(robot, x)
        touch = contacts(robot, obstacle, where, x)
        body = jnp.argmin(touch.distance)
        point, normal, crossed = touch.point[body], touch.normal[body], touch.plane[body]
        arm = point - jnp.where(crossed, 0.0, robot.capsule_radius[body]) * normal
        return p, q, tcp_position(robot, x), body, arm, arm - touch.distance[body] * normal

    return jax.vmap(one)(x)


def _held(x: Float[np.ndarray, "T N"], start: Float[np.ndarray, "N"]) -> Float[np.ndarray, "T N"]:
    """The configurations, with the last known one in the place of those that are not known."""
    rows = np.concatenate([start[None], x])
    known = np.where(np.isnan(rows).any(axis=1), 0, np.arange(len(rows)))
    return rows[np.maximum.accumulate(known)][1:]


def _spans(numbers: list[int]) -> str:
    """Sorted numbers as a person writes them: 0 to 3, 7."""
    parts, first = [], 0
    for k, number in enumerate(numbers):
        if k + 1 == len(numbers) or numbers[k + 1] != number + 1:
            parts.append(f"{numbers[first]}" if first == k else f"{numbers[first]} to {number}")
            first = k + 1
    return ", ".join(parts)
