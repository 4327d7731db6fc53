"""The virtual rig: descriptions of experiments go in, synthetic recordings come out.

The rooms in reading order: `drive` (what moves a damper), `dampers` (one package per kind of controlled damper:
parameters, equations, effects), `experiments` (described in YAML or designed; each produces a recording, and its damper
is a simulation of recordings), `withheld` (plants with effects that their simulation lacks), `blind` (sealed cases that
test the diagnosis), `live` (the rig as a ROS 2 node), `loop` (experiments designed, run and identified in turn).
"""
