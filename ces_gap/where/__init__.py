"""Where the gap lies: held-out gaps go in, regions of stroke, speed, current, frequency ... with their energy come out.

Energies are corrected for noise, and false discoveries among regions are controlled.
"""
