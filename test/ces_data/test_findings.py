import numpy as np
import pytest

from ces_data.findings import Finding, findings, mean_rate, missing_stretches, require_usable
from ces_data.recording import Channel, Recording
from ces_observer.errors import RecordingError

MS = 1_000_000
START = 7_000_000_000


def channel(name, n=10_000, period_ms=1.0, start_ms=0.0, values=None):
    stamps = START + ((start_ms + period_ms * np.arange(n)) * MS).astype(np.int64)
    return Channel(name, "", stamps, 0.02 * np.sin(np.arange(n)) if values is None else values)


def recording(*channels, **constants):
    return Recording("run", {c.name: c for c in channels}, constants, "bags/run")


def with_values(n, at, value):
    values = 0.02 * np.sin(np.arange(n))
    values[at] = value
    return values


def only(rec):
    result = findings(rec)
    assert len(result) == 1
    return result[0]


def test_sound_recording_has_no_findings():
    sound = recording(channel("position"), channel("current", 500, 20.0), channel("force"))
    assert findings(sound) == ()
    assert require_usable(sound) == ()
    assert findings(recording(channel("position"), current=0.0)) == ()


def test_constant_position():
    result = only(recording(channel("position", values=np.full(10_000, 0.02)), channel("current")))
    assert result == Finding(
        "error", "position: constant at 0.02 m; expected a stroke (is it the right field?)", signal="position"
    )


def test_position_given_as_a_constant():
    assert "position: is a constant in the signals" in only(recording(channel("current"), position=0.1)).text


def test_empty_channel():
    result = only(recording(channel("position"), channel("current", 0)))
    assert result == Finding("error", "current: the channel is empty; expected samples", signal="current")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_few_bad_samples_are_a_warning_many_an_error(bad):
    few = recording(channel("position"), channel("current", values=with_values(10_000, slice(500, 600), bad)))
    assert only(few) == Finding(
        "warning",
        "current: 100 of 10000 samples are NaN or infinite, the first at 0.500 s; they are left out",
        signal="current",
    )
    assert require_usable(few) == findings(few)
    many = recording(channel("position"), channel("current", values=with_values(10_000, slice(500, 601), bad)))
    with pytest.raises(RecordingError, match=r"bags/run: current: 101 of 10000 .* at 0\.500 s; expected at most 1%"):
        require_usable(many)


def test_time_running_backwards_says_where():
    stamps = START + np.arange(10_000) * MS
    stamps[4000:] -= 250 * MS
    back = Channel("force", "N", stamps, np.zeros(10_000))
    result = only(recording(channel("position"), channel("current"), back))
    assert result.severity == "error"
    assert result.text.startswith("force: time runs backwards 1 times, most at 3.999 s by 0.249000 s")


def test_repeated_stamps_are_no_backward_time():
    stamps = np.repeat(START + np.arange(5000) * MS, 2)
    found = findings(recording(Channel("position", "m", stamps, 0.02 * np.sin(stamps)), channel("current", 5000)))
    assert [(finding.severity, finding.signal) for finding in found] == [("warning", "position")]
    assert "position: 50% of the samples have the same stamp as the one before" in found[0].text


def test_a_few_repeated_stamps_are_not_reported():
    stamps = START + np.arange(10_000) * MS
    stamps[1::10] = stamps[::10]
    assert (
        findings(recording(Channel("position", "m", stamps, 0.02 * np.sin(stamps)), channel("current", 10_000))) == ()
    )


@pytest.mark.parametrize(("period_ms", "wrong"), [(99.0, False), (101.0, True)])
def test_rates_a_hundred_times_apart(period_ms, wrong):
    n = int(10_000 / period_ms)
    result = findings(recording(channel("position"), channel("current", n, period_ms)))
    assert [f.severity for f in result] == ["error"] * wrong
    if wrong:
        assert result[0].text == "current at 9.901 Hz and position at 1000 Hz: rates more than 100 times apart"


def test_temperature_may_be_slow():
    assert findings(recording(channel("position"), channel("current"), channel("temperature", 10, 1000.0))) == ()


def missing(*pieces, n=10_000):
    """Position for n ms, current in the pieces (from, to) [ms]."""
    times = np.concatenate([np.arange(a, b) for a, b in pieces])
    current = Channel("current", "A", START + times * MS, np.ones(len(times)))
    return findings(recording(channel("position", n), current))


@pytest.mark.parametrize(
    ("pieces", "phrase"),
    [
        ([(0, 4000), (7000, 10_000)], "absent from 3.999 s to 7.000 s, 30.0% of the time"),
        ([(0, 5000)], "absent from 4.999 s to 9.999 s, 50.0% of the time"),
        ([(3000, 10_000)], "absent from 0.000 s to 3.000 s, 30.0% of the time"),
        (
            [(0, 2000), (3000, 5000), (8000, 10_000)],
            "absent from 4.999 s to 8.000 s and 1 times more, 40.0% of the time",
        ),
        ([(11_000, 12_000)], "absent from 0.000 s to 9.999 s, 100.0% of the time"),
    ],
)
def test_current_absent_for_part_of_the_time(pieces, phrase):
    (result,) = missing(*pieces)
    assert result.severity == "error"
    assert phrase in result.text


def test_short_absence_is_a_warning_and_late_start_is_none():
    assert [f.severity for f in missing((0, 50_000), (50_600, 100_000), n=100_000)] == ["warning"]
    assert missing((800, 9500)) == ()


def paused(*pauses, more=()):
    """Position and current at 1 kHz and 100 Hz without the pauses (from, to) [ms]."""
    keep = {}
    for name, step in (("position", 1), ("current", 10)):
        times = np.arange(0, 10_000, step)
        kept = np.all(
            [(times <= a) | (times >= b) for a, b in [*pauses, *more] if name == "current" or (a, b) in pauses], 0
        )
        keep[name] = Channel(name, "", START + times[kept] * MS, 0.02 * np.sin(times[kept]))
    return recording(*keep.values())


def test_a_pause_of_all_signals_is_named_once():
    finding = only(paused((4000, 6500)))
    assert finding.severity == "warning"
    assert "all signals pause from 4.000 s to 6.500 s (was the recorder paused?)" in finding.text
    assert "from 1.000 s to 5.000 s and 1 times more" in only(paused((1000, 5000), (6000, 8000))).text


def test_a_current_that_is_absent_besides_is_named_without_the_pause():
    error, pause = findings(paused((4000, 6500), more=[(8000, 9000)]))
    assert "current: absent from 8.000 s to 9.000 s, 10.0% of the time" in error.text
    assert "all signals pause" in pause.text


def test_slow_current_is_not_taken_for_absent():
    assert missing_stretches(np.arange(0, 10**11, 10**7), np.arange(0, 10**11, 10**9)) == []


def test_errors_come_before_warnings():
    position = channel("position", values=with_values(10_000, 7, np.nan))
    result = findings(recording(position, channel("current", 0)))
    assert [f.severity for f in result] == ["error", "warning"]


def test_rate():
    assert mean_rate(channel("force", 1001, 2.0)) == 500.0
    assert mean_rate(channel("force", 1)) == 0.0


@pytest.mark.parametrize(("name", "value"), [("force", 1e33), ("force", -2e9), ("position", 1e20), ("current", 1e7)])
def test_a_value_beyond_every_unit_is_an_error(name, value):
    channels = {n: channel(n) for n in ("position", "current", "force")}
    channels[name] = channel(name, values=with_values(10_000, 4000, value))
    (result,) = findings(recording(*channels.values()))
    assert result.severity == "error"
    assert result.text.startswith(f"{name}: {value:.4g}  at 4.000 s; expected at most")


def test_a_wild_sample_that_can_be_is_no_error():
    wild = channel("position", values=with_values(10_000, slice(0, 10_000, 200), 900.0))
    assert findings(recording(wild, channel("current", values=with_values(10_000, slice(0, 10_000, 200), 900.0)))) == ()


@pytest.mark.parametrize(("equal", "wrong"), [(12_000, True), (101, True), (100, False)])
def test_many_equal_stamps_in_a_row_are_an_error(equal, wrong):
    stamps = START + np.arange(20_000) * MS
    stamps[3000 : 3000 + equal] = stamps[3000]
    stuck = Channel("force", "N", stamps, np.sin(np.arange(20_000)))
    result = findings(recording(channel("position", 20_000), channel("current", 20_000), stuck))
    assert [f.severity for f in result] == ["error"] * wrong
    if wrong:
        assert f"force: {equal} samples in a row have the same stamp, at 3.000 s" in result[0].text
