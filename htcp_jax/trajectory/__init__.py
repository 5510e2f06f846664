"""Time parameterisation of a motion, and robot programs.

`time_run` times all motions of a run. The module `plan_program` makes the robot program of one plan, a `PlanProgram`: a
`Program` with its job, arm and limits. A program blends the motion's corners, and has the fastest time scaling within
the feed rate and the joint limits. `check_limits` raises InputError for a job whose arm has no velocity limits.
`TimedMotion` is a motion sampled in time, and `tcp_at` computes the TCP along it. `PeakTorque` is the largest joint
torque.

A file contains the configurations of a `FileMotion`. `deviations` compares it, as a player joins its configurations,
with the program's motion. `exceeded_limits` lists known limits of controllers that a file exceeds.

`figures` computes a program's times, speeds, and used shares of the limits. `FORMATS` lists the file formats for
controllers, and `format_of` returns a format by its name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
