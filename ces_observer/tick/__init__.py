"""The tick: all arithmetic between a stamped sample and a force, in a subset of Python that is printed to C.

docs/tick.md says what the subset is. CPython runs these files, Numba compiles them, `ces_identify.export.c_printer`
prints them to C99, and all give the same numbers, bit for bit. A model is arrays of numbers; `ces_observer.flat` lays
them out. MODULES stand from the bottom up: each calls only what stands before it.
"""

MODULES = (
    "model",
    "bank",
    "tracker",
    "curves",
    "valve",
    "mount",
    "edges",
    "pressures",
    "hydraulic",
    "constructed",
    "polynomial",
    "lagged",
    "sigmoid",
    "fuzzy",
    "recurrent",
    "structure",
    "band",
    "run",
    "estimator",
)
