"""Serialised ROS 2 messages: bytes go in, one number and the stamp come out, and estimates the other way."""
