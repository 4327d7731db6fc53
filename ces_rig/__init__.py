"""The virtual rig: descriptions of experiments go in, synthetic recordings come out.

The rooms in reading order: `drive` (strokes and currents), `dampers` (a folder for each kind: parameters, equations,
effects), `withheld` (plants with effects that their simulation lacks), `blind` (sealed cases for tests of the
diagnosis), `live` (the rig as a ROS 2 node). `experiment` and `sensors` make the recording, `simulation` a
SIM of the rig.
"""
