"""The road has the spectrum of ISO 8608; the vehicle follows it as a quarter vehicle must."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import welch

from ces_rig.drive.strokes import ROUGHNESS_M3, QuarterVehicle, road_stroke

STEP, SPEED = 1e-3, 16.7
TIME = np.arange(0, 400, STEP)


class Rigid(QuarterVehicle):
    """A vehicle whose stroke is the road's height."""

    def stroke_response(self, frequency_Hz):
        return np.ones_like(frequency_Hz)


@pytest.mark.parametrize("road_class", list(ROUGHNESS_M3))
def test_density_of_the_road(road_class):
    height = road_stroke(road_class, SPEED, TIME, np.random.default_rng(1), Rigid())
    frequency, density = welch(height, 1 / STEP, nperseg=2**15)
    band = (frequency > 0.5) & (frequency < 20)
    wave, spatial = frequency[band] / SPEED, density[band] * SPEED
    slope, level = np.polyfit(np.log(wave / 0.1), np.log(spatial), 1)
    assert slope == pytest.approx(-2.0, abs=0.05)
    assert np.exp(level) == pytest.approx(ROUGHNESS_M3[road_class], rel=0.1)


def test_nothing_above_the_band():
    height = road_stroke("C", SPEED, TIME[:20_000], np.random.default_rng(1), Rigid())
    amplitude = np.abs(np.fft.rfft(height))
    frequency = np.fft.rfftfreq(len(height), STEP)
    assert amplitude[frequency > 50.01].max() < 1e-9 * amplitude.max()


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
    strokes = {c: road_stroke(c, SPEED, TIME[:60_000], np.random.default_rng(2)) for c in "AC"}
    assert 0.004 < strokes["C"].std() < 0.012
    assert strokes["C"].std() == pytest.approx(4 * strokes["A"].std())  # roughness is 16 times as much
