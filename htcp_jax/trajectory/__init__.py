"""Time parameterisation of a motion, and robot programs.

`time_run` times a complete run; `plan_program` makes the program of one plan, a `PlanProgram`: a `Program` with the
job, the arm and the limits that it was made with. A program blends the motion's corners and has the fastest time
scaling within the feed rate and the limits of the joints; `check_limits` refuses a job whose arm states none.
`TimedMotion` is the same motion sampled in time, as rows, and `tcp_at` the TCP along it. `PeakTorque` is the largest
joint torque.

`figures` measures a program: times, shares at the feed rate, speeds. `FORMATS` are the files in which a program can be
written for controllers, and `format_of` finds the one of a file's name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
