"""The sample recordings, and ways to spoil them."""

import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from made_recordings import recording_of

from ces_data.bags.reader import read_recording
from ces_data.signals_file import load_signals

ROOT = Path(__file__).resolve().parents[2]


@cache
def bag(name):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return read_recording(ROOT / "bags" / name, load_signals(), ("position", "current", "force"))


def changed(recording, **values):
    """Return the recording with functions of the values of some channels."""
    channels = {
        name: replace(c, values=values[name](c.values)) if name in values else c
        for name, c in recording.channels.items()
    }
    return replace(recording, channels=channels)


def shifted(recording, signal, seconds):
    channel = recording.channels[signal]
    later = replace(channel, stamps_ns=channel.stamps_ns + round(seconds * 1e9))
    return replace(recording, channels={**recording.channels, signal: later})


def thinned(recording, step):
    channels = {
        n: c.select(np.arange(len(c)) % (step // 2 if n == "current" else step) == 0)
        for n, c in recording.channels.items()
    }
    return replace(recording, channels=channels)


def held(fraction_from, fraction_to):
    def apply(values):
        first, last = (round(f * len(values)) for f in (fraction_from, fraction_to))
        return np.concatenate([values[:first], np.full(last - first, values[first]), values[last:]])

    return apply


def sine(hertz):
    """Return a damper with friction and a little elasticity on one sine at one current, without noise in the stroke."""
    time = np.arange(16000) * 1e-3
    x = 0.05 / hertz * np.sin(2.0 * np.pi * hertz * time) * np.minimum(1.0, time)
    v = np.gradient(x, time)
    force = 1500.0 * v + 120.0 * np.tanh(v / 0.02) + np.random.default_rng(1).normal(0.0, 3.0, len(time))
    return recording_of(time, f"sine_{hertz:g}", position=x, current=np.zeros(len(time)), force=force)
