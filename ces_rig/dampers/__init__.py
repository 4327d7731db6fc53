"""Dampers as physics, a folder for each kind: stroke and current go in, force, coil current and temperature come out.

`effects` is what withheld effects of all kinds have in common.
"""
