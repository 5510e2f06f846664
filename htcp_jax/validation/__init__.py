"""Independent validation: results measured again by MuJoCo, and comparison with baselines.

`validate` measures tracked targets and segments by MuJoCo's own distances and kinematics and uses none of the planner's
mathematics. `gate` compares counts of a run with a baseline file.
"""
