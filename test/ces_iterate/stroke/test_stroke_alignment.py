"""Positions on the command's grid: late starts, missing samples, jitter, recordings that cannot be used."""

import numpy as np
import pytest

from ces_data.recording import Channel, Recording
from ces_iterate.errors import StrokeError
from ces_iterate.stroke.rigs import position_on_grid

INTERVAL = 1e-3
TIME = np.arange(3001) * INTERVAL
COMMAND = 0.01 * np.sin(2 * np.pi * 3 * TIME) * np.sin(np.pi * TIME / 3.0) ** 2
EPOCH = 10**18


def channel(name, time, values):
    return Channel(name, "m", EPOCH + np.round(1e9 * time).astype(np.int64), values)


def position(time):
    return np.interp(time - 0.012, TIME, COMMAND)


def logged(start=0.0, extra=0.0, command=True, time=None):
    """Return a recording whose clock reads `start` when the command begins, with `extra` seconds before and after."""
    time = np.arange(-extra, TIME[-1] + extra + 1e-9, INTERVAL) if time is None else time
    channels = [channel("position", start + time, position(time))]
    channels += [channel("command", start + time, np.interp(time, TIME, COMMAND))] if command else []
    return Recording("log", {c.name: c for c in channels})


@pytest.mark.parametrize(("start", "extra"), [(0.0, 0.0), (12.3456, 0.0), (5.0, 0.7)])
def test_the_logged_command_says_when_it_began(start, extra):
    found = position_on_grid(logged(start, extra), COMMAND, INTERVAL)
    assert np.abs(found - position(TIME)).max() < 2e-6


@pytest.mark.parametrize(("start", "extra"), [(3.0, 0.0), (3.0, 0.25)])
def test_without_a_command_the_position_is_laid_over_it(start, extra):
    found = position_on_grid(logged(start, extra, command=False), COMMAND, INTERVAL)
    assert np.abs(found - COMMAND)[:-20].max() < 5e-6


def test_jitter_and_a_few_lost_samples_do_not_matter():
    random = np.random.default_rng(1)
    time = TIME[random.random(len(TIME)) > 0.1] + 0.0
    found = position_on_grid(logged(1.0, time=time), COMMAND, INTERVAL)
    assert np.abs(found - position(TIME)).max() < 5e-6


@pytest.mark.parametrize(
    ("recording", "says"),
    [
        (logged(time=TIME[:1500]), r"log: positions cover .* of the command; expected 0 to 3\.00 s"),
        (logged(time=TIME[(TIME < 1.0) | (TIME > 1.06)]), "log: 6[12] ms without a position; expected at most 20 ms"),
        (Recording("log", {}), "log: no position in the recording"),
        (Recording("log", {"position": channel("position", TIME, np.full(3001, np.nan))}), "cover no samples"),
    ],
)
def test_incomplete_recordings_are_refused(recording, says):
    with pytest.raises(StrokeError, match=says):
        position_on_grid(recording, COMMAND, INTERVAL)
