"""Formats of robot programs: CSV, JBI, ROS, URScript, MuJoCo keyframes. `writers` lists them."""
