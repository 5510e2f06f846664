"""Jobs: the configuration of a plan or a sweep, and the robot, workpiece and scenarios that it describes.

`config` has the keys that people write, `load_config` reads them, `grid` and `grid_axes` vary them, `build` makes the
scene of a job. `examples` are the jobs that ship with the package.
"""
