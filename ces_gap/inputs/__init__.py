"""Checks before a diagnosis: recordings and a simulation in, checked traces out.

Mistakes (units, signs, duplicates, saturated sensors) are errors of one line; doubts become notes of the diagnosis.
"""
