"""The rig behind ROS 2 topics: set points go out, measured position, current and force come in."""
