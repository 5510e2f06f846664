"""Motions of OMPL, in a process and an environment of its own (pip install ompl numpy).

    PYTHON benchmarks/prove_ompl.py REQUEST.json

The request has a chain of hinges with spheres, boxes, joint ranges, and pairs of clear configurations. RRTConnect with
its default range plans from the first to the second one, and `simplifySolution` shortens the result. Motions are tested
at the ends of equal parts of at most a fraction of the space's extent, as OMPL's DiscreteMotionValidator does:

- `OMPL 1 %`: OMPL itself, whose default fraction is 0.01, with distances by the Euclidean norm.
- `MoveIt 0.5 %`: a fraction of 0.005, with distances summed over the joints, as MoveIt's joint spaces do.

Results are printed as JSON.
"""

import json
import sys
from importlib.metadata import version

import numpy as np
from ompl import base, geometric, util

MOST_STATES = 50_000  # tested for a plan, before it is given up
FRACTIONS = {"OMPL 1 %": 0.01, "MoveIt 0.5 %": 0.005}


class Arm:
    """Chain of hinges with spheres, between boxes that are parallel to the world's axes."""

    def __init__(self, asked: dict):
        """Take the arm and the boxes of a request."""
        self.links = [(link["parent"], np.array(link["T"]), link["joint"], link["axis"]) for link in asked["links"]]
        self.link, self.centre = np.array(asked["sphere_link"]), np.array(asked["sphere_centre"])
        self.radius, (self.first, self.second) = np.array(asked["sphere_radius"]), np.array(asked["pairs"])
        self.boxes = np.array(asked["box_centre"]), np.array(asked["box_half"])
        self.tested = 0

    def is_clear(self, q: np.ndarray) -> bool:
        """Return True if no moving sphere touches a box, and no pair of spheres overlaps."""
        self.tested += 1
        T = [np.eye(4)]
        for parent, at, joint, axis in self.links[1:]:
            T.append(T[parent] @ at if joint < 0 else T[parent] @ at @ turn(axis, q[joint]))
        poses = np.stack(T)[self.link]
        centre = np.einsum("kij,kj->ki", poses[:, :3, :3], self.centre) + poses[:, :3, 3]
        between = centre[self.first] - centre[self.second]
        if ((between * between).sum(axis=1) < (self.radius[self.first] + self.radius[self.second]) ** 2).any():
            return False
        moving = self.link > 0
        out = np.abs(centre[moving, None] - self.boxes[0]) - self.boxes[1]
        outside = (np.maximum(out, 0) ** 2).sum(axis=2)
        return not (outside < self.radius[moving, None] ** 2).any()


def turn(axis: list[float], angle: float) -> np.ndarray:
    """Return the rotation about a unit axis as a pose (4, 4), by Rodrigues' formula."""
    x, y, z = axis
    K, T = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.eye(4)
    T[:3, :3] += np.sin(angle) * K + (1 - np.cos(angle)) * (K @ K)
    return T


class SummedValidator(base.MotionValidator):
    """Test of motions at equal parts of at most a length, by the sum over the joints."""

    def __init__(self, information: base.SpaceInformation, longest: float, count: int):
        super().__init__(information)
        self._information, self._longest, self._count = information, longest, count

    def checkMotion(self, a, b) -> bool:
        """Return True if all tested states are valid."""
        p, q = (np.array([state[joint] for joint in range(self._count)]) for state in (a, b))
        parts = max(int(np.ceil(np.abs(q - p).sum() / self._longest)), 1)
        state = self._information.allocState()
        for part in range(parts, 0, -1):  # the end first
            for joint, value in enumerate((p + part / parts * (q - p)).tolist()):
                state[joint] = value
            if not self._information.isValid(state):
                return False
        return True


def plan(arm: Arm, ranges: np.ndarray, ends: np.ndarray, tool: str) -> list[list[float]] | None:
    """Return the configurations of a simplified motion; None if none was found."""
    count = ranges.shape[1]
    space, bounds = base.RealVectorStateSpace(count), base.RealVectorBounds(count)
    for joint, (low, high) in enumerate(ranges.T.tolist()):
        bounds.setLow(joint, low)
        bounds.setHigh(joint, high)
    space.setBounds(bounds)
    information = base.SpaceInformation(space)
    information.setStateValidityCheckingResolution(FRACTIONS[tool])
    if tool.startswith("MoveIt"):
        longest = FRACTIONS[tool] * np.diff(ranges, axis=0).sum()
        information.setMotionValidator(SummedValidator(information, longest, count))
    setup = geometric.SimpleSetup(information)
    setup.setStateValidityChecker(lambda state: arm.is_clear([state[joint] for joint in range(count)]))
    states = []
    for configuration in ends.tolist():
        state = information.allocState()
        for joint, value in enumerate(configuration):
            state[joint] = value
        states.append(state)
    setup.setStartAndGoalStates(*states)
    setup.setPlanner(geometric.RRTConnect(information))
    until = arm.tested + MOST_STATES
    setup.solve(base.PlannerTerminationCondition(lambda: arm.tested > until))
    if not setup.haveExactSolutionPath():
        return None
    setup.simplifySolution()
    path = setup.getSolutionPath()
    if not path.check():
        return None
    return [[state[joint] for joint in range(count)] for state in path.getStates()]


def main() -> None:
    """Plan all requests."""
    with open(sys.argv[1], encoding="utf-8") as file:
        asked = json.load(file)
    util.setLogLevel(util.LogLevel.LOG_NONE)
    arm, ranges = Arm(asked), np.array(asked["ranges"])
    found = {"version": version("ompl"), "motions": {}}
    for tool in FRACTIONS:
        util.RNG.setSeed(1)
        found["motions"][tool] = [plan(arm, ranges, np.array(ends), tool) for ends in asked["ends"]]
    print(json.dumps(found))


if __name__ == "__main__":
    main()
