"""The ROS 2 nodes and what only they need; the one room that imports rclpy."""
