"""What a free run's residuals still hold: their whiteness, and their correlation with the inputs.

A free-run (output-error) model leaves the measurement's noise in the residual as it is, coloured or not, so its
residuals need not be white: whiteness tells only whether a noise model would help to predict one step ahead. What
decides is the correlation with the inputs (Ljung, System Identification, 1999, sec. 16.6; Söderström & Stoica, System
Identification, 1989, sec. 11.2): whatever of the residual goes with speed, position or current is force the model
could still explain. Speed correlates with what is linear in it only; for nonlinear models Billings & Voon (Correlation
based model validity tests for non-linear models, Int. J. Control 44, 1986) add the squares, phi_(u2'e) and
phi_(u2'e2'), the prime for "less its mean".

Bands hold for autocorrelated sequences: if input and residual are independent, sqrt(n) times their correlation at any
lag has the variance sum over lags of rho_u rho_e (Bartlett 1935; Söderström & Stoica eq. 11.22). The sum is taken up
to twice the memory of either, whichever is shorter, under a flat-top window. Lags are of the input before the residual.
Where the stroke repeats, whatever of the residual repeats with it is correlated with every input: it is force a model
could explain, but not which input explains it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from ces_identify.numerics.arrays import F, I
from ces_identify.numerics.correlation import (
    INSIGNIFICANT_IN_A_ROW,
    autocorrelation,
    covariance,
    find_runs,
    flat_top,
    longest_memory,
    memory,
)
from ces_identify.validation.evaluate import Evaluation

LEVEL = 0.99
Z = float(norm.ppf(0.5 + LEVEL / 2))
LAG_S = 0.1  # [s] of the longest lag: dampers and valves forget within it
MIN_TICKS = 200
INPUTS = ("speed", "position", "current")
CONSTANT_SPREAD = 1e-2  # spread over level of an input that counts as constant


@dataclass(frozen=True)
class Correlation:
    """Correlation of `first` now with `second` after each of `lags_s` (n,) [s].

    `values` (n,) are from -1 to 1; each stays inside +-`band` with a probability of LEVEL if there is none.
    `p_value` is that of all lags together.
    """

    first: str
    second: str
    lags_s: F
    values: F
    band: float
    p_value: float

    @property
    def passed(self) -> bool:
        """True if what there is may be chance, at LEVEL."""
        return self.p_value >= 1.0 - LEVEL

    @property
    def worst(self) -> int:
        """Index of the largest correlation, of lags after 0 if the sequence is correlated with itself."""
        first = int(self.first == self.second)
        return first + int(np.argmax(np.abs(self.values[first:])))

    @property
    def share(self) -> float:
        """Share of the variance of `second` that goes with `first` at the worst lag."""
        return float(self.values[self.worst] ** 2)


@dataclass(frozen=True)
class ResidualTests:
    """`whiteness` of a residual, with the Ljung-Box statistic over its lags, and its correlations with the inputs.

    `still` names the inputs left out because they do not change.
    """

    whiteness: Correlation
    ljung_box: float
    inputs: tuple[Correlation, ...]
    still: tuple[str, ...]


@dataclass(frozen=True)
class Sequence:
    """A sequence of mean 0 and norm 1, `unit` (n,), its autocorrelation `rho`, and the lag its `memory` lasts."""

    name: str
    unit: F
    rho: F
    memory: int


def residual_tests(evaluation: Evaluation) -> ResidualTests | None:
    """Return the tests on the scored ticks of `evaluation`; None if it diverged or has too few of them."""
    series, error = evaluation.series, evaluation.error
    if len(error) < MIN_TICKS or not np.isfinite(error).all() or error.std() == 0.0:
        return None
    runs, most = find_runs(series.scored, series.segments), max(1, round(LAG_S * series.rate_Hz))
    inputs = {name: getattr(series, name)[series.scored] for name in INPUTS}
    still = tuple(name for name, u in inputs.items() if _is_still(u))
    moving = {name: u for name, u in inputs.items() if name not in still}
    linear = [sequence(name, u, runs) for name, u in moving.items()]
    squares = [sequence(f"{name}²", u**2, runs) for name, u in moving.items() if not _is_still(u**2)]
    residual = sequence("residual", error, runs)
    squared = [sequence("residual²", error**2, runs)] if not _is_still(error**2) else []
    pairs = [*((u, residual) for u in (*linear, *squares)), *((u, e) for e in squared for u in squares)]
    white, statistic = whiteness(error, runs, most, series.rate_Hz)
    crosses = tuple(cross_correlation(u, e, runs, most, series.rate_Hz) for u, e in pairs)
    return ResidualTests(white, statistic, crosses, still)


def _is_still(x: F) -> bool:
    return float(x.std()) <= CONSTANT_SPREAD * max(1e-12, float(np.abs(x).max()))


def sequence(name: str, x: F, runs: I) -> Sequence:
    """Return x (n,), which must not be constant, as `cross_correlation` takes it."""
    centred, longest = x - x.mean(), longest_memory(len(x), runs)
    unit = centred / math.sqrt(float((centred**2).sum()))
    rho = autocorrelation(x, runs, 2 * longest + INSIGNIFICANT_IN_A_ROW)
    return Sequence(name, unit, rho, memory(rho, len(x), longest))


def whiteness(error: F, runs: I, max_lag: int, rate_Hz: float) -> tuple[Correlation, float]:
    """Return the autocorrelation of `error` and the Ljung-Box statistic over lags 1 to `max_lag`.

    Q = n (n + 2) sum of r^2 / pairs (Ljung & Box, Biometrika 65, 1978), pairs counted inside runs, against
    chi-square with `max_lag` degrees of freedom: a free run fits no model of the noise that would take any away.
    """
    n, centred = len(error), error - error.mean()
    sums, pairs = covariance(centred, centred, runs, max_lag)
    values = sums / sums[0]
    statistic = float(n * (n + 2.0) * (values[1:] ** 2 / np.maximum(pairs[1:], 1.0)).sum())
    p_value = float(chi2.sf(statistic, max_lag))
    lags = np.arange(max_lag + 1) / rate_Hz
    return Correlation("residual", "residual", lags, np.asarray(values), Z / math.sqrt(n), p_value), statistic


def cross_correlation(first: Sequence, second: Sequence, runs: I, max_lag: int, rate_Hz: float) -> Correlation:
    """Return the correlation of two sequences, with `second` 0 to `max_lag` ticks after `first`.

    The p-value is Bonferroni's over the lags, which holds however they depend on each other.
    """
    values, _ = covariance(first.unit, second.unit, runs, max_lag)
    deviation = math.sqrt(bartlett(first, second) / len(first.unit))
    p_value = min(1.0, 2.0 * (max_lag + 1) * float(norm.sf(np.abs(values).max() / deviation)))
    return Correlation(first.name, second.name, np.arange(max_lag + 1) / rate_Hz, values, Z * deviation, p_value)


def bartlett(first: Sequence, second: Sequence) -> float:
    """Return n times the variance of the correlation of two independent sequences; 1 if either is white."""
    most = 2 * min(first.memory, second.memory)
    products = flat_top(most) * first.rho[: most + 1] * second.rho[: most + 1]
    return max(1.0, float(1.0 + 2.0 * products[1:].sum()))


def verdicts(tests: ResidualTests) -> tuple[str, ...]:
    """Return a line on whiteness and one on the inputs, for people."""
    return _describe_whiteness(tests), _describe_inputs(tests)


def _describe_whiteness(tests: ResidualTests) -> str:
    white = tests.whiteness
    if white.passed:
        return f"white (Ljung-Box p = {white.p_value:.2g})"
    return f"not white: {white.values[1]:.2f} at lag 1, Ljung-Box p {_p(white.p_value)} (a free run's need not be)"


def _describe_inputs(tests: ResidualTests) -> str:
    found = sorted((c for c in tests.inputs if not c.passed), key=lambda c: -c.share)
    if not tests.inputs:
        return "not tested against the inputs: none changes"
    if not found:
        return f"nothing left that goes with {', '.join(n for n in INPUTS if n not in tests.still)} or their squares"
    most = found[0]
    return (
        f"{len(found)} of {len(tests.inputs)} correlations with inputs beyond chance, at most "
        f"{100.0 * most.share:.2g} % of {most.second}, with {most.first} {1e3 * most.lags_s[most.worst]:.0f} ms before"
    )


def _p(value: float) -> str:
    return "< 1e-6" if value < 1e-6 else f"= {value:.2g}"
