"""The endless road has the spectrum of ISO 8608, under the wheels of a vehicle at any speed."""

import numpy as np
import pytest
from scipy.signal import welch

from ces_rig.drive.strokes import ROUGHNESS_M3
from ces_rig.live.motion import AVERAGING, CLASSES, CONTACT_M, MAX_WAVE_M, ROAD_BLOCK, LiveRoad, roughness_m3

INTERVAL = 0.5e-3


def heights(road: LiveRoad, count: int) -> np.ndarray:
    return np.concatenate([road.heights(ROAD_BLOCK) for _ in range(count // ROAD_BLOCK)])


@pytest.mark.parametrize("road_class", CLASSES)
@pytest.mark.parametrize("speed", [4.0, 25.0])
def test_density_is_that_of_the_standard(road_class, speed):
    """Waviness 2 and the class's level at 0.1 cycles/m, between the longest waves and the tyre's contact patch."""
    road = LiveRoad(road_class, speed, INTERVAL, np.random.default_rng(1))
    apart = speed * INTERVAL
    every = max(1, round(0.05 / apart))
    height = heights(road, round(20_000 / apart))[::every]
    wave, density = welch(height, 1 / (apart * every), nperseg=2**13)
    band = (wave > 0.03) & (wave < 1.0)
    slope, level = np.polyfit(np.log(wave[band] / 0.1), np.log(density[band]), 1, w=wave[band] ** -0.5)
    assert slope == pytest.approx(-2.0, abs=0.12)
    assert np.exp(level) == pytest.approx(16e-6 * 4 ** CLASSES.index(road_class), rel=0.15)


def test_density_as_declared_holds_down_to_the_contact_patch():
    road = LiveRoad("C", 10.0, INTERVAL, np.random.default_rng(2))
    wave, density = welch(heights(road, 2_000_000), 1 / (10.0 * INTERVAL), nperseg=2**15)
    band = (wave > 0.05) & (wave < 10.0)
    patch = 2.0 * np.pi * CONTACT_M / AVERAGING
    profile = roughness_m3("C") * 0.1**2 / (wave[band] ** 2 + MAX_WAVE_M**-2)
    ratio = density[band] * (1.0 + (patch * wave[band]) ** 2) / profile
    for part in np.array_split(ratio, 10):
        assert part.mean() == pytest.approx(1.0, abs=0.1)


def test_classes_are_those_of_the_recorded_rig():
    assert {name: roughness_m3(name) for name in ROUGHNESS_M3} == pytest.approx(ROUGHNESS_M3)


def test_at_standstill_the_road_stands_still():
    road = LiveRoad("D", 20.0, INTERVAL, np.random.default_rng(3))
    heights(road, 10_000)
    road.speed_m_s = 0.0
    height = heights(road, 1000)
    assert np.ptp(height[ROAD_BLOCK:]) == 0.0


def test_a_change_of_class_does_not_jump():
    road = LiveRoad("A", 20.0, INTERVAL, np.random.default_rng(4))
    before = heights(road, 5000)
    road.road_class = "F"
    after = heights(road, 5000)
    assert abs(after[0] - before[-1]) < 0.01
    assert np.diff(after).std() > 10 * np.diff(before).std()


def test_the_same_whatever_the_portions():
    whole, parts = (LiveRoad("B", 15.0, INTERVAL, np.random.default_rng(5)) for _ in range(2))
    assert np.array_equal(
        heights(whole, 600), np.concatenate([parts.heights(n) for n in (3, 97, 100, 99, 100, 100, 1, 100)])
    )
