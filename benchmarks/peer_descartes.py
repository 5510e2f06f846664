"""Descartes' ladder graph as one of the `peers`, by tesseract-robotics-nanobind.

A rung is a target; its vertices are collision-free configurations there. As with a grid of tool orientations, all rungs
have the same samples. They are drawn at every `KEY`-th target, by inverse kinematics from uniform draws and from draws
about the start's continuation there, and are transferred to all other targets by inverse kinematics; the collision-free
ones are vertices. An edge is a straight joint path that is proven as the segment from one target to the next; its cost
is its length. There are no edges within a rung. Descartes builds the graph and finds the shortest path through it. As
it finds a complete path or none, its graph ends at the last rung that a chain of edges leads to.

The package, whose samplers and evaluators can be written in Python, requires the libstdc++ of GCC 13 or newer. It
cannot be installed next to tesseract-robotics, whose module has the same name.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree
from tesseract_robotics import tesseract_command_language as language
from tesseract_robotics import tesseract_common as common
from tesseract_robotics import tesseract_environment as environment
from tesseract_robotics import tesseract_motion_planners as planners
from tesseract_robotics import tesseract_motion_planners_descartes as descartes

from benchmarks.peer_cell import Brought, Cell
from htcp_jax.motion import Plans, Problem
from htcp_jax.planning import Method
from htcp_jax.status import Status

KEY, DRAWN, TRIED = 6, 100, 1024  # interval of key targets; number of clear configurations there, and of draws for them
SPREAD_RAD = 0.3  # of the draws about the start's continuation
VERTICES = 200  # largest number on one rung
EDGE_RAD, APPROACH_RAD = 0.25, 0.4  # largest length of an edge, along the path and before it


@dataclass(frozen=True)
class LadderGraph(Method):
    """The planner."""

    name: str = "descartes-ladder"
    title: str = "Descartes' ladder graph"
    description: str = "the shortest path through clear configurations at every target"

    def plan(self, problem: Problem) -> Plans:
        """Plan all scenarios, one after the other."""
        plans = problem.empty_plans()
        for scenario in problem.to_plan.tolist():
            cell = Cell(problem, scenario)
            rungs, edges = _ladder(cell)
            x = cell.start
            for target, vertex in enumerate(shortest_path(rungs, edges)):
                here = rungs[target].of(vertex)
                cell.record(plans, target, x, here)
                x = here.x
            if len(rungs) < cell.count:
                plans.status[scenario, len(rungs)] = Status.RECOVERY_EXHAUSTED
        return plans


Edges = dict[tuple[int, int], float]  # from a vertex of one rung to one of the next: length [rad]


def _ladder(cell: Cell) -> tuple[list[Brought], list[Edges]]:
    """Build the rungs up to the last that can be reached, and the edges between one and the next."""
    rungs, edges, reached = [], [], np.zeros(0, bool)
    for target, rung in enumerate(_rungs(cell)):
        if target:
            found = _edges(cell, rungs[-1], rung, target)
            reached = np.isin(np.arange(len(rung.x)), [b for a, b in found if reached[a]])
            if not reached.any():
                break
            edges.append(found)
        else:
            reached = np.ones(len(rung.x), bool)
        rungs.append(rung)
    return rungs, edges


def _rungs(cell: Cell) -> list[Brought]:
    """Vertices of every target; for the first target only the start."""
    draw = np.random.default_rng(cell.problem.settings.seed)
    own = _carried(cell, cell.start[None], 0)
    lines = [own]
    for key in range(KEY, cell.count, KEY):
        about = own[key].x + SPREAD_RAD * draw.normal(size=(TRIED, len(cell.start)))
        for draws in (cell.uniform(draw, TRIED), np.clip(about, cell.lower, cell.upper)):
            clear = cell.brought_clear(draws, key)
            if len(clear.x):
                lines.append(_carried(cell, clear.x[: DRAWN // 2], key))
    rungs = [own[0]]
    for target in range(1, cell.count):
        here = Brought(*(np.concatenate(column) for column in zip(*(line[target] for line in lines), strict=True)))
        clear = np.flatnonzero(cell.is_satisfied(here))
        rungs.append(here.of(draw.permutation(clear)[:VERTICES]))
    return rungs


def _carried(cell: Cell, x: np.ndarray, target: int) -> list[Brought]:
    """Transfer configurations from one target to all others by inverse kinematics; some may collide."""
    here = cell.bring(x, target)
    before, after = [here], [here]
    for there in range(target - 1, -1, -1):
        before.append(cell.bring(before[-1].x, there))
    for there in range(target + 1, cell.count):
        after.append(cell.bring(after[-1].x, there))
    return before[:0:-1] + after


def _edges(cell: Cell, before: Brought, after: Brought, target: int) -> Edges:
    if not len(before.x) or not len(after.x):
        return {}
    longest = EDGE_RAD if target > cell.on_path else APPROACH_RAD
    near = cKDTree(before.x).sparse_distance_matrix(cKDTree(after.x), longest, output_type="coo_matrix")
    a, b = near.row, near.col
    if not len(a):
        return {}
    good = cell.proven(before.x[a], after.x[b], target)
    return dict(zip(zip(a[good].tolist(), b[good].tolist(), strict=True), near.data[good].tolist(), strict=True))


class _Sampler(descartes.DescartesWaypointSamplerD):
    """Sampler of the vertices on one rung."""

    def __init__(self, x: np.ndarray):
        super().__init__()
        self._x = x

    def sample(self) -> list:
        """Return all of them, at no cost."""
        return [descartes.DescartesStateSampleD(descartes.DescartesStateD(x), 0.0) for x in self._x]


class _Evaluator(descartes.DescartesEdgeEvaluatorD):
    """Evaluator of the edges that lead to one rung."""

    def __init__(self, before: np.ndarray, after: np.ndarray, edges: Edges):
        super().__init__()
        self._before, self._after = ({x.tobytes(): k for k, x in enumerate(rung)} for rung in (before, after))
        self._edges = edges

    def evaluate(self, start, end) -> tuple[bool, float]:
        """Return True if there is an edge, and its cost."""
        length = self._edges.get((self._before[start.values.tobytes()], self._after[end.values.tobytes()]))
        return length is not None, length or 0.0


class _Anything(descartes.DescartesStateEvaluatorD):
    """Evaluator of states, which adds nothing to the cost of the edges."""

    def evaluate(self, solution) -> tuple[bool, float]:
        """Return True, and a cost of 0."""
        return True, 0.0


class _Profile(descartes.DescartesMoveProfileD):
    """Profile that returns the rungs in the order of Descartes' calls."""

    def __init__(self, rungs: list[Brought], edges: list[Edges]):
        super().__init__()
        x = [rung.x for rung in rungs]
        self._samplers = [_Sampler(rung) for rung in x]
        self._evaluators = [_Evaluator(*pair) for pair in zip(x[:-1], x[1:], edges, strict=True)]
        self._requested = {"sampler": 0, "evaluator": 0}
        self._anything = _Anything()

    def createWaypointSampler(self, move, manipulator, scene):
        """Return the sampler of the next rung."""
        self._requested["sampler"] += 1
        return self._samplers[self._requested["sampler"] - 1]

    def createEdgeEvaluator(self, move, manipulator, scene):
        """Return the evaluator of the next pair of rungs."""
        self._requested["evaluator"] += 1
        return self._evaluators[self._requested["evaluator"] - 1]

    def createStateEvaluator(self, move, manipulator, scene):
        """Return the evaluator of states."""
        return self._anything


def shortest_path(rungs: list[Brought], edges: list[Edges]) -> list[int]:
    """Find the vertices of the shortest path, one per rung, by Descartes."""
    if len(rungs) < 2:
        return [0] * len(rungs)
    manipulator, name = common.ManipulatorInfo(), "ladder"
    manipulator.manipulator, manipulator.tcp_frame, manipulator.working_frame = "arm", "tool", "base"
    moves = language.CompositeInstruction(name, manipulator)
    anywhere = language.CartesianWaypointPoly_wrap_CartesianWaypoint(
        language.CartesianWaypoint(common.Isometry3d.Identity())
    )
    for _ in rungs:
        move = language.MoveInstruction(anywhere, language.MoveInstructionType_LINEAR, name)
        moves.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
    profiles, profile = language.ProfileDictionary(), _Profile(rungs, edges)
    profiles.addProfile(name, name, descartes.cast_DescartesMoveProfileD(profile))
    solver = descartes.DescartesLadderGraphSolverProfileD()
    solver.num_threads = 1
    profiles.addProfile(name, name, descartes.cast_DescartesSolverProfileD(solver))
    request = planners.PlannerRequest()
    request.instructions, request.env, request.profiles = moves, _arm(rungs[0].x.shape[1]), profiles
    found = descartes.DescartesMotionPlannerD(name).solve(request)
    if not found.successful:
        raise RuntimeError(f"Descartes: {found.message}")
    configurations = [
        np.ravel(
            language.WaypointPoly_as_StateWaypointPoly(
                language.InstructionPoly_as_MoveInstructionPoly(move).getWaypoint()
            ).getPosition()
        )
        for move in found.results
    ]
    return [int(np.flatnonzero((rung.x == x).all(axis=1))[0]) for rung, x in zip(rungs, configurations, strict=True)]


def _arm(joints: int):
    """Build a chain with that many joints; its geometry is not used, as vertices and edges are given."""
    names = ["base", *(f"link {k}" for k in range(1, joints)), "tool"]
    links = "".join(f'<link name="{name}"/>' for name in names)
    chain = "".join(
        f'<joint name="joint {k}" type="revolute"><parent link="{names[k]}"/><child link="{names[k + 1]}"/>'
        '<axis xyz="0 0 1"/><limit lower="-3.2" upper="3.2" velocity="1" effort="1"/></joint>'
        for k in range(joints)
    )
    text = f'<robot name="arm" xmlns:tesseract="tesseract" tesseract:make_convex="false">{links}{chain}</robot>'
    group = '<robot name="arm"><group name="arm"><chain base_link="base" tip_link="tool"/></group></robot>'
    made = environment.Environment()
    if not made.initFromUrdfSrdf(text, group, common.GeneralResourceLocator()):
        raise RuntimeError("tesseract refuses its own chain of joints")
    return made
