"""The rig as a ROS 2 node: valve current goes in, sensor samples come out, tick by tick."""
