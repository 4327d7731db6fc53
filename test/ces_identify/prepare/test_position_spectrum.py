"""Spectra of rough recordings are those of the strokes and noise they were made of."""

import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_data.samples import remove_spikes
from ces_identify.prepare.sampling import position_spectrum
from ces_observer.errors import RecordingError


def recording(stamps_s, position, name="made"):
    stamps = np.rint(np.asarray(stamps_s) * 1e9).astype(np.int64)
    return Recording(name, {"position": Channel("position", "m", stamps, position)}, {"current": 0.0})


@pytest.mark.parametrize("rate", [200.0, 1000.0, 3004.8])
def test_level_of_white_noise_and_power_of_a_sine(rate):
    time = np.arange(round(60.0 * rate)) / rate
    noise = np.random.default_rng(1).normal(0.0, 2e-5, len(time))
    spectrum = position_spectrum(recording(time, noise + 0.01 * np.sin(2 * np.pi * 4.0 * time)), 1.0)
    above = spectrum.frequency > 0.1 * rate
    assert spectrum.power[above].mean() == pytest.approx(2e-5**2 / (0.5 * rate), rel=0.05)
    assert spectrum.power[~above].sum() * spectrum.frequency[0] == pytest.approx(0.5 * 0.01**2, rel=0.02)


@pytest.mark.parametrize("run", [1, 2, 3])
def test_spikes_are_replaced_and_the_rest_is_left(run):
    x = np.sin(np.arange(2000) * 0.02) + np.random.default_rng(13).normal(0, 1e-4, 2000)
    dirty = x.copy()
    dirty[300 : 300 + run] += 4.0
    dirty[900 : 900 + run] -= 0.5
    clean = remove_spikes(dirty)
    assert abs(clean - x).max() < 3e-3
    assert np.count_nonzero(clean != x) <= 2 * run + 4


def test_a_position_that_does_not_move_is_refused():
    with pytest.raises(RecordingError, match="still: position does not move"):
        position_spectrum(recording(np.arange(5000) / 1000.0, np.full(5000, 0.01), "still"), 0.1)


def test_too_short_a_stretch_is_refused():
    with pytest.raises(RecordingError, match="64 position samples in a row"):
        position_spectrum(recording(np.arange(40) / 1000.0, np.sin(np.arange(40) * 0.1)), 0.1)
