"""The ROS 2 nodes observer and controller: the only part of this package that imports rclpy."""
