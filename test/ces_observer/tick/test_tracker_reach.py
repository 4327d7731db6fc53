"""After lost samples on a fast stroke the estimate is soon back and true; what no piston can reach is an outlier."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, pi, sin
from pathlib import Path

import pytest
from trackers import Tracker

from ces_observer.bank_design import response_s
from ces_observer.estimator import Estimator
from ces_observer.model import load_model
from ces_observer.reasons import OK, OUTLIER, RESTARTED, UNSETTLED
from ces_observer.sampling_layout import MAX_CHANGE, OVERDUE, SETTLING
from ces_observer.tick.tracker import PATIENCE

MS = 1_000_000
PHASES = 24
PEAK_M_S = 1.5  # the fastest that the sample model was identified on
FILED = load_model(Path(__file__).parents[3] / "config" / "models" / "sample.json")
MODEL = replace(FILED, sampling=replace(FILED.sampling, max_gap_s=0.1, stroke_m=(-1.0, 1.0)))


def stroke(k: int, hertz: float) -> float:
    """Return the position [m] at k ms."""
    return PEAK_M_S / (2.0 * pi * hertz) * sin(2e-3 * pi * hertz * k)


def rows_begin(hertz: float) -> list[int]:
    """Return when [ms] rows are lost: from 600 ms on, 250 ms or more apart, at every PHASES-th of a turn."""
    begins = [600]
    for phase in range(1, PHASES):
        turns = ceil(hertz * 1e-3 * (begins[-1] + 250)) + phase / PHASES
        begins.append(round(1e3 * turns / hertz))
    return begins


def errors_after(lost: int, hertz: float) -> list[list[float | None]]:
    """Return, for each lost row, the errors of the forces after it, as shares of the largest; None if withheld."""
    begins = rows_begin(hertz)
    gone = {begin + k for begin in begins for k in range(lost)}
    whole, gappy = Estimator(MODEL), Estimator(MODEL)
    true: list[float | None] = []
    error: list[float | None] = []
    for k in range(begins[-1] + 250):
        x = stroke(k, hertz)
        true.append(whole.step(k * MS, x, 0.5))
        force = None if k in gone else gappy.step(k * MS, x, 0.5)
        error.append(abs(force - true[-1]) if force is not None and true[-1] is not None else None)
    largest = max(abs(force) for force in true if force is not None)
    shares = [e if e is None else e / largest for e in error]
    return [shares[begin + lost : begin + 250] for begin in begins]


@pytest.mark.parametrize("lost", [1, 8, 12, 60])
@pytest.mark.parametrize("hertz", [4.0, 12.0, 20.0])
def test_after_lost_samples_the_estimate_is_soon_back_and_true_at_every_phase(hertz: float, lost: int) -> None:
    for errors in errors_after(lost, hertz):
        given = [k for k, error in enumerate(errors) if error is not None]
        assert given[0] <= 26
        assert given == list(range(given[0], len(errors))), "once given, it stays"
        assert max(errors[k] for k in given) < (0.05 if hertz < 12.0 else 0.12)
        assert max(errors[30:]) < 0.03


@pytest.mark.parametrize("hertz", [1.0, 2.0])
def test_on_a_slow_stroke_short_rows_withhold_nothing(hertz: float) -> None:
    for errors in errors_after(12, hertz):
        assert None not in errors
        assert max(errors) < 0.02


def gone_on(lost: int, departed_m: float, after: int = 5) -> list[str]:
    """Return what is said of samples at rest: of one by `departed_m` away after a row of lost ones, and of the next."""
    t = Tracker(MODEL.sampling)
    for k in range(200):
        t.advance(k * MS, 0.0)
    stamps = range(200 + lost, 201 + lost + after)
    return [t.advance(k * MS, departed_m if k == stamps[0] else 0.0) for k in stamps]


def reach_m(lost: int) -> float:
    """Return what a change of speed explains after a row of lost samples at 1 kHz, settling time included [m]."""
    s = MODEL.sampling
    overdue, ramp = (lost + 1 - OVERDUE) * 1e-3, SETTLING * response_s(s.stroke)
    changed = overdue - ramp / 2.0 if overdue > ramp else overdue**2 / (2.0 * ramp)
    return s.outlier_m + MAX_CHANGE * s.speed_m_s * changed


@pytest.mark.parametrize(("lost", "sign"), [(1, 1.0), (5, -1.0), (20, 1.0), (60, -1.0)])
def test_what_no_stroke_could_have_reached_is_an_outlier_and_nothing_else_is(lost: int, sign: float) -> None:
    assert gone_on(lost, 1.001 * sign * reach_m(lost)) == [OUTLIER] + [OK if lost <= 5 else UNSETTLED] * 5
    assert gone_on(lost, 0.999 * sign * reach_m(lost))[0] == UNSETTLED


def test_while_samples_come_in_time_the_reach_does_not_grow() -> None:
    t = Tracker(MODEL.sampling)
    for k in range(200):
        t.advance(k * MS, 0.0)
    jump = 1.1 * MODEL.sampling.outlier_m
    assert [t.advance(k * MS, jump) for k in range(200, 211)] == [OUTLIER] * PATIENCE + [RESTARTED]


def test_outliers_after_a_gap_do_not_end_what_it_explains() -> None:
    t = Tracker(MODEL.sampling)
    for k in range(200):
        t.advance(k * MS, stroke(k, 8.0))
    later = [t.advance(k * MS, stroke(k, 8.0) + (0.5 if k < 225 else 0.0)) for k in range(220, 250)]
    settling = later.count(UNSETTLED)
    assert later == [OUTLIER] * 5 + [UNSETTLED] * settling + [OK] * (25 - settling)
    assert 5 < settling < 20


def test_a_wrong_position_within_reach_costs_a_restart_at_most() -> None:
    """Positions that look like a motion: forces stay in their envelope, and are true again after the warm-up."""
    low, high = MODEL.force_envelope_N
    for departed in (0.005, 0.02, 0.04):
        whole, spoilt = Estimator(MODEL), Estimator(MODEL)
        for k in range(1400):
            x = stroke(k, 8.0)
            true = whole.step(k * MS, x, 0.5)
            if not 700 <= k < 720:
                force = spoilt.step(k * MS, x + (departed if k == 720 else 0.0), 0.5)
                assert force is None or low <= force <= high
        assert force is not None and force == pytest.approx(true, abs=1e-3)


def test_a_start_on_the_fastest_stroke_succeeds_at_once() -> None:
    t = Tracker(MODEL.sampling)
    outcomes = [t.advance(k * MS, stroke(k, 8.0)) for k in range(100)]
    assert outcomes[0] == RESTARTED
    assert set(outcomes[1:]) == {OK, UNSETTLED}  # withheld anyway: warming up
