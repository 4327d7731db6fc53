"""A reference controller of damper force: curve, inverse map, feedback; no ROS."""
