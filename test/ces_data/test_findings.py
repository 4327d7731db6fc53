"""Findings of a recording: each fault is one line with its time; what is usual in sound recordings is none."""

import numpy as np
import pytest

from ces_data.findings import Finding, findings, mean_rate, missing_stretches, require_usable
from ces_data.recording import Channel, Recording
from ces_observer.errors import RecordingError

MS = 1_000_000
START = 7_000_000_000
COUNT = 10_000


def channel(name, n=COUNT, period_ms=1.0, start_ms=0.0, values=None):
    stamps = START + ((start_ms + period_ms * np.arange(n)) * MS).astype(np.int64)
    return Channel(name, "", stamps, 0.02 * np.sin(np.arange(n)) if values is None else values)


def spoilt(name, at, value):
    values = 0.02 * np.sin(np.arange(COUNT))
    values[at] = value
    return channel(name, values=values)


def stamped(name, stamps):
    return Channel(name, "", stamps, 0.02 * np.sin(np.arange(len(stamps))))


def recording(*channels, **constants):
    """A recording of position and current, of which `channels` replace some."""
    plain = {name: channel(name) for name in ("position", "current") if name not in constants}
    return Recording("run", {**plain, **{c.name: c for c in channels}}, constants, "bags/run")


@pytest.mark.parametrize(
    ("kept", "text"),
    [
        (np.arange(COUNT) % 10 == 0, ""),  # a slower sensor in the same table
        (np.arange(COUNT) // 100 != 30, "force: 100 of 10000 samples are missing, for up to 0.101 s"),
        (np.arange(COUNT) % 10 != 3, "force: 1000 of 10000 samples are missing, for up to 0.002 s"),
        (np.arange(COUNT) >= 500, "force: 500 of 10000 samples are missing, for up to 0.501 s"),
    ],
)
def test_blank_cells_of_a_table_are_counted_with_the_longest_gap(kept, text):
    texts = [f.text for f in findings(recording(channel("force").select(kept)))]
    assert [t.partition(" s;")[0] + " s" for t in texts] == [text] * bool(text)


def held_stamps(count):
    stamps = START + np.arange(COUNT) * MS
    stamps[3000 : 3000 + count] = stamps[3000]
    return stamps


def set_back():
    stamps = START + np.arange(COUNT) * MS
    stamps[4000:] -= 250 * MS
    return stamps


def current_in(*pieces, n=COUNT):
    """Position for n ms, current in the pieces (from, to) [ms]."""
    times = np.concatenate([np.arange(a, b) for a, b in pieces])
    return recording(channel("position", n), Channel("current", "A", START + times * MS, np.ones(len(times))))


def paused(*pauses, more=()):
    """Position and current at 1 kHz and 100 Hz without the pauses (from, to) [ms]; `more` of the current alone."""
    found = []
    for name, step, missing in (("position", 1, pauses), ("current", 10, (*pauses, *more))):
        times = np.arange(0, COUNT, step)
        kept = times[np.all([(times <= a) | (times >= b) for a, b in missing], 0)]
        found.append(stamped(name, START + kept * MS))
    return recording(*found)


FOUND = [
    (
        recording(channel("position", values=np.full(COUNT, 0.02)), channel("force")),
        "error",
        "position: constant at 0.02",
    ),
    (
        recording(channel("position", values=np.full(COUNT, 0.02))),
        "warning",
        "position: constant at 0.02 m; expected a",
    ),
    (recording(position=0.1), "error", "position: is a constant in the signals"),
    (recording(channel("current", 0)), "error", "current: the channel is empty; expected samples"),
    (
        recording(spoilt("current", slice(500, 600), -np.inf)),
        "warning",
        "current: 100 of 10000 samples are NaN or infinite, the first at 0.500 s; they are left out",
    ),
    (recording(spoilt("current", slice(500, 601), np.nan)), "error", "current: 101 of 10000 samples are NaN"),
    (
        recording(stamped("force", set_back())),
        "error",
        "force: time runs backwards 1 times, most at 3.999 s by 0.249000 s",
    ),
    (
        recording(stamped("position", np.repeat(START + np.arange(5000) * MS, 2)), channel("current", 5000)),
        "warning",
        "position: 50% of the samples have the same stamp as the one before",
    ),
    (
        recording(stamped("force", held_stamps(101))),
        "error",
        "force: 101 samples in a row have the same stamp, at 3.000 s",
    ),
    (
        recording(channel("current", 99, 101.0)),
        "error",
        "current at 9.901 Hz and position at 1000 Hz: rates more than 100 times apart",
    ),
    (recording(spoilt("force", 4000, -2e9)), "error", "force: -2e+09  at 4.000 s; expected at most"),
    (recording(spoilt("position", 4000, 1e20)), "error", "position: 1e+20  at 4.000 s; expected at most"),
    (current_in((0, 4000), (7000, COUNT)), "error", "absent from 3.999 s to 7.000 s, 30.0% of the time"),
    (current_in((3000, COUNT)), "error", "absent from 0.000 s to 3.000 s, 30.0% of the time"),
    (
        current_in((0, 2000), (3000, 5000), (8000, COUNT)),
        "error",
        "absent from 4.999 s to 8.000 s and 1 times more, 40.0% of the time",
    ),
    (current_in((11_000, 12_000)), "error", "absent from 0.000 s to 9.999 s, 100.0% of the time"),
    (current_in((0, 50_000), (50_600, 100_000), n=100_000), "warning", "current: absent from 49.999 s"),
    (paused((4000, 6500)), "warning", "all signals pause from 4.000 s to 6.500 s (was the recorder paused?)"),
    (paused((1000, 5000), (6000, 8000)), "warning", "from 1.000 s to 5.000 s and 1 times more"),
]


@pytest.mark.parametrize(("faulty", "severity", "text"), FOUND, ids=[text for _, _, text in FOUND])
def test_a_fault_is_one_finding(faulty, severity, text):
    (found,) = findings(faulty)
    assert found.severity == severity
    assert text in found.text and "\n" not in found.text


def test_sound_recordings_have_no_findings():
    stamps = START + np.arange(COUNT) * MS
    stamps[1::10] = stamps[::10]
    for sound in (
        recording(channel("current", 500, 20.0), channel("force")),
        recording(current=0.0),
        recording(channel("current", 101, 99.0)),
        recording(channel("temperature", 10, 1000.0)),
        recording(stamped("position", stamps)),  # a few equal stamps
        recording(stamped("force", held_stamps(100))),
        recording(spoilt("position", slice(0, COUNT, 200), 900.0)),  # wild, but possible
        current_in((800, 9500)),
    ):
        assert require_usable(sound) == ()
    assert missing_stretches(np.arange(0, 10**11, 10**7), np.arange(0, 10**11, 10**9)) == []
    assert (mean_rate(channel("force", 1001, 2.0)), mean_rate(channel("force", 1))) == (500.0, 0.0)


def test_errors_come_first_name_the_recording_and_know_their_signal():
    both = recording(spoilt("position", 7, np.nan), channel("current", 0))
    assert [(f.severity, f.signal) for f in findings(both)] == [("error", "current"), ("warning", "position")]
    assert findings(both)[0] == Finding("error", "current: the channel is empty; expected samples", signal="current")
    with pytest.raises(RecordingError, match=r"bags/run: current: the channel is empty"):
        require_usable(both)
    error, pause = findings(paused((4000, 6500), more=[(8000, 9000)]))
    assert "current: absent from 8.000 s to 9.000 s, 10.0% of the time" in error.text  # without the pause of all
    assert "all signals pause" in pause.text
