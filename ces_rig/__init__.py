"""The virtual rig: descriptions of experiments go in, synthetic recordings come out.

The rooms in reading order: `drive` (strokes and currents), `dampers` (one package per kind of controlled damper:
parameters, equations, effects), `withheld` (plants with effects that their simulation lacks), `blind` (sealed cases
that test the diagnosis), `live` (the rig as a ROS 2 node). `experiment` and `sensors` produce a recording; `experiment`
also turns the rig into a simulation of recordings.
"""
