"""Jobs: the configuration of a plan or a sweep, and the robot, workpiece and scenarios that it describes.

`PlanConfig` is a validated job, and `load_config` loads it from files and overrides. The module `config` defines its
sections and keys; `config_file` merges configuration files and finds the files that a job names. `build` makes a job's
robot, workpiece, task and scenario; `cell_shapes` loads the shapes of its work cell. `given_kinds` reads obstacles and
task rows of kinds from other packages. `with_kinds` adds obstacles and task rows from Python to a job, and `seeded`
adds a seed to overrides.

`grid` reads a sweep: a grid of jobs, whose scenarios are stacked into batches. `grid_axes` defines the keys that may
vary and reads their values. `grid_points` yields the configuration of each scenario. `examples` lists the jobs that
ship with the package, and `feed` reads a feed rate with its unit.

The import of `config` and `load_config` does not import the planner or JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
