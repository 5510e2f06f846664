"""The robot, its kinematics, the task and the workpiece: frozen arrays and pure functions of one configuration.

`Robot` is a serial arm with capsules around its links; `kinematics` computes the poses of links and TCP and their
Jacobians; `Task` states what the TCP must do at a target, as rows of position and orientation errors;
`inverse_kinematics.reanchor` moves a configuration onto a target. `Workpiece` is the part with its path, and `Scenario`
places part, start and tool for one plan. `goals` computes the goals that the task's rows have at each target.

Nothing here opens a file: package `io` reads robots, parts and paths, package `jobs` builds scenarios from a job.
"""
