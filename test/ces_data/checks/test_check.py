"""Faults put into sound recordings are named with their remedy; sound recordings, also of other dampers, are not."""

import os
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from made_recordings import recording_of

from ces_data.bags.reader import read_recording
from ces_data.checks.check import check_each, check_recording, check_together, require_sound
from ces_data.checks.delays import DelayEstimate, current_delay, delay_findings, find_clock_drift, force_delay
from ces_data.checks.motion import recorded_motion
from ces_data.checks.sensors import find_saturations
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_observer.errors import RecordingError

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
BAGS = ("noise", "road", "sine_4hz", "sweep")


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


def scaled(factor):
    return lambda values: factor * values


@pytest.mark.slow
def test_the_sample_recordings_make_sense():
    assert check_together([bag(name) for name in BAGS]) == ()


@measured
@pytest.mark.slow
def test_measured_recordings_make_sense():
    logs = (("brfd_backlash", "*.json"), ("dyke_mr", "*.csv"), ("utfsm_mr", "*.csv"))
    found = {}
    for folder, pattern in logs:
        mapping = load_dyno_mapping(ROOT / "config" / "import" / f"{folder}.yaml")
        recordings = [import_log(path, mapping) for path in sorted((DATA / folder).glob(pattern))[::3]]
        found |= {r.name: check_recording(r) for r in recordings}
        assert [f for f in check_together(recordings) if f.severity != "warning"] == []
    assert {name: texts for name, texts in found.items() if texts} == {}


@pytest.mark.parametrize(
    ("change", "severity", "text"),
    [
        ({"force": scaled(-1.0)}, "wrong model", "force: acts with the motion instead of against it"),
        ({"position": scaled(-1.0)}, "wrong model", "multiply the scale of the one that is not by -1"),
        ({"force": scaled(1e-3)}, "wrong model", "by 1000 if it is in kN"),
        ({"force": scaled(1e3)}, "wrong model", "in mN"),
        ({"force": scaled(20.0 / 3525.0)}, "warning", "if it is in kN, multiply its scale"),  # or a bicycle's
        ({"position": scaled(1e3)}, "wrong model", "by 0.001 if it is in mm"),
        ({"current": scaled(1e3)}, "wrong model", "by 0.001 if it is in mA"),
        ({"current": scaled(100.0)}, "warning", "percent or raw counts"),
        ({"force": lambda f: np.clip(f, -1200.0, 600.0)}, "wrong model", "force: the channel saturates"),
        ({"force": lambda f: np.clip(f, -3000.0, 1250.0)}, "warning", "record with a larger range"),
        ({"force": lambda f: 0.0 * f + 3.0}, "wrong model", "force: constant at 3 N"),
        ({"force": held(0.4, 0.5)}, "wrong model", "force: stuck once, at 10.00 s, 10.0% of the time"),
        ({"force": lambda f: f[np.arange(len(f)) // 10 * 10]}, "warning", "measured at 100 Hz"),
        ({"position": lambda x: 0.002 * np.round(x / 0.002)}, "warning", "its steps of 2 mm disturb the speed"),
        ({"current": held(0.4, 0.5)}, "wrong model", "current: stuck at 0.57 A for 2.5 s, 10% of the time"),
        ({"position": lambda x: held(0.4, 0.5)(1e-5 * np.round(1e5 * x))}, "wrong model", "position: stuck once"),
        ({"force": lambda f: 200.0 * np.round(f / 200.0)}, "warning", "force: only"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_fault_is_one_line_with_its_remedy(change, severity, text):
    found = check_recording(changed(bag("noise"), **change))
    assert any(f.severity == severity and text in f.text for f in found), found
    assert not any("\n" in f.text for f in found)
    assert {f.text.partition(":")[0] for f in found} <= {*change, "force"}


def test_both_signs_turned_and_pounds_alone_cannot_be_known():
    assert check_recording(changed(bag("noise"), force=scaled(-1.0), position=scaled(-1.0))) == ()
    assert check_recording(changed(bag("noise"), force=scaled(1 / 4.4482216))) == ()


def test_another_unit_in_one_of_two_recordings_is_found():
    pounds = replace(changed(bag("sweep"), force=scaled(1.0 / 4.4482216)), name="odd")
    (found,) = check_together([bag("noise"), pounds])
    assert found.severity == "wrong model"
    assert "if odd is in lbf, multiply its scale in the signals file by 4.44822" in found.text


def test_findings_know_their_recording_and_signal_whatever_its_name_says():
    for name in ("run: 1", "force: b"):
        odd = replace(changed(bag("sine_4hz"), force=scaled(-1.0)), name=name)
        (found,) = check_together([bag("noise"), odd])
        assert (found.recording, found.signal, found.severity) == (name, "force", "wrong model")
        assert found.text.startswith(f"{name}: force: acts with the motion")


@pytest.mark.parametrize(
    ("name", "moved", "late_s", "late"),
    [
        ("noise", "force", -0.05, "position"),
        ("noise", "position", 0.02, "position"),
        ("sweep", "force", 0.12, "force"),
        ("road", "force", -0.2, "position"),
    ],
)
@pytest.mark.slow
def test_a_delay_is_estimated_and_its_signal_named_with_the_key_to_write(name, moved, late_s, late):
    recording = shifted(bag(name), moved, late_s)
    (found,) = check_recording(recording)  # no sign and no current is blamed
    assert found.severity == "wrong model" and found.text.startswith(f"{late}: logged ")
    assert found.text.endswith(f" to the key delay (default 0) of {late} in the signals file")
    delay, seconds = force_delay(recorded_motion(recording)), late_s if moved == "force" else -late_s
    assert delay.certain and delay.low_s <= seconds <= delay.high_s
    assert delay.late_s == pytest.approx(seconds, abs=0.01)


def test_a_single_sine_says_nothing_about_a_delay():
    """Elasticity, valve lag and a delay look alike there."""
    assert check_recording(shifted(bag("sine_4hz"), "force", 0.02)) == ()


def test_a_delay_that_fits_better_than_none_is_likely():
    for late_s, low_s, high_s, least, likely in (
        (-0.019, -0.029, 0.003, 0.10, True),
        (0.010, -0.003, 0.029, 0.10, False),  # the lag of a damper
        (0.019, -0.070, 0.070, 0.10, False),  # a single sine
        (0.019, -0.003, 0.029, 0.18, False),  # hardly better than none
    ):
        assert DelayEstimate(late_s, low_s, high_s, 0.2, least).likely == likely


@pytest.mark.slow
def test_sines_of_several_frequencies_show_a_delay_together():
    sines = [sine(1.0), sine(5.0), sine(12.0)]
    assert check_each(sines) == ()
    (found,) = check_each([shifted(one, "force", 0.02) for one in sines])
    assert found.severity == "wrong model"
    assert found.text.startswith("3 recordings together: force: logged ")


def test_a_delay_beyond_what_is_tried_has_no_figure():
    estimate = DelayEstimate(0.07, 0.04, 0.07, 0.3, 0.1)
    assert estimate.beyond and estimate.open_ended
    (found,) = delay_findings(recorded_motion(bag("noise")), estimate)
    assert found.text.startswith("force: logged at least 40 ms after the position, too much to estimate;")


@pytest.mark.parametrize(("name", "ppm"), [("road", -2000.0), ("noise", 1500.0)])
def test_clocks_that_drift_apart_are_no_delay(name, ppm):
    """A constant delay would correct the middle of the recording only."""
    recording = bag(name)
    force = recording.channels["force"]
    since = force.stamps_ns - force.stamps_ns[0]
    stamps = force.stamps_ns[0] + np.rint(since * (1.0 + 1e-6 * ppm)).astype(np.int64)
    drifted = replace(recording, channels={**recording.channels, "force": replace(force, stamps_ns=stamps)})
    found = find_clock_drift(drifted)
    assert found.severity == "wrong model" and "their clocks drift apart" in found.text


def test_a_constant_delay_is_no_drift():
    assert find_clock_drift(shifted(bag("noise"), "force", 0.03)) is None


def test_a_channel_that_is_held_has_no_delay_of_its_own():
    """Repeated samples come late by half of their time: the sensor's rate is the remedy, not a delay."""
    held_at_50Hz = changed(bag("noise"), position=lambda v: v[np.arange(len(v)) // 20 * 20])
    found = [f.text for f in check_recording(held_at_50Hz)]
    assert any("position: stamped at 1000 Hz" in text for text in found)
    assert not any("logged" in text for text in found)


def test_interchanged_signals_are_one_finding_units_another():
    recording = bag("noise")
    position, force = (recording.channels[name] for name in ("position", "force"))
    swapped = {"position": replace(force, name="position"), "force": replace(position, name="force")}
    (found,) = check_recording(replace(recording, channels={**recording.channels, **swapped}))
    assert "position and force are interchanged" in found.text
    in_mm_and_kN = check_recording(changed(recording, position=scaled(1e3), force=scaled(1e-3)))
    assert not any("interchanged" in f.text for f in in_mm_and_kN)
    assert {f.signal for f in in_mm_and_kN} == {"position", "force"}


def test_a_clipped_force_is_not_stuck_too():
    found = check_recording(changed(bag("sine_4hz"), force=lambda f: np.clip(f, 0.4 * f.min(), 0.4 * f.max())))
    assert [f.text.split(";")[0].split(":")[1] for f in found if f.signal == "force"] == [" the channel saturates"]


def test_a_current_that_comes_after_its_force_is_late():
    late = shifted(bag("noise"), "current", 0.06)
    assert current_delay(recorded_motion(late)).certain
    (found,) = check_recording(late)
    assert found.text.startswith("current: logged ")
    assert "after the force; add 0.0" in found.text


@pytest.mark.parametrize(("step", "severity"), [(20, "wrong model"), (10, "warning")])
def test_a_rate_too_low_for_the_force_is_named(step, severity):
    (found,) = (f for f in check_recording(thinned(bag("noise"), step)) if "Hz" in f.text)
    assert found.severity == severity
    assert found.text.startswith(f"force: changes too fast for {1000 // step} Hz: half of its samples")


@pytest.mark.slow
def test_a_slow_sine_needs_no_high_rate_unless_the_valve_moves():
    slow = changed(sine(0.5), current=lambda i: np.full(len(i), 0.5))
    assert check_recording(thinned(slow, 20)) == ()
    moved = changed(sine(0.5), current=lambda i: 0.5 + 0.3 * np.sin(np.arange(len(i)) * 1e-3))
    assert [f.text[:51] for f in check_recording(thinned(moved, 20)) if "rate" not in f.text] == [
        "force: 50 Hz is too low for the response of a valve"
    ]


def test_a_commanded_current_that_freezes_is_found_by_the_force():
    """Without noise, only the force shows that the valve moved; currents held on purpose are sound."""
    commanded = changed(bag("noise"), current=lambda i: np.round(i, 1))
    assert [f for f in check_recording(commanded) if f.text.startswith("current")] == []
    (found,) = (f for f in check_recording(changed(commanded, current=held(0.5, 1.0))) if f.text.startswith("current"))
    assert found.severity == "wrong model"
    assert "while the force changes as if it moved" in found.text


def test_a_piston_that_comes_to_rest_at_its_end_is_not_clipped():
    time = np.arange(16000) * 1e-3
    resting = np.round(0.02 * np.clip(1.1 * np.sin(time) - 0.05 * np.sin(3.0 * time), -2.0, 2.0), 5)
    stop = np.where(time > 12.0, resting.max(), np.minimum(resting, resting.max()))
    smooth = np.round(np.convolve(np.pad(stop, 400, mode="edge"), np.hanning(801) / np.hanning(801).sum(), "valid"), 5)
    parked = recording_of(time, position=smooth)
    assert (smooth == smooth.max()).mean() > 0.1
    assert find_saturations(parked, "position") == ()
    clipped = changed(parked, position=lambda x: np.minimum(x, 0.5 * x.max()))
    assert len(find_saturations(clipped, "position")) == 1


@pytest.mark.slow
def test_one_current_in_all_recordings_is_a_warning_a_passive_damper_is_none():
    fixed = [changed(bag(name), current=lambda c: np.full(len(c), 0.5)) for name in ("noise", "sweep")]
    (found,) = check_together(fixed)
    assert (found.severity, found.text[:36]) == ("warning", "current: 0.5 A in all recordings; a ")
    passive = [changed(r, current=scaled(0.0)) for r in fixed]
    assert check_together(passive) == ()
    assert check_together([fixed[0], changed(fixed[1], current=scaled(0.5))]) == ()


def test_gaps_and_samples_that_are_not_finite_raise_no_alarm():
    def spoil(values):
        return np.where(np.arange(len(values)) % 997 == 0, np.nan, values)

    holes = changed(bag("noise"), force=spoil, position=spoil).channels
    shares = {n: np.arange(len(c)) / len(c) for n, c in holes.items()}
    channels = {n: c.select((shares[n] < 0.3) | (shares[n] > 0.4)) for n, c in holes.items()}
    assert check_recording(replace(bag("noise"), channels=channels)) == ()


def test_short_recordings_are_no_problem():
    for count in (0, 1, 5, 30, 500):
        short = {n: c.select(np.arange(len(c)) < count) for n, c in bag("noise").channels.items()}
        assert check_recording(replace(bag("noise"), channels=short)) == ()


def test_a_recording_without_force_or_current_is_checked_as_far_as_it_goes():
    bare = Recording("bare", {"position": bag("noise").channels["position"]}, {"current": 0.0})
    assert check_recording(bare) == ()
    assert [f.severity for f in check_recording(changed(bare, position=scaled(1e3)))] == ["wrong model"]


def test_wrong_models_are_refused_unless_one_goes_on():
    found = check_together([changed(bag("noise"), force=scaled(-1.0), current=scaled(1e3))])
    with pytest.raises(
        RecordingError, match=r"noise: .*\(and 1 more findings like this\).*--ignore-findings identifies all the same"
    ):
        require_sound(found)
    assert len(require_sound(found, ignore_findings=True)) == 2
    assert require_sound(()) == ()
