"""Readers of joint motions: trajectories and robot programs of this package and of others.

`read_motion` reads a file and returns a `MotionFile`: configurations in the order of the robot's joints, with times,
velocities, accelerations and radii of corners if the file has them, and the interpolation that the format's controller
uses. `polynomials` returns its segments. `controller_of` collects what the job says about its controller.
`MOTION_FORMATS` lists the formats.

Nothing in a file is ignored silently: it is used, named in `MotionFile.notes`, or refused with its line.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
