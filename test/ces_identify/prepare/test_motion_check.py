"""A speed or acceleration that all recordings hold is used, and a wrong unit of one of them is named."""

from dataclasses import replace

import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_identify.prepare.sampling import choose_sampling
from ces_observer.errors import RecordingError

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
    ("signals", "motion"),
    [
        ([(), ()], ""),
        ([("speed",), ("speed",)], "speed"),
        ([("speed",), ()], ""),
        ([("acceleration",), ("acceleration",)], "acceleration"),
        ([("speed", "acceleration"), ("acceleration",)], "acceleration"),
        ([("speed", "acceleration"), ("speed", "acceleration")], "speed"),
    ],
)
def test_a_signal_that_all_recordings_have_is_used(signals, motion):
    assert choose_sampling([recording(*names) for names in signals]).motion == motion


@pytest.mark.parametrize(("signal", "noise"), [("speed", 0.02), ("acceleration", 2.0)])
def test_the_noise_of_the_signal_is_recovered(signal, noise):
    made = recording(signal)
    channel = made.channel(signal)
    values = channel.values + np.random.default_rng(3).normal(0.0, noise, len(channel.values))
    noisy = replace(made, channels={**made.channels, signal: replace(channel, values=values)})
    assert choose_sampling([noisy]).motion_noise == pytest.approx(noise, rel=0.35)


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        (
            {"speed": (1000.0, 0.0)},
            r"made: speed: is 1e\+03 times what the position's derivative says; multiply its scale .* by 0.001$",
        ),
        ({"speed": (-1.0, 0.0)}, "made: speed: is -1 times .* by -1$"),
        ({"acceleration": (1 / 9.81, 0.0)}, "made: acceleration: is 0.1 times .* by 9.8$"),
        ({"acceleration": (1.0, 9.81)}, "made: acceleration: has a mean of 9.81 m/s2, .*; add -9.81 to its offset"),
    ],
)
def test_a_wrong_unit_sign_or_offset_is_named(signals, message):
    with pytest.raises(RecordingError, match=message):
        choose_sampling([recording(*signals, **signals)])


def test_a_signal_of_something_else_is_named():
    made = recording("speed")
    noise = np.random.default_rng(2).normal(0.0, 1.0, 30_000)
    other = replace(made, channels={**made.channels, "speed": replace(made.channel("speed"), values=noise)})
    with pytest.raises(RecordingError, match="made: speed: does not follow the position"):
        choose_sampling([other])
