"""The ROS 2 nodes observer and controller: the one room of this package that imports rclpy."""
