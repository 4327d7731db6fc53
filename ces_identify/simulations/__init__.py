"""Simulations of the damper, all through `Simulation`: a recording in, a force at each position sample out."""
