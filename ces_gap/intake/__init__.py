"""Checks before a diagnosis: recordings and a simulation go in, traces that can be trusted come out.

Mistakes (units, signs, duplicates, saturated sensors) are errors of one line; doubts become notes of the diagnosis.
"""
