"""The inputs of a diagnosis: recordings and a simulation in; checked, prepared and split traces out.

Mistakes (units, signs, duplicates, saturated sensors) are errors of one line; doubts become notes of the diagnosis.
"""
