"""The robot, its kinematics, the task and the workpiece: frozen arrays and pure functions of one configuration.

`Robot` is a serial arm with capsules around its links, and `Tool` what a job mounts on it. `Workpiece` is the part with
its path; `PathFrames` has the normals, tangents and orientations along it. `Scenario` places part, start and tool for
one plan, and `Fixture` is a body of the work cell. `TaskRow` is a row of the task as a person writes it; `Task` states
by such rows what the TCP must do at a target, as errors of position and orientation.

`kinematics` computes the poses of links and TCP and their Jacobians; `inverse_kinematics` moves a configuration onto a
target; `goals` computes the goals that the task's rows have at each target, and `task_rows` has the built-in kinds of
rows. `task_row_kind` has the base class of kinds that other packages add, and `row_bounds` what a kind states about
its error between two configurations. Modules of what a job states import no JAX; `listed_rows` and `given_row` compute
with them.
`rotations`, `surface`, `mesh_points` and `duct` are geometry: rotations, the triangles that are drawn, points on a
mesh, the generated duct. `arrays` checks points that a caller passes in. `robot`, `scenario`, `task`, `tool`, `fixture`
and `workpiece` have the types above and the functions that make and change them, such as `scenario.make_scenario`.

Nothing here opens a file: package `io` reads robots, parts and paths, package `jobs` builds scenarios from a job.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
