"""The running cost against the formula on arrays, and what counts as a drift."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest
from damper_models import plain_damper
from hypothesis import given, settings
from hypothesis import strategies as st

from ces_observer.health.running_cost import HISTORY, RunningCost, default_warn_J

MS = 1_000_000
SECOND = 1000 * MS
START = 1_700_000_000 * SECOND


def force(time_s: np.ndarray) -> np.ndarray:
    return 100.0 + 800.0 * np.sin(2.0 * np.pi * 1.7 * time_s)


def feed(cost: RunningCost, first_s: float, last_s: float, error_N: float = 0.0) -> None:
    """Estimate and measure at 1 kHz, half a period apart, with an error that changes sign at each sample."""
    ticks = np.arange(round(first_s * 1000), round(last_s * 1000))
    sign = np.where(ticks // 2 % 2, 1.0, -1.0)
    estimates = force(ticks * 1e-3)
    measured = force(ticks * 1e-3 + 5e-4) + error_N * sign
    for tick, mine, theirs in zip(ticks.tolist(), estimates.tolist(), measured.tolist(), strict=True):
        cost.add_estimate(START + tick * MS, mine)
        cost.add_measured(START + tick * MS + MS // 2, theirs)


@pytest.mark.slow
@settings(deadline=None, max_examples=25)
@given(seed=st.integers(0, 2**32), delay=st.integers(-300, 300), window_s=st.integers(1, 5))
def test_J_is_the_formula_over_the_window_in_either_order(seed: int, delay: int, window_s: int) -> None:
    """`delay` is how many estimates later (or sooner) than their time the measured forces come in."""
    chance = np.random.default_rng(seed)
    ticks = START + np.arange(6000) * MS
    stamps = np.sort(START + chance.integers(0, 5900 * MS, 3000))
    estimates = force((ticks - START) * 1e-9) + chance.normal(0.0, 50.0, len(ticks))
    measured = force((stamps - START) * 1e-9) + chance.normal(0.0, 30.0, len(stamps))
    cost = RunningCost(window_s=window_s)
    calls = [(k, 0, int(ticks[k]), float(estimates[k])) for k in range(len(ticks))]
    arrivals = np.searchsorted(ticks, stamps) + delay
    calls += [(int(a), 1, int(s), float(y)) for a, s, y in zip(arrivals, stamps, measured, strict=True)]
    text = {}
    for _, kind, stamp, value in sorted(calls, key=lambda call: call[:2]):
        (cost.add_measured if kind else cost.add_estimate)(stamp, value)
        if cost._end_ns not in text and cost._seconds:
            text[cost._end_ns] = (cost.J, len(cost._seconds))
    assert text
    for end, (J, seconds) in text.items():
        inside = (stamps >= end - (seconds + 1) * SECOND) & (stamps < end - SECOND)
        inside &= stamps > START
        y = measured[inside]
        y_hat = np.interp(stamps[inside] - START, ticks - START, estimates)
        expected = 100.0 * np.linalg.norm(y - y_hat) / np.linalg.norm(y - y.mean())
        assert pytest.approx(expected, rel=1e-6) == J
    assert cost.unpaired == 0


def test_a_good_model_has_a_low_cost_and_a_bad_one_drifts() -> None:
    cost = RunningCost(window_s=10, warn_J=15.0)
    feed(cost, 0.0, 12.0)
    assert cost.J is not None and cost.J < 0.1
    assert not cost.drifted
    feed(cost, 12.0, 24.0, error_N=200.0)
    assert cost.drifted
    assert pytest.approx(100.0 * 200.0 / (800.0**2 / 2 + 200.0**2) ** 0.5, rel=1e-3) == cost.J
    feed(cost, 24.0, 33.5)
    assert cost.drifted  # the window still remembers
    feed(cost, 33.5, 40.0)
    assert not cost.drifted


def test_a_second_of_bad_luck_is_no_drift_but_three_are() -> None:
    cost = RunningCost(window_s=10, warn_J=15.0)
    feed(cost, 0.0, 12.0)
    feed(cost, 12.0, 13.2, error_N=2000.0)
    feed(cost, 13.2, 30.0)
    assert not cost.drifted
    feed(cost, 30.0, 33.2, error_N=2000.0)
    feed(cost, 33.2, 35.0)
    assert cost.drifted


def test_a_damper_that_hardly_moves_is_not_judged() -> None:
    cost = RunningCost(min_N=20.0)
    for k in range(5000):
        cost.add_estimate(START + k * MS, 100.0)
        cost.add_measured(START + k * MS, 100.0 + 15.0 * (-1) ** k)
    assert cost.J is None
    assert cost.spread_N == pytest.approx(15.0)
    assert not cost.drifted


def test_few_pairs_are_not_judged() -> None:
    cost = RunningCost(window_s=3)
    for k in range(5000):
        cost.add_estimate(START + k * MS, float(k % 500))
        if k % 50 == 0:
            cost.add_measured(START + k * MS, float(k % 500))
    assert cost.paired == 100
    assert cost.J is None


def test_simulated_time_may_begin_at_one_second() -> None:
    """The first second that ends is then one without any pair."""
    cost = RunningCost()
    for tick in range(1000, 3500):
        cost.add_estimate(tick * MS, 100.0 * (tick % 7))
        cost.add_measured(tick * MS, 100.0 * (tick % 7))
    assert cost.J == 0.0


def test_gaps_between_estimates_are_not_bridged() -> None:
    cost = RunningCost(max_gap_s=0.05)
    cost.add_measured(START - MS, 1.0)
    cost.add_estimate(START, 0.0)
    cost.add_measured(START + 30 * MS, 1.0)
    cost.add_estimate(START + 60 * MS, 0.0)
    cost.add_measured(START + 80 * MS, 1.0)
    cost.add_estimate(START + 110 * MS, 0.0)
    assert (cost.paired, cost.unpaired) == (1, 2)


@pytest.mark.parametrize("value", [nan, inf, -inf])
def test_a_measured_force_that_is_not_finite_is_counted_and_ignored(value: float) -> None:
    cost = RunningCost()
    feed(cost, 0.0, 1.5)
    cost.add_measured(START + 1500 * MS, value)
    feed(cost, 1.5, 3.5)
    assert cost.ignored == 1
    assert cost.J is not None and cost.J < 0.1


@pytest.mark.parametrize("jump_s", [-3600, -20, 3600])
def test_a_time_jump_begins_a_new_window(jump_s: int) -> None:
    cost = RunningCost(window_s=5)
    feed(cost, 0.0, 6.0, error_N=300.0)
    drifted = cost.drifted
    feed(cost, 6.0 + jump_s, 9.5 + jump_s)
    assert cost.J is not None and cost.J < 0.1
    assert drifted


def test_memory_is_bounded_when_one_side_never_comes() -> None:
    cost = RunningCost()
    for k in range(3 * HISTORY):
        cost.add_measured(START + k * MS, 1.0)
    assert cost.unpaired == 2 * HISTORY
    for k in range(5 * HISTORY):
        cost.add_estimate(START + (3 * HISTORY + k) * MS, 1.0)
    assert len(cost._pairs._stamps) <= 2 * HISTORY


def test_the_threshold_comes_from_the_models_own_costs() -> None:
    def row(role: str, J: object) -> dict[str, object]:
        return {"recording": "r", "role": role, "J": J}

    def warn(*rows: object) -> float:
        return default_warn_J(replace(plain_damper(), provenance={"cost_J_percent": list(rows)}))

    assert warn(row("identification", 30.0), row("validation", 6.0), row("validation", 8.5)) == 17.0
    assert warn(row("identification", 7.0)) == 14.0
    assert warn(row("validation", 2.0)) == 10.0
    assert warn(row("validation", None), "nonsense", row("validation", nan)) == 10.0
    wrong = replace(plain_damper(), provenance={"cost_J_percent": 3})
    assert default_warn_J(plain_damper()) == default_warn_J(wrong) == 10.0


def test_of_model_takes_its_scale_from_the_model() -> None:
    cost = RunningCost.from_model(plain_damper())
    assert (cost.warn_J, cost.min_N) == (10.0, 160.0)
    assert RunningCost.from_model(plain_damper(), warn_J=33.0).warn_J == 33.0
