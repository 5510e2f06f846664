"""Sampled collision checks of Drake, in a process and an environment of its own (pip install drake).

    PYTHON benchmarks/prove_drake.py REQUEST.json

The request has the arm's file without meshes; `paths`: configurations, and boxes that are checked next to the arm
itself; `edges`: straight motions, each past a ball. Results are printed as JSON. `SceneGraphCollisionChecker` excludes
pairs of adjacent links. It has no default step of edges: every step in `steps_rad` is measured.
"""

import json
import sys
import time
from importlib.metadata import version

import numpy as np
from pydrake.geometry import Box, Sphere
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker


def checker_of(arm: str, shapes: list[tuple[object, list[float]]], step: float) -> SceneGraphCollisionChecker:
    """Return a checker of the arm and of shapes that are fixed in the world."""
    builder = RobotDiagramBuilder()
    plant = builder.plant()
    (model,) = builder.parser().AddModels(arm)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("iiwa_link_0", model))
    for k, (shape, place) in enumerate(shapes):
        plant.RegisterCollisionGeometry(
            plant.world_body(), RigidTransform(place), shape, f"shape {k}", CoulombFriction(0.9, 0.9)
        )
    plant.Finalize()
    return SceneGraphCollisionChecker(model=builder.Build(), robot_model_instances=[model], edge_step_size=step)


def main() -> None:
    """Check all motions of the request."""
    with open(sys.argv[1], encoding="utf-8") as file:
        asked = json.load(file)
    found = {"version": version("drake"), "paths": {}, "edges": {}}
    for name, path in asked["paths"].items():
        shapes = [(Box(*(2 * np.array(half))), centre) for centre, half in zip(*path["boxes"], strict=True)]
        checker, x = checker_of(asked["arm"], shapes, 0.05), np.array(path["x"])
        began = time.perf_counter()
        free = checker.CheckConfigsCollisionFree(list(x), parallelize=False)
        spent = time.perf_counter() - began
        found["paths"][name] = {"collide": int(len(x) - sum(free)), "samples": len(x), "ms": 1e3 * spent}
    for step in asked["steps_rad"]:
        verdicts, spent = [], 0.0
        for edge in asked["edges"]:
            checker = checker_of(asked["arm"], [(Sphere(edge["radius"]), edge["centre"])], step)
            for pair in asked["ignored"]:  # the planted motions are tested for the ball alone
                checker.SetCollisionFilteredBetween(*(checker.plant().GetBodyByName(name) for name in pair), True)
            a, b = np.array(edge["a"]), np.array(edge["b"])
            began = time.perf_counter()
            verdicts.append(bool(checker.CheckEdgeCollisionFree(a, b)))
            spent += time.perf_counter() - began
        found["edges"][str(step)] = {"free": verdicts, "ms": 1e3 * spent / max(len(verdicts), 1)}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
