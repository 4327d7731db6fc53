"""Offline identification: recordings in, selected and validated model files out. Needs no ROS."""
