"""Reachable targets, and proofs that others are not: lower and upper bounds on what any planner can do.

`reachability` searches configurations at each target and proves cells of tool orientations unreachable;
`obstruction` finds the colliding body at the target where a plan ended.
"""
