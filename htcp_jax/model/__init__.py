"""The robot, its kinematics, the task and the workpiece: frozen arrays and pure functions of one configuration.

`Robot` is a serial arm with capsules around its links. `Workpiece` is the part with its path; `PathFrames` has the
normals, tangents and orientations along the path. `Scenario` is the part's pose, the start and the tool of one plan,
and `Fixture` is a body of the work cell. `Task` is the constraint on the arm at a target.

`kinematics` computes the poses of links and TCP and their Jacobians. `inverse_kinematics` moves a configuration onto a
target. `task_rows` has the base class of a task's rows, `built_in_rows` their kinds, and `rows_of_spec` makes them from
the rows of a job, which are data in package `spec`. `goals` makes the task and its goals at each target. `row_bounds`
has the allowed regions of a row between two targets.

`rotations`, `surface`, `mesh_points` and `duct` are geometry: rotations, the surface of a cloud or a mesh, points on a
mesh, the generated duct. `arrays` checks points that a caller passes in. `robot`,
`scenario`, `task`, `fixture` and `workpiece` have the types above and the functions that change them;
`scenario_setup.make_scenario` builds a scenario.

Nothing here opens a file: package `io` reads robots, parts and paths, package `jobs` builds scenarios from a job.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
