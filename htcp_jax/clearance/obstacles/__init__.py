"""Obstacles: collision objects of the arm, behind one protocol.

`obstacle.Obstacle` is the protocol of a kind; `of_workpiece` and `of_cell` make the obstacles of a part and of a work
cell; `self_collision` keeps the arm clear of itself; `scene.Scene` is a robot with its obstacles and task.
"""
