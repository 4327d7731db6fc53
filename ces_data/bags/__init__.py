"""Bags (rosbag2, also of a recorder that was killed; ROS 1): files go in and out, channels as logged come out."""
