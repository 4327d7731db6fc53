"""The tick: all arithmetic between a stamped sample and a force, in a subset of Python that is printed to C.

docs/tick.md says what the subset is. CPython runs these files, Numba compiles them, `ces_identify.export.c_printer`
prints them to C99, and all give the same numbers, bit for bit. A model is arrays of numbers; `ces_observer.flat` lays
them out. MODULES stand from the bottom up: each calls only what stands before it.
"""

MODULES = (
    "model", "bank", "tracker", "curves", "valve", "mount", "edges", "pressures", "hydraulic",
    "constructed", "polynomial", "lagged", "sigmoid", "fuzzy", "experts", "recurrent", "structure",
    "mixture", "band", "run", "estimator",
)  # fmt: skip

# what is called from outside, by name: `ces_observer.core.bind`
ENTRY_POINTS = (
    "polynomial_reset", "polynomial_tick", "lagged_reset", "sigmoid_tick", "fuzzy_tick", "experts_tick",
    "recurrent_reset", "recurrent_tick", "hydraulic_reset", "hydraulic_tick", "mixture_reset", "mixture_tick",
    "structure_reset", "structure_tick", "estimator_reset", "estimator_step", "estimator_skip_late", "run_half_width",
    "check_model", "rounding_sample",
)  # fmt: skip
