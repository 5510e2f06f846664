"""What there is: the robot and its kinematics, the workpiece, the task, and a scenario that places them."""
