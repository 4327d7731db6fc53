"""The free run of a polynomial over whole arrays: a model and uniform inputs in, force out."""

from __future__ import annotations

import numpy as np

from ces_identify.numerics import kernels
from ces_identify.numerics.arrays import F, I
from ces_identify.polynomial.compiled_terms import CompiledTerms, compile_terms, power_table
from ces_identify.polynomial.constructed_series import constructed_values
from ces_observer.model import Model
from ces_observer.structures.polynomial import Polynomial


def run_polynomial(polynomial: Polynomial, model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return the force (ticks,) [N] and the first tick outside the force envelope, -1 if there is none.

    `inputs` (3, ticks) are position [m], speed [m/s] and current [A].
    """
    terms, powers = powers_of_inputs(polynomial, model, inputs, segments)
    coefficients = np.array([term.coefficient for term in polynomial.terms])
    force, diverged = kernels.free_run(powers, segments, terms.arrays, coefficients, model.force_envelope_N)
    return force, int(diverged)


def powers_of_inputs(polynomial: Polynomial, model: Model, inputs: F, segments: I) -> tuple[CompiledTerms, F]:
    """Return the terms as arrays and their power table (rows, ticks) for these inputs."""
    terms, (position, speed, current) = compile_terms(polynomial.terms), inputs
    rate_Hz = model.sampling.rate_Hz
    values = constructed_values(terms.constructed, model.envelope, (position, speed, current), segments, rate_Hz)
    return terms, power_table(terms.powers, model.envelope, position, speed, current, values)
