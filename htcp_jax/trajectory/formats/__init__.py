"""Formats of robot programs: CSV, JBI, RAPID, ROS, URScript, MuJoCo keyframes. `writers` lists them."""
