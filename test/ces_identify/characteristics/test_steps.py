"""Steps of the current: times of a known lag are read with an interval that holds it; the rest has a reason."""

import numpy as np
import pytest
from dyno_recordings import lagging_force, recording_of, sine_motion, triangle_motion

from ces_identify.characteristics.characterise import characterise
from ces_identify.characteristics.rows import NO_STEPS, NO_STEPS_READ

LAG_S, DEAD_S = 0.012, 0.003


def stepped(noise_N=5.0, spread=1.0):
    """Constant speed back and forth, current up and down in mid-stroke of compression and rebound."""
    t, x, v = triangle_motion(duration_s=18.0)
    levels = np.array([0.3, 0.7, 0.3, 0.3, 0.7, 0.3])
    index = np.floor(t / 0.3 + 1e-9).astype(int) % len(levels)
    current = levels[index]
    changes = np.flatnonzero(np.diff(current)) + 1
    states = [current[0], *current[changes]]
    lagged = lagging_force(t, np.array(states), t[changes], LAG_S, DEAD_S)
    return recording_of(t, x, current, spread * 2000.0 * lagged * np.tanh(v / 0.01), noise_N)


def test_times_of_a_lag_with_a_dead_time():
    results = characterise(stepped())
    kinds = [(r.change, r.direction) for r in results.responses]
    assert sorted(kinds) == [(c, d) for c in ("hard to soft", "soft to hard") for d in ("compression", "rebound")]
    for row in results.responses:
        assert row.steps >= 8
        assert row.time_63_s == pytest.approx(LAG_S + DEAD_S, abs=row.time_63_ci95_s)
        assert row.dead_time_s == pytest.approx(DEAD_S, abs=row.dead_time_ci95_s)
        assert row.time_constant_s == pytest.approx(LAG_S, abs=max(row.time_constant_ci95_s, 3e-4))
        assert row.rise_s == pytest.approx(np.log(9.0) * LAG_S, abs=max(row.rise_ci95_s, 6e-4))
        assert 5e-4 <= row.time_63_ci95_s < 1.5e-3  # not better than half the sampling interval of the current
        assert abs(row.speed_m_s) == pytest.approx(0.2, rel=0.02)
    trace = [p for p in results.response_points if p.direction == "compression" and p.to_A > 0.5]
    at_63 = np.interp(LAG_S + DEAD_S, [p.time_s for p in trace], [p.share for p in trace])
    assert at_63 == pytest.approx(0.632, abs=0.05)


def test_steps_in_a_sine_are_not_read_and_counted():
    t, x, v = sine_motion(frequency_Hz=3.0)
    current = np.where(np.floor(t / 0.37) % 2 == 0, 0.3, 0.7)
    results = characterise(recording_of(t, x, current, 2000.0 * current * v))
    read = [s for s in results.steps if not s.note]
    assert len(results.steps) >= 12
    assert not read
    assert not results.responses
    assert any(o.reason == NO_STEPS_READ for o in results.omissions)
    assert sum(o.count for o in results.omissions if o.subject == "steps") == len(results.steps)


def test_a_constant_current_cannot_tell():
    t, x, v = sine_motion()
    results = characterise(recording_of(t, x, 0.5, 1000.0 * v))
    assert not results.steps
    assert any(o.reason == NO_STEPS for o in results.omissions)


@pytest.mark.parametrize(
    ("noise_N", "spread", "reason"), [(5.0, 0.03, "times its noise"), (5.0, 0.0, "times its noise")]
)
def test_a_change_below_the_noise_is_not_read(noise_N, spread, reason):
    results = characterise(stepped(noise_N, spread))
    assert not results.responses
    assert all(reason in s.note or "speed is not constant" in s.note or "edge" in s.note for s in results.steps)


def test_a_slow_ramp_is_no_step():
    t, x, v = triangle_motion()
    current = 0.5 + 0.2 * np.clip(np.sin(2.0 * np.pi * t / 2.0) * 3.0, -1.0, 1.0)
    assert not characterise(recording_of(t, x, current, 1000.0 * v)).steps
