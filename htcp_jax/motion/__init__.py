"""Motions between configurations: plans, their segments, and the checks, joins and smoothing of them.

`Problem` is what a method plans, `Plans` are the results, `Motion` is what an arm may follow. `CollisionChecker` checks
configurations and the joint paths between them. `motion_check` verifies each segment, `joint_search` joins two
configurations in joint space, `home` leads from and to the home configuration, `smoothing` shortens a motion within its
margin.
"""
