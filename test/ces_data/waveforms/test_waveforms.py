"""Strokes and sequences of waveforms; mistakes name the part or the line."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import hilbert, welch

from ces_data.waveforms.strokes import KINDS, ROUGHNESS_M3, QuarterVehicle, make_stroke, road_stroke
from ces_rig.experiments.virtual import make_current

STEP = 0.5e-3

TIME = np.arange(0, 30 + STEP / 2, STEP)

EXAMPLES = [
    {"kind": "rest"},
    {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 4},
    {"kind": "sum_of_sines", "amplitudes_m": [0.01, 0.002], "frequencies_Hz": [1, 11.5]},
    {"kind": "sweep"},
    {"kind": "noise"},
    {"kind": "road"},
    {"kind": "frequency_modulated"},
    {"kind": "triangle", "amplitude_m": 0.02, "speed_m_s": 0.1},
]


def samples(given, seed=1, time=TIME):
    return make_stroke(given, "x.yaml: stroke").samples(time, np.random.default_rng(seed))


def test_examples_cover_every_kind():
    assert {e["kind"] for e in EXAMPLES} == set(KINDS) - {"sequence"}  # test_sequences.py


@pytest.mark.parametrize("given", EXAMPLES, ids=lambda e: e["kind"])
def test_every_kind_is_seeded_smooth_and_starts_at_rest(given):
    x = samples({**given, "offset_m": 0.003})
    assert np.array_equal(x, samples({**given, "offset_m": 0.003}))
    if given["kind"] in ("sum_of_sines", "noise", "road"):
        assert not np.allclose(samples(given, 1), samples(given, 2))
    assert abs(x[0] - 0.003) < 1e-12
    assert abs(x[-1] - 0.003) < 1e-12
    assert abs(x[1] - x[0]) / STEP < 1e-3
    coarse = np.interp(TIME, TIME[::2], x[::2])  # nothing between the samples of a 1 kHz sensor
    assert np.abs(coarse - x).max() < 20e-6


def test_sweep_runs_through_its_frequencies_within_its_speed():
    x = samples({"kind": "sweep", "from_Hz": 2, "to_Hz": 16, "amplitude_m": 0.018, "speed_m_s": 0.45, "fade_s": 0})
    frequency = np.gradient(np.unwrap(np.angle(hilbert(x)))) / (2 * np.pi * STEP)
    for at, expected in ((5.0, 2 + 14 / 6), (15.0, 9.0), (25.0, 2 + 14 * 25 / 30)):
        near = np.abs(TIME - at) < 0.25
        assert frequency[near].mean() == pytest.approx(expected, rel=0.01)
    assert np.abs(np.gradient(x, STEP)).max() < 0.46
    early, late = np.abs(x[TIME < 2]).max(), np.abs(x[TIME > 28]).max()
    assert 0.016 < early < 0.018
    assert late == pytest.approx(0.45 / (2 * np.pi * 16), rel=0.08)


def test_noise_has_its_span_and_the_spectrum_of_its_filter():
    x = samples({"kind": "noise", "peak_to_peak_m": 0.050, "cutoff_Hz": 15, "order": 10, "fade_s": 0})
    assert np.ptp(x) == pytest.approx(0.050)
    frequency, density = welch(x, 1 / STEP, nperseg=4000)
    level = density[(frequency > 2) & (frequency < 12)].mean()
    filtered = 1 / (1 + (22.0 / 15.0) ** 20)  # Butterworth's own law
    assert np.interp(15.0, frequency, density) == pytest.approx(level / 2, rel=0.35)
    assert np.interp(22.0, frequency, density) < 5 * level * filtered
    assert density[frequency > 30].max() < 1e-4 * level


def test_triangle_has_constant_speed_between_rounded_corners():
    x = samples({"kind": "triangle", "amplitude_m": 0.02, "speed_m_s": 0.1, "fade_s": 0})
    speed = np.gradient(x, STEP)
    assert (np.abs(np.abs(speed) - 0.1) < 1e-6).mean() > 0.9
    assert np.abs(np.gradient(speed, STEP)).max() < 2 * 0.2 / 0.02
    assert 0.019 < x.max() < 0.02


def test_frequency_modulation_swings_between_its_frequencies():
    x = samples({"kind": "frequency_modulated", "low_Hz": 1.5, "high_Hz": 8, "modulation_Hz": 0.2, "fade_s": 0})
    frequency = np.gradient(np.unwrap(np.angle(hilbert(x))))[2000:-2000] / (2 * np.pi * STEP)
    assert np.percentile(frequency, 2) == pytest.approx(1.5, abs=0.3)
    assert np.percentile(frequency, 98) == pytest.approx(8.0, abs=0.3)


ROAD_STEP, SPEED = 1e-3, 16.7

ROAD_TIME = np.arange(0, 400, ROAD_STEP)


class Rigid(QuarterVehicle):
    """A vehicle whose stroke is the road's height."""

    def stroke_response(self, frequency_Hz):
        return np.ones_like(frequency_Hz)


@pytest.mark.parametrize("road_class", list(ROUGHNESS_M3))
def test_density_of_the_road(road_class):
    height = road_stroke(road_class, SPEED, ROAD_TIME, np.random.default_rng(1), Rigid())
    frequency, density = welch(height, 1 / ROAD_STEP, nperseg=2**15)
    band = (frequency > 0.5) & (frequency < 20)
    wave, spatial = frequency[band] / SPEED, density[band] * SPEED
    slope, level = np.polyfit(np.log(wave / 0.1), np.log(spatial), 1)
    assert slope == pytest.approx(-2.0, abs=0.05)
    assert np.exp(level) == pytest.approx(ROUGHNESS_M3[road_class], rel=0.1)


def test_response_equals_the_equations_of_motion():
    v = QuarterVehicle()
    frequency = 3.0
    w = 2 * np.pi * frequency

    def slope(t, y):
        body, wheel, body_speed, wheel_speed = y
        suspension = v.spring_N_m * (wheel - body) + v.damping_Ns_m * (wheel_speed - body_speed)
        tyre = v.tyre_N_m * (np.sin(w * t) - wheel) + v.tyre_damping_Ns_m * (w * np.cos(w * t) - wheel_speed)
        return [body_speed, wheel_speed, suspension / v.sprung_kg, (tyre - suspension) / v.unsprung_kg]

    late = np.linspace(9, 10, 300)
    found = solve_ivp(slope, (0, 10), np.zeros(4), t_eval=late, rtol=1e-8, atol=1e-10)
    response = v.stroke_response(np.array([frequency]))[0]
    expected = np.abs(response) * np.sin(w * late + np.angle(response))
    assert found.y[1] - found.y[0] == pytest.approx(expected, abs=2e-4)


def test_stroke_is_that_of_a_real_suspension():
    strokes = {c: road_stroke(c, SPEED, ROAD_TIME[:60_000], np.random.default_rng(2)) for c in "AC"}
    assert 0.004 < strokes["C"].std() < 0.012
    assert strokes["C"].std() == pytest.approx(4 * strokes["A"].std())  # roughness is 16 times as much


SHORT_TIME = np.arange(0.0, 10.0, 1e-3)

SINE = {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 2.0, "duration_s": 3.0}

REST = {"kind": "rest", "duration_s": 1.0}


def stroke(*parts):
    given = make_stroke({"kind": "sequence", "parts": list(parts)}, "x.yaml: stroke")
    return given.samples(SHORT_TIME, np.random.default_rng(1))


def current(*parts):
    given = make_current({"kind": "sequence", "parts": list(parts)}, "x.yaml: current")
    return given.samples(SHORT_TIME, np.zeros_like(SHORT_TIME), np.random.default_rng(1))


def test_strokes_follow_one_another_and_begin_again():
    x = stroke(SINE, REST)
    assert not x[3001:4000].any()
    alone = make_stroke({k: v for k, v in SINE.items() if k != "duration_s"}, "x").samples(SHORT_TIME[:3000], None)
    np.testing.assert_array_equal(x[:3000], alone)
    np.testing.assert_allclose(x[4000:7000], alone, atol=1e-12)
    assert np.abs(np.diff(x)).max() <= 1.01 * 0.01 * 4 * np.pi * 1e-3  # no jump between the parts


def test_currents_follow_one_another():
    steps = {"kind": "steps", "levels_A": [0.3, 0.5], "hold_s": 0.5, "duration_s": 2.0}
    i = current({"kind": "constant", "current_A": 0.7, "duration_s": 1.0}, steps)
    at = [0.5, 1.2, 1.7, 2.2, 2.7, 3.5, 4.2]
    assert i[[round(1000 * t) for t in at]].tolist() == [0.7, 0.3, 0.5, 0.3, 0.5, 0.7, 0.3]
