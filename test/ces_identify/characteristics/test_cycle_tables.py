"""Cycles of dampers with a known law: forces at the peak speed, work, hysteresis and offsets are theirs."""

import numpy as np
import pytest
from dyno_recordings import recording_of, sine_motion, triangle_motion

from ces_identify.characteristics.characterise import characterise
from ces_identify.characteristics.rows import NO_CYCLES
from ces_identify.simulations.simulation import FunctionSimulation
from ces_observer.errors import CesError
from ces_rig.experiments.virtual import load_experiment, packaged_experiments, run

T, X, V = sine_motion()
PEAK = 0.02 * 2.0 * np.pi * 2.0
NOISE = 5.0


def reasons(results):
    return {(o.subject, o.reason): o.count for o in results.omissions}


def test_a_viscous_damper_with_gas():
    """F = 1500 v + 100: work pi c omega A^2, equal widths, the offset at zero speed."""
    results = characterise(recording_of(T, X, 0.5, 1500.0 * V + 100.0, NOISE))
    (work,) = results.work
    assert work.cycles >= 9
    assert work.work_J == pytest.approx(np.pi * 1500.0 * 4.0 * np.pi * 0.02**2, rel=3e-3)
    assert work.damping_Ns_m == pytest.approx(1500.0, rel=3e-3)
    assert work.power_W == pytest.approx(2.0 * work.work_J, rel=1e-3)
    assert work.mid_force_N == pytest.approx(100.0, abs=3.0 * NOISE / np.sqrt(work.cycles))
    assert work.zero_width_N == pytest.approx(0.0, abs=4.0 * NOISE / np.sqrt(work.cycles))
    assert work.zero_width_per_ms_N == pytest.approx(2.0 * 1500.0 * PEAK * 4.0 * np.pi * 1e-3, rel=0.1)
    compression, rebound = results.peak_velocity
    assert (compression.direction, rebound.direction) == ("compression", "rebound")
    assert compression.speed_m_s == pytest.approx(PEAK, rel=0.015)
    assert compression.force_N == pytest.approx(1500.0 * compression.speed_m_s + 100.0, abs=NOISE)
    assert rebound.force_N == pytest.approx(1500.0 * rebound.speed_m_s + 100.0, abs=NOISE)
    assert work.rebound_ratio == pytest.approx(-rebound.force_N / compression.force_N, rel=1e-9)
    for row in results.continuous:
        assert row.force_N == pytest.approx(1500.0 * row.speed_m_s + 100.0, abs=2.0 * NOISE)
        assert row.width_N == pytest.approx(0.0, abs=3.0 * NOISE)


def test_friction_and_a_spring():
    """Coulomb friction does 4 A F_C a cycle; a spring adds 2 A k to the width at zero speed and no work."""
    force = 300.0 * np.tanh(V / 1e-3) + 2000.0 * X
    (work,) = characterise(recording_of(T, X, 0.0, force, NOISE)).work
    assert work.work_J == pytest.approx(4.0 * 0.02 * 300.0, rel=0.01)
    assert work.zero_width_N == pytest.approx(2.0 * 0.02 * 2000.0, abs=60.0)


def test_a_force_that_lags_has_a_positive_width_of_the_right_size():
    """F(t) = c v(t - 2 ms): at half the peak speed the branches differ by 2 c a 2 ms."""
    omega, delay = 4.0 * np.pi, 2e-3
    force = 1500.0 * PEAK * np.cos(omega * (T - delay))
    results = characterise(recording_of(T, X, 0.0, force, NOISE))
    half = [row for row in results.continuous if abs(abs(row.speed_m_s) / PEAK - 0.5) < 0.02]
    expected = 2.0 * 1500.0 * PEAK * omega * np.sin(np.pi / 3.0) * delay
    assert [row.direction for row in half] == ["compression", "rebound"]
    for row in half:
        assert row.width_N == pytest.approx(expected, abs=3.0 * NOISE)
    assert results.work[0].zero_width_N == pytest.approx(2.0 * 1500.0 * PEAK * np.sin(omega * delay), abs=2.0 * NOISE)


def test_a_triangle_reads_its_plateau():
    t, x, v = triangle_motion()
    results = characterise(recording_of(t, x, 0.0, 1000.0 * v, NOISE, noise_m=1e-5))
    for row in results.peak_velocity:
        assert abs(row.speed_m_s) == pytest.approx(0.2, rel=5e-3)
        assert row.force_N == pytest.approx(1000.0 * row.speed_m_s, abs=2.0)


def test_levels_of_current_and_conditions_are_separate_rows():
    records = [recording_of(*sine_motion()[:2], i, 1e3 * (1 + i) * V, NOISE, seed=k) for k, i in enumerate((0.3, 0.5))]
    t, x, v = sine_motion(0.01, 4.0)
    records.append(recording_of(t, x, 0.5, 1500.0 * v, NOISE))
    results = characterise(records)
    rows = [(round(row.current_A, 6), round(row.frequency_Hz)) for row in results.work]
    assert sorted(rows) == [(0.3, 2), (0.5, 2), (0.5, 4)]
    assert [row.damping_Ns_m for row in results.work] == pytest.approx([1300.0, 1500.0, 1500.0], rel=0.01)


def test_cycles_with_a_changing_current_are_excluded_and_counted():
    current = np.where(np.floor(T / 1.5) % 2 == 0, 0.3, 0.6)  # every third cycle or so is disturbed
    results = characterise(recording_of(T, X, current, 1000.0 * V, NOISE))
    (facts,) = results.recordings
    changes = reasons(results)["cycles", "the current changes within the cycle or the 0.1 s before it"]
    assert facts.cycles == facts.cycles_used + changes
    assert changes > 0
    assert facts.cycles_used > 0
    assert {round(row.current_A, 6) for row in results.peak_velocity} == {0.3, 0.6}


def test_random_motion_has_no_peak_velocity_but_quantiles_over_speed():
    t = np.arange(0.0, 20.0, 1e-3)
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft(rng.standard_normal(len(t)))
    spectrum[np.fft.rfftfreq(len(t), 1e-3) > 8.0] = 0.0
    x = np.fft.irfft(spectrum, len(t))
    x *= 0.01 / x.std()
    v = np.gradient(x, t)
    results = characterise(recording_of(t, x, 0.4, 900.0 * v, NOISE))
    assert not results.peak_velocity
    assert not results.work
    assert ("force over speed, loops, work", NO_CYCLES) in reasons(results)
    assert len(results.speed_bins) > 20
    for row in results.speed_bins:
        middle = 0.5 * (row.speed_from_m_s + row.speed_to_m_s)
        assert row.median_N == pytest.approx(900.0 * middle, abs=900.0 * (row.speed_to_m_s - row.speed_from_m_s))
        assert row.low_N < row.median_N < row.high_N
        assert row.visits >= 3


def test_simulations_are_read_at_the_same_cycles_with_their_difference():
    recording = recording_of(T, X, 0.5, 1000.0 * V, NOISE)

    def softer(time_s, position_m, current_A):
        return 900.0 * np.gradient(position_m, time_s)

    results = characterise(recording, simulations={"softer": FunctionSimulation("softer", softer)})
    assert results.sources == ("measured", "softer")
    measured, simulated = (next(r for r in results.peak_velocity if r.source == s) for s in results.sources)
    assert np.isnan(measured.difference_N)
    assert simulated.difference_N == pytest.approx(simulated.force_N - measured.force_N)
    assert simulated.difference_N == pytest.approx(-100.0 * PEAK, abs=NOISE)
    work = {row.source: row for row in results.work}
    assert work["softer"].work_J == pytest.approx(0.9 * work["measured"].work_J, rel=0.01)


def test_a_simulation_without_force_has_no_rows_there():
    recording = recording_of(T, X, 0.5, 1000.0 * V, NOISE)
    late = 1000.0 * V
    late[T < 3.0] = np.nan  # as an estimator that warms up
    results = characterise(recording, simulations={"late": [late]})
    cycles = {row.source: row.cycles for row in results.work}
    assert 0 < cycles["late"] <= cycles["measured"] // 2 + 1
    nothing = characterise(recording, simulations={"nothing": [np.full(len(T), np.nan)]})
    assert {row.source for row in nothing.work} == {"measured"}


def test_a_loop_that_dissipates_nothing_has_no_damping_and_a_reason():
    results = characterise(recording_of(T, X, 0.5, -1000.0 * V, NOISE))
    (work,) = results.work
    assert ("rows of the work per cycle", work.note) in reasons(results)
    assert work.work_J < 0.0
    assert np.isnan(work.damping_Ns_m)
    assert np.isnan(work.rebound_ratio)
    assert "check the sign" in work.note


def test_a_pause_is_not_bridged():
    keep = (T < 2.2) | (T > 2.9)
    results = characterise(recording_of(T[keep], X[keep], 0.5, (1000.0 * V)[keep], NOISE))
    assert results.work[0].work_J == pytest.approx(np.pi * 1000.0 * 4.0 * np.pi * 0.02**2, rel=0.01)
    assert results.work[0].cycles < 10


def test_names_that_clash_are_refused():
    with pytest.raises(CesError, match="a simulation is named 'measured'"):
        characterise(recording_of(T, X, 0.5, V), simulations={"measured": [V]})


@pytest.mark.slow
def test_the_packaged_experiment_shows_all_of_it():
    recording = run(load_experiment(packaged_experiments()["characterise"]))
    results = characterise(recording, rules={"speeds_m_s": [0.131, 0.262, 0.524, 1.047]})
    assert len({round(row.current_A, 2) for row in results.work}) == 4
    assert len(results.work) == 16
    assert min(row.cycles for row in results.work) >= 4
    assert {row.target_m_s for row in results.ranges} == {0.131, 0.262, 0.524, 1.047}
    for row in results.over_current:  # the pilot's magnetic loop is 2 x 15 mA wide, at every speed
        if np.isfinite(row.width_N):
            assert row.width_N > 5.0 * row.width_ci95_N > 0.0
    assert {(r.change, r.direction) for r in results.responses if r.steps >= 5} == {
        (change, direction) for change in ("soft to hard", "hard to soft") for direction in ("compression", "rebound")
    }


def test_an_empty_table_keeps_its_columns():
    pytest.importorskip("pandas")
    frame = characterise(recording_of(T, X, 0.5, V)).to_frame("ranges")
    assert len(frame) == 0 and {"speed_m_s", "soft_A", "hard_A"} <= {*frame.columns}
