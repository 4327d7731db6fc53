"""The programs that make, prove and export models: `identify` (also as a ROS 2 node), `validate` and `export`."""
