"""Simulations of the damper: a recording goes in, a force at each of its position samples comes out.

Models, Python functions, FMUs and recorded predictions are all used through `Simulation`.
"""
