"""The programs: `ces NAME` without ROS and `ros2 run ces_observer NAME` with it; one module each, all at the edge."""
