"""Sampled collision checks of Drake, in a process and an environment of its own (pip install drake).

    PYTHON benchmarks/prove_drake.py REQUEST.json

The request has the arm's file without meshes; `paths`: configurations, and boxes that are checked next to the arm
itself; `edges`: straight motions between boxes. Results are printed as JSON. `SceneGraphCollisionChecker` excludes
pairs of adjacent links. It has no default step of edges: every step in `steps_rad` is measured.
"""

import json
import sys
import time
from importlib.metadata import version

import numpy as np
from pydrake.geometry import Box
from pydrake.math import RigidTransform
from pydrake.multibody.plant import CoulombFriction
from pydrake.planning import RobotDiagramBuilder, SceneGraphCollisionChecker


def checker_of(arm: str, boxes: list[list], step: float) -> SceneGraphCollisionChecker:
    """Return a checker of the arm and of boxes that are fixed in the world."""
    builder = RobotDiagramBuilder()
    plant = builder.plant()
    (model,) = builder.parser().AddModels(arm)
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("iiwa_link_0", model))
    for k, (centre, half) in enumerate(zip(*boxes, strict=True)):
        shape, friction = Box(*(2 * np.array(half))), CoulombFriction(0.9, 0.9)
        plant.RegisterCollisionGeometry(plant.world_body(), RigidTransform(centre), shape, f"box {k}", friction)
    plant.Finalize()
    return SceneGraphCollisionChecker(model=builder.Build(), robot_model_instances=[model], edge_step_size=step)


def main() -> None:
    """Check all motions of the request."""
    with open(sys.argv[1], encoding="utf-8") as file:
        asked = json.load(file)
    found = {"version": version("drake"), "paths": {}, "edges": {}}
    for name, path in asked["paths"].items():
        checker, x = checker_of(asked["arm"], path["boxes"], 0.05), np.array(path["x"])
        began = time.perf_counter()
        free = checker.CheckConfigsCollisionFree(list(x), parallelize=False)
        spent = time.perf_counter() - began
        found["paths"][name] = {"collide": int(len(x) - sum(free)), "samples": len(x), "ms": 1e3 * spent}
    edges = list(zip(np.array(asked["edges"]["a"]), np.array(asked["edges"]["b"]), strict=True))
    for step in asked["steps_rad"]:
        checker = checker_of(asked["arm"], asked["edges"]["boxes"], step)
        began = time.perf_counter()
        free = sum(bool(checker.CheckEdgeCollisionFree(a, b)) for a, b in edges)
        found["edges"][str(step)] = {"free": free, "ms": 1e3 * (time.perf_counter() - began) / len(edges)}
    print(json.dumps(found))


if __name__ == "__main__":
    main()
