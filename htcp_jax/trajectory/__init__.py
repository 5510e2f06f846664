"""Time parameterisation of a motion, and robot programs.

`stretches` blends the motion's corners, `time_law` finds the fastest time scaling within the feed and the limits of the
joints, `loads` computes torques, `of_plan` makes the program of a plan, `whole_run` times a complete run. Package
`formats` writes programs for controllers.
"""
