"""Jobs: reading of a plan's or a sweep's configuration, and the robot, workpiece and scenarios that it describes.

`load_config` loads a `PlanConfig` from files and overrides; the files that the job names are not read. `resolve` adds
the values that depend on the robot. `build` makes a job's robot, workpiece, task and scenario; `cell_shapes` loads the
shapes of its work cell. `with_kinds` adds obstacles and task rows from Python to a job, and `seeded` adds a seed to
overrides.

`grid` reads a sweep: a grid of jobs. `grid_axes` defines the keys that may vary and reads their values. `grid_points`
yields the configuration of each scenario, and `batch` builds the arrays of all scenarios.

The import of `load_config` does not import the planner or JAX.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
