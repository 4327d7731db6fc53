"""Where the gap lies: gaps go in; regions of stroke, speed, current, frequency and so on come out, with their energy.

Energies are corrected for noise, and false discoveries among regions are controlled.
"""
