"""Jobs: the configuration of a plan or a sweep, and the robot, workpiece and scenarios that it describes.

`config` defines the keys of a job file, `load_config` reads them, `grid` and `grid_axes` vary them, `build` makes the
scene of a job. `examples` lists the jobs that ship with the package.
"""
