"""The two kinds of arrays of the subset: a list, an `array.array` or a NumPy array, given by the caller.

A function of the tick takes them by the names p and n (numbers and whole numbers of the model, which it only reads), s
and k (its state).
"""

Floats = list[float]
Ints = list[int]
