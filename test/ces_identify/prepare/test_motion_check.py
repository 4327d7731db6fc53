"""The differentiator is chosen by the signals that were recorded, and a wrong unit of one of them is named."""

from dataclasses import replace

import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_identify.prepare.sampling import FUSED_HZ, WIDEST, choose_sampling, default_differentiator
from ces_observer.adaptive_differentiator import SHARES
from ces_observer.errors import RecordingError
from ces_observer.model import ADAPTIVE, FUSED, KALMAN, MEASURED

RATE = 1000.0
NOISE_M = 15e-6


def recording(*signals, speed=(1.0, 0.0), acceleration=(1.0, 0.0), noise=NOISE_M):
    """30 s of a stroke of four sines; a signal is (scale, offset) times the truth."""
    dice = np.random.default_rng(1)
    time = np.arange(30_000) / RATE
    stamps = np.rint(1e9 * time).astype(np.int64)
    x = v = a = np.zeros(len(time))
    for frequency, amplitude in ((1.3, 0.02), (3.1, 0.01), (7.7, 0.003), (14.0, 0.001)):
        omega, phase = 2.0 * np.pi * frequency, dice.uniform(0.0, 6.0)
        x = x + amplitude * np.sin(omega * time + phase)
        v = v + amplitude * omega * np.cos(omega * time + phase)
        a = a - amplitude * omega**2 * np.sin(omega * time + phase)
    columns = {
        "position": ("m", x + dice.normal(0.0, noise, len(x))),
        "speed": ("m/s", speed[0] * v + speed[1]),
        "acceleration": ("m/s2", acceleration[0] * a + acceleration[1]),
    }
    channels = {name: Channel(name, *columns[name][:1], stamps, columns[name][1]) for name in ("position", *signals)}
    return Recording("made", channels, {"current": 0.5})


@pytest.mark.parametrize(
    ("signals", "kind"),
    [
        ([(), ()], KALMAN),
        ([("speed",), ("speed",)], MEASURED),
        ([("speed",), ()], KALMAN),
        ([("acceleration",), ("acceleration",)], FUSED),
        ([("speed", "acceleration"), ("acceleration",)], FUSED),
        ([("speed", "acceleration"), ("speed", "acceleration")], MEASURED),
    ],
)
def test_a_signal_that_all_recordings_have_is_used(signals, kind):
    recordings = [recording(*names) for names in signals]
    assert default_differentiator(recordings) == kind
    assert choose_sampling(recordings).differentiator == kind


def test_a_given_differentiator_is_kept():
    both = [recording("speed", "acceleration")]
    assert [choose_sampling(both, differentiator=k).differentiator for k in (KALMAN, ADAPTIVE)] == [KALMAN, ADAPTIVE]
    with pytest.raises(RecordingError, match="no 'acceleration' channel"):
        choose_sampling([recording()], differentiator=FUSED)


@pytest.mark.parametrize("noise", [5e-6, 15e-6, 60e-6])
def test_the_noise_of_the_positions_is_recovered(noise):
    sampling = choose_sampling([recording(noise=noise)], differentiator=ADAPTIVE)
    assert sampling.noise_m == pytest.approx(noise, rel=0.1)


def test_no_filter_of_the_adaptive_differentiator_exceeds_the_stable_bandwidth():
    sampling = choose_sampling([recording(noise=1e-7)], differentiator=ADAPTIVE)
    assert sampling.bandwidth_Hz * max(SHARES) <= WIDEST[sampling.order] * RATE * 1.001


def test_an_accelerometer_lowers_the_bandwidth_but_not_the_rate():
    plain, fused = (choose_sampling([recording("acceleration")], differentiator=k) for k in (KALMAN, FUSED))
    assert (fused.bandwidth_Hz, fused.order, fused.rate_Hz) == (FUSED_HZ, 3, plain.rate_Hz)
    assert choose_sampling([recording("acceleration")], bandwidth_Hz=1.5).bandwidth_Hz == 1.5


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        (
            {"speed": (1000.0, 0.0)},
            r"made: speed is 1e\+03 times what the position's derivative says; multiply its scale .* by 0.001$",
        ),
        ({"speed": (-1.0, 0.0)}, "made: speed is -1 times .* by -1$"),
        ({"acceleration": (1 / 9.81, 0.0)}, "made: acceleration is 0.1 times .* by 9.8$"),
        ({"acceleration": (1.0, 9.81)}, "made: acceleration has a mean of 9.81, .*; add -9.81 to its offset"),
    ],
)
def test_a_wrong_unit_sign_or_offset_is_named(signals, message):
    with pytest.raises(RecordingError, match=message):
        choose_sampling([recording(*signals, **signals)])


def test_a_signal_of_something_else_is_named():
    made = recording("speed")
    noise = np.random.default_rng(2).normal(0.0, 1.0, 30_000)
    other = replace(made, channels={**made.channels, "speed": replace(made.channel("speed"), values=noise)})
    with pytest.raises(RecordingError, match="made: speed does not follow the position"):
        choose_sampling([other])
