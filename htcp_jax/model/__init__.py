"""The robot, its kinematics, the task and the workpiece: frozen arrays and pure functions of one configuration.

`Robot` is a serial arm with capsules around its links, and `Tool` is a tool that a job mounts on it. `Workpiece` is the
part with its path; `PathFrames` has the normals, tangents and orientations along the path. `Scenario` is the part's
pose, the start and the tool of one plan, and `Fixture` is a body of the work cell. `PointRow`, `AxisRow` and
`OrientationRow` are rows of the task as written in a job file; `Task` is the resulting constraint on the arm at a
target.

`kinematics` computes the poses of links and TCP and their Jacobians. `inverse_kinematics` moves a configuration onto a
target. `task_rows` has the built-in kinds of rows, and `goals` computes the goals of rows at each target.
`row_bounds` has the allowed regions of a row between two targets. `task_list` has the rows of a job, and
`task_row_kind` their base class, which rows of other packages share; both are data without JAX. `rows_of_spec` converts
them to the planner's rows and computes their goals.

`rotations`, `surface`, `mesh_points` and `duct` are geometry: rotations, the triangles that are drawn, points on a
mesh, the generated duct. `arrays` checks points that a caller passes in. `robot`, `scenario`, `task`, `tool`, `fixture`
and `workpiece` have the types above and the functions that make and change them, such as `scenario.make_scenario`.

Nothing here opens a file: package `io` reads robots, parts and paths, package `jobs` builds scenarios from a job.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
