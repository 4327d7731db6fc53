"""Tests of residuals at known truth, and where in the envelope the error is."""

import numpy as np
import pytest
from residual_series import coloured, evaluation, series, single_run
from scipy.stats import chi2

from ces_identify.validation.residuals import cross_correlation, residual_tests, scale_sequence, verdicts, whiteness


def correlated(first, second):
    runs = single_run(len(first))
    pair = scale_sequence("input", first, runs), scale_sequence("residual", second, runs)
    return cross_correlation(*pair, runs, 50, 500.0)


def fails(first, second):
    return not correlated(first, second).passed


def test_ljung_box_is_the_formula():
    x = coloured(300, 0.2, 1)
    c = x - x.mean()
    r = np.array([(c[k:] * c[: len(c) - k]).sum() for k in range(11)]) / (c**2).sum()
    expected = 300 * 302 * sum(r[k] ** 2 / (300 - k) for k in range(1, 11))
    correlation, statistic = whiteness(x, single_run(300), 10, 500.0)
    assert statistic == pytest.approx(expected)
    assert correlation.p_value == pytest.approx(chi2.sf(expected, 10))
    np.testing.assert_allclose(correlation.values, r, atol=1e-12)


def test_white_residuals_pass_and_coloured_ones_do_not():
    p_values = [whiteness(coloured(4000, 0.0, seed), single_run(4000), 50, 500.0)[0].p_value for seed in range(100)]
    assert np.mean(np.array(p_values) < 0.1) == pytest.approx(0.1, abs=0.09)
    assert whiteness(coloured(4000, 0.2, 1), single_run(4000), 50, 500.0)[0].p_value < 1e-6


@pytest.mark.parametrize("poles", [(0.95, 0.95), (0.98, 0.6)])
def test_bands_hold_for_independent_autocorrelated_sequences(poles):
    pairs = [(coloured(8000, poles[0], s), coloured(8000, poles[1], s + 1000)) for s in range(100)]
    correlation = [correlated(a, b) for a, b in pairs]
    assert np.mean([np.abs(c.values) > c.band for c in correlation]) < 0.03
    assert np.mean([not c.passed for c in correlation]) <= 0.02
    white = 2.576 / np.sqrt(8000)  # the band that ignores autocorrelation is wrong most of the time
    assert np.mean([np.abs(c.values).max() > white for c in correlation]) > 0.5


def test_what_depends_on_a_past_input_is_found_at_its_lag():
    u, e = coloured(10_000, 0.9, 1), coloured(10_000, 0.9, 2)
    correlation = correlated(u, e + 0.3 * np.roll(u, 7))
    assert not correlation.passed
    assert correlation.lags_s[correlation.worst] == pytest.approx(7 / 500.0)
    assert correlation.share == pytest.approx(0.09 / 1.09, rel=0.4)
    assert not fails(u, e)


def test_a_constant_input_is_left_out():
    recorded = series(current=np.full(10_000, 0.5))
    tests = residual_tests(evaluation(recorded, coloured(10_000, 0.5, 9)))
    assert tests.still == ("current",)
    assert len(tests.inputs) == 2


def test_verdicts_say_what_is_left_and_where():
    recorded = series(20_000)
    clean, left = (evaluation(recorded, 5.0 * coloured(20_000, 0.0, 9) + gain * recorded.speed) for gain in (0.0, 10.0))
    assert verdicts(residual_tests(clean))[0].startswith("white")
    assert verdicts(residual_tests(clean))[1].startswith("no correlation left with speed, position, current")
    white, inputs = verdicts(residual_tests(left))
    assert white.startswith("not white")
    assert "with speed 0 ms before" in inputs


def test_none_for_a_run_that_diverged_or_is_too_short():
    assert residual_tests(evaluation(series(), np.full(10_000, np.nan))) is None
    assert residual_tests(evaluation(series(150), coloured(150, 0.0, 1))) is None


def test_a_residual_or_an_input_of_constant_size_is_no_failure():
    recorded = series(speed=0.3 * np.sign(np.sin(np.arange(10_000) / 40.0 + 0.1)))
    tests = residual_tests(evaluation(recorded, 5.0 * np.sign(coloured(10_000, 0.0, 4))))
    assert all(np.isfinite(c.values).all() for c in tests.inputs)
