"""Time parameterisation of a motion, and robot programs.

`path` blends the motion, `time_law` finds the fastest course within the limits of joints, tool and torques, `of_plan`
makes the program of a plan, `whole_run` those of a complete run. Package `formats` writes them for controllers.
"""
