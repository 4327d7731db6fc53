"""Tests of a free run's residual: its whiteness, and its correlation with the inputs.

A free-run (output-error) model leaves the measurement noise in the residual, so the residual need not be white:
whiteness only says whether a noise model would improve one-step predictions. The correlation with the inputs is the
decisive test (Ljung, System Identification, 1999, sec. 16.6; Söderström & Stoica, System Identification, 1989, sec.
11.2): a residual that correlates with speed, position or current contains force that the model could explain.
`ces_identify.validation.lacks` finds what depends on them in another way.

The bands hold for autocorrelated sequences: for independent input and residual, sqrt(n) times their correlation at any
lag has the variance sum over lags of rho_u rho_e (Bartlett 1935; Söderström & Stoica eq. 11.22), here up to twice the
shorter memory, with a flat-top window. At a positive lag the input precedes the residual. With a periodic stroke, the
periodic part of the residual correlates with every input: a model could explain it, but the input remains unknown.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, norm

from ces_data.arrays import F, I
from ces_identify.limits import ResidualLimits, TickLimits
from ces_identify.numerics.correlation import (
    INSIGNIFICANT_IN_A_ROW,
    autocorrelation,
    covariance,
    find_runs,
    flat_top,
    longest_memory,
    memory,
)
from ces_identify.prepare.series import changes
from ces_identify.validation.evaluate import Evaluation

Z = float(norm.ppf(0.5 + ResidualLimits.LEVEL / 2))
INPUTS = ("speed", "position", "current")


@dataclass(frozen=True)
class Correlation:
    """Correlation of `first` with `second` after each of `lags_s` (n,) [s].

    `values` (n,) are from -1 to 1; without correlation, each is within ±`band` with probability LEVEL. `p_value` is
    that of all lags together.
    """

    first: str
    second: str
    lags_s: F
    values: F
    band: float
    p_value: float

    @property
    def passed(self) -> bool:
        """Whether the correlation may be chance, at LEVEL."""
        return self.p_value >= 1.0 - ResidualLimits.LEVEL

    @property
    def worst(self) -> int:
        """Index of the largest correlation; lag 0 is excluded for an autocorrelation."""
        first = int(self.first == self.second)
        return first + int(np.argmax(np.abs(self.values[first:])))

    @property
    def share(self) -> float:
        """Share of the variance of `second` that `first` explains at the worst lag."""
        return float(self.values[self.worst] ** 2)


@dataclass(frozen=True)
class ResidualTests:
    """`whiteness` of a residual, its Ljung-Box statistic, and the correlations with the inputs.

    `still` are the inputs that are constant and therefore not tested.
    """

    whiteness: Correlation
    ljung_box: float
    inputs: tuple[Correlation, ...]
    still: tuple[str, ...]


@dataclass(frozen=True)
class ScaledSequence:
    """A sequence with mean 0 and norm 1 (`unit`, (n,)), its autocorrelation `rho`, and its `memory` in lags."""

    name: str
    unit: F
    rho: F
    memory: int


def residual_tests(evaluation: Evaluation) -> ResidualTests | None:
    """Return the tests on the scored ticks of `evaluation`; None if it diverged or has too few."""
    series, error = evaluation.series, evaluation.error
    if len(error) < TickLimits.MIN_ERRORS or not np.isfinite(error).all() or error.std() == 0.0:
        return None
    runs, max_lag = find_runs(series.scored, series.segments), max(1, round(ResidualLimits.LAG_S * series.rate_Hz))
    inputs = {name: getattr(series, name)[series.scored] for name in INPUTS}
    still = tuple(name for name, u in inputs.items() if not changes(u))
    moving = {name: u for name, u in inputs.items() if name not in still}
    linear = [scale_sequence(name, u, runs) for name, u in moving.items()]
    residual = scale_sequence("residual", error, runs)
    white, statistic = whiteness(error, runs, max_lag, series.rate_Hz)
    crosses = tuple(cross_correlation(u, residual, runs, max_lag, series.rate_Hz) for u in linear)
    return ResidualTests(white, statistic, crosses, still)


def scale_sequence(name: str, x: F, runs: I) -> ScaledSequence:
    """Return the scaled sequence of x (n,), which must not be constant."""
    centred, longest = x - x.mean(), longest_memory(len(x), runs)
    unit = centred / math.sqrt(float((centred**2).sum()))
    rho = autocorrelation(x, runs, 2 * longest + INSIGNIFICANT_IN_A_ROW)
    return ScaledSequence(name, unit, rho, memory(rho, len(x), longest))


def whiteness(error: F, runs: I, max_lag: int, rate_Hz: float) -> tuple[Correlation, float]:
    """Return the autocorrelation of `error` and the Ljung-Box statistic over lags 1 to `max_lag`.

    Q = n (n + 2) sum of r^2 / pairs (Ljung & Box, Biometrika 65, 1978), with pairs inside runs, is compared with
    chi-square with `max_lag` degrees of freedom: a free run fits no noise model that would reduce them.
    """
    n, centred = len(error), error - error.mean()
    sums, pairs = covariance(centred, centred, runs, max_lag)
    values = sums / sums[0]
    statistic = float(n * (n + 2.0) * (values[1:] ** 2 / np.maximum(pairs[1:], 1.0)).sum())
    p_value = float(chi2.sf(statistic, max_lag))
    lags = np.arange(max_lag + 1) / rate_Hz
    return Correlation("residual", "residual", lags, np.asarray(values), Z / math.sqrt(n), p_value), statistic


def cross_correlation(
    first: ScaledSequence, second: ScaledSequence, runs: I, max_lag: int, rate_Hz: float
) -> Correlation:
    """Return the correlation of two sequences, with `second` 0 to `max_lag` ticks after `first`.

    The p-value has the Bonferroni correction over the lags, which holds for dependent lags too.
    """
    values, _ = covariance(first.unit, second.unit, runs, max_lag)
    deviation = math.sqrt(bartlett(first, second) / len(first.unit))
    p_value = min(1.0, 2.0 * (max_lag + 1) * float(norm.sf(np.abs(values).max() / deviation)))
    return Correlation(first.name, second.name, np.arange(max_lag + 1) / rate_Hz, values, Z * deviation, p_value)


def bartlett(first: ScaledSequence, second: ScaledSequence) -> float:
    """Return n times the variance of the correlation of two independent sequences; 1 if either is white."""
    max_lag = 2 * min(first.memory, second.memory)
    products = flat_top(max_lag) * first.rho[: max_lag + 1] * second.rho[: max_lag + 1]
    return max(1.0, float(1.0 + 2.0 * products[1:].sum()))


def verdicts(tests: ResidualTests) -> tuple[str, str]:
    """Return one sentence part on whiteness and one on the inputs."""
    white = tests.whiteness
    p_value = "< 1e-6" if white.p_value < 1e-6 else f"= {white.p_value:.2g}"
    about = f"white (Ljung-Box p = {white.p_value:.2g})"
    if not white.passed:
        how = f"{white.values[1]:.2f} at lag 1, Ljung-Box p {p_value}"
        about = f"not white: {how} (a free run's residual need not be white)"
    significant = [correlation for correlation in tests.inputs if not correlation.passed]
    if not tests.inputs:
        return about, "not tested against the inputs: none changes"
    if not significant:
        names = ", ".join(name for name in INPUTS if name not in tests.still)
        return about, f"no correlation left with {names}"
    top = max(significant, key=lambda correlation: correlation.share)
    return about, (
        f"{len(significant)} of {len(tests.inputs)} correlations with inputs are significant, the largest "
        f"{100.0 * top.share:.2g} % of {top.second}, with {top.first} {1e3 * top.lags_s[top.worst]:.0f} ms before"
    )
