"""Jobs: the configuration of a plan or a sweep, and the robot, workpiece and scenarios that it describes.

`PlanConfig` is a job, checked, and `load_config` reads it from files and overrides. Module `config` defines its
sections and keys, `config_file` merges files and finds those that a job names. `build` reads these files and makes
robot, workpiece, scenario and scene of a job; `cell_shapes` loads the shapes of its cell. `given_kinds` makes
the obstacles that a job gives by kind; `with_kinds` adds obstacles or task rows of a notebook to a job, `seeded` a seed
to overrides.

`grid` reads a sweep: a grid of jobs, whose scenarios are stacked into batches. `grid_axes` are the keys that may vary
and their values, `grid_points` the values of each scenario. `examples` lists the jobs that ship with the package, and
`feed` reads a feed rate with its unit.

Importing the configuration imports no planner and no JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
