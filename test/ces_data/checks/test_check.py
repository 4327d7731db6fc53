"""Faults put into sound recordings are named with their remedy; sound recordings, also of other dampers, are not."""

import os
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ces_data.bags.reader import read_recording
from ces_data.checks.check import check_each, check_recording, check_together, require_sound
from ces_data.checks.delays import DelayEstimate, current_delay, delay_findings, find_clock_drift, force_delay
from ces_data.checks.motion import recorded_motion
from ces_data.checks.sensors import find_saturations
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Channel, Recording
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
    stamps = np.rint(time * 1e9).astype(np.int64)
    columns = {"position": ("m", x), "current": ("A", np.zeros(len(time))), "force": ("N", force)}
    return Recording(f"sine_{hertz:g}", {n: Channel(n, u, stamps, c) for n, (u, c) in columns.items()})


def scaled(factor):
    return lambda values: factor * values


@pytest.mark.parametrize("name", BAGS)
def test_the_sample_recordings_make_sense(name):
    assert check_recording(bag(name)) == ()


def test_they_make_sense_together():
    assert check_together([bag(name) for name in BAGS]) == ()


@measured
def test_measured_recordings_make_sense():
    logs = (("brfd_backlash", "*.json"), ("dyke_mr", "*.csv"), ("utfsm_mr", "*.csv"))
    found = {}
    for folder, pattern in logs:
        mapping = load_dyno_mapping(ROOT / "config" / "import" / f"{folder}.yaml")
        recordings = [import_log(path, mapping) for path in sorted((DATA / folder).glob(pattern))]
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
        ({"position": scaled(1e3)}, "wrong model", "by 0.001 if it is in mm"),
        ({"position": scaled(1 / 0.0254)}, "wrong model", "by 0.0254 if it is in inches"),
        ({"current": scaled(1e3)}, "wrong model", "by 0.001 if it is in mA"),
        ({"current": scaled(100.0)}, "warning", "percent or raw counts"),
        ({"force": lambda f: np.clip(f, -1200.0, 600.0)}, "wrong model", "force: the channel saturates"),
        ({"force": lambda f: np.clip(f, -3000.0, 1250.0)}, "warning", "record with a larger range"),
        ({"force": lambda f: 0.0 * f + 3.0}, "wrong model", "force: constant at 3 N"),
        ({"force": held(0.4, 0.5)}, "wrong model", "force: stuck once, at 10.00 s, 10.0% of the time"),
        ({"position": held(0.4, 0.41)}, "warning", "position: stuck once"),
        ({"force": lambda f: f[np.arange(len(f)) // 10 * 10]}, "warning", "measured at 100 Hz"),
        (
            {"position": lambda x: 0.002 * np.round(x / 0.002)},
            "warning",
            "position: its steps of 2 mm disturb the speed",
        ),
        ({"position": lambda x: np.clip(x, -0.01, 0.01)}, "wrong model", "position: the channel saturates"),
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


def test_a_small_damper_is_doubted_but_not_refused():
    """A damper of a bicycle with 20 N at most could be one of 20 kN."""
    (found,) = check_recording(changed(bag("noise"), force=scaled(20.0 / 3525.0), current=scaled(1.0)))
    assert found.severity == "warning"
    assert "if it is in kN, multiply its scale in the signals file by 1000" in found.text


def test_both_signs_turned_and_pounds_alone_cannot_be_known():
    assert check_recording(changed(bag("noise"), force=scaled(-1.0), position=scaled(-1.0))) == ()
    assert check_recording(changed(bag("noise"), force=scaled(1 / 4.4482216))) == ()


@pytest.mark.parametrize(("factor", "unit"), [(4.4482216, "lbf"), (9.80665, "kgf")])
def test_another_unit_in_one_of_two_recordings_is_found(factor, unit):
    pounds = replace(changed(bag("sweep"), force=scaled(1.0 / factor)), name="odd")
    for together in ([bag("noise"), pounds], [pounds, bag("noise")]):
        (found,) = check_together(together)
        assert found.severity == "wrong model"
        assert f"if odd is in {unit}, multiply its scale in the signals file by {factor:.6g}" in found.text


def test_a_sign_turned_in_one_of_two_recordings_is_named_once():
    found = check_together([bag("noise"), changed(bag("sweep"), force=scaled(-1.0))])
    assert [(f.severity, f.text[:15]) for f in found] == [("wrong model", "sweep: force: a")]


@pytest.mark.parametrize("name", ["run: 1", "force: b", "current"])
def test_findings_know_their_recording_and_signal_whatever_its_name_says(name):
    odd = replace(changed(bag("sweep"), force=scaled(-1.0)), name=name)
    (found,) = check_together([bag("noise"), odd])
    assert (found.recording, found.signal) == (name, "force")
    assert found.text.startswith(f"{name}: force: acts with the motion")


@pytest.mark.parametrize("seconds", [-0.05, -0.02, 0.02, 0.05])
@pytest.mark.parametrize("name", ["noise", "road", "sweep"])
def test_a_delay_is_estimated_with_an_interval_that_holds_it(name, seconds):
    delay = force_delay(recorded_motion(shifted(bag(name), "force", seconds)))
    assert delay.certain
    assert delay.low_s <= seconds <= delay.high_s
    assert delay.late_s == pytest.approx(seconds, abs=0.004)


def test_a_delay_between_ticks_is_estimated():
    late = [force_delay(recorded_motion(shifted(bag("noise"), "force", s))).late_s for s in (0.0200, 0.0210)]
    assert late[1] - late[0] == pytest.approx(0.001, abs=0.0003)


@pytest.mark.parametrize(
    ("signal", "seconds", "late"),
    [("force", 0.02, "force"), ("force", -0.02, "position"), ("position", 0.02, "position")],
)
def test_the_late_signal_is_named_with_the_key_to_write(signal, seconds, late):
    (found,) = (f for f in check_recording(shifted(bag("noise"), signal, seconds)) if "logged" in f.text)
    assert found.severity == "wrong model"
    assert found.text.startswith(f"{late}: logged ")
    assert found.text.endswith(f" to the key delay (default 0) of {late} in the signals file")


def test_a_single_sine_says_nothing_about_a_delay():
    """Elasticity, valve lag and a delay look alike there."""
    assert check_recording(shifted(bag("sine_4hz"), "force", 0.02)) == ()


@pytest.mark.parametrize(
    ("late_s", "low_s", "high_s", "least", "likely"),
    [
        (0.019, -0.003, 0.029, 0.10, True),
        (-0.019, -0.029, 0.003, 0.10, True),
        (0.010, -0.003, 0.029, 0.10, False),  # the lag of a damper
        (0.019, -0.070, 0.070, 0.10, False),  # a single sine
        (0.019, -0.003, 0.029, 0.18, False),  # hardly better than none
    ],
)
def test_a_delay_that_fits_better_than_none_is_likely(late_s, low_s, high_s, least, likely):
    assert DelayEstimate(late_s, low_s, high_s, 0.2, least).likely == likely


def test_sines_of_several_frequencies_show_a_delay_together():
    sines = [sine(1.0), sine(5.0), sine(12.0)]
    assert check_each(sines) == ()
    (found,) = check_each([shifted(one, "force", 0.02) for one in sines])
    assert found.severity == "wrong model"
    assert found.text.startswith("3 recordings together: force: logged ")


@pytest.mark.parametrize(("late_s", "signal"), [(0.12, "force"), (0.3, "force"), (-0.2, "position")])
@pytest.mark.parametrize("name", ["noise", "sweep", "road"])
def test_loggers_that_started_apart_are_estimated(name, late_s, signal):
    """Larger delays than the usual: the interval holds the true one, no sign and no current is blamed."""
    late = shifted(bag(name), "force", late_s)
    (found,) = check_recording(late)
    assert found.text.startswith(f"{signal}: logged ") and found.severity == "wrong model"
    delay = force_delay(recorded_motion(late))
    assert delay.low_s < late_s < delay.high_s
    assert abs(delay.late_s - late_s) < 0.01


def test_a_delay_beyond_what_is_tried_has_no_figure():
    estimate = DelayEstimate(0.07, 0.04, 0.07, 0.3, 0.1)
    assert estimate.beyond and estimate.open_ended
    (found,) = delay_findings(recorded_motion(bag("noise")), estimate)
    assert found.text.startswith("force: logged at least 40 ms after the position, too much to estimate;")


@pytest.mark.parametrize(("name", "ppm"), [("road", 1500.0), ("road", -2000.0), ("noise", 1500.0)])
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
    for name in BAGS:
        assert find_clock_drift(shifted(bag(name), "force", 0.03)) is None


@pytest.mark.parametrize("signal", ["position", "force"])
def test_a_channel_that_is_held_has_no_delay_of_its_own(signal):
    """Repeated samples come late by half of their time: the sensor's rate is the remedy, not a delay."""
    held_at_50Hz = changed(bag("noise"), **{signal: lambda v: v[np.arange(len(v)) // 20 * 20]})
    found = [f.text for f in check_recording(held_at_50Hz)]
    assert any(f"{signal}: stamped at 1000 Hz" in text for text in found)
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


@pytest.mark.parametrize(("name", "step", "severity"), [("noise", 20, "wrong model"), ("noise", 10, "warning")])
def test_a_rate_too_low_for_the_force_is_named(name, step, severity):
    (found,) = (f for f in check_recording(thinned(bag(name), step)) if "Hz" in f.text)
    assert found.severity == severity
    assert found.text.startswith(f"force: changes too fast for {1000 // step} Hz: half of its samples")


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
    stamps = np.rint(time * 1e9).astype(np.int64)
    parked = Recording("parked", {"position": Channel("position", "m", stamps, smooth)}, {"current": 0.0})
    assert (smooth == smooth.max()).mean() > 0.1
    assert find_saturations(parked, "position") == ()
    clipped = changed(parked, position=lambda x: np.minimum(x, 0.5 * x.max()))
    assert len(find_saturations(clipped, "position")) == 1


def test_one_current_in_all_recordings_is_a_warning_a_passive_damper_is_none():
    fixed = [changed(bag(name), current=lambda c: np.full(len(c), 0.5)) for name in ("noise", "sweep")]
    (found,) = check_together(fixed)
    assert (found.severity, found.text[:36]) == ("warning", "current: 0.5 A in all recordings; a ")
    passive = [changed(r, current=scaled(0.0)) for r in fixed]
    assert check_together(passive) == ()
    assert check_together([fixed[0], changed(fixed[1], current=scaled(0.5))]) == ()


def test_gaps_spikes_and_samples_that_are_not_finite_raise_no_alarm():
    def spoil(values):
        spoilt = values.copy()
        spoilt[::997] = np.nan
        return spoilt

    holes = changed(bag("noise"), force=spoil, position=spoil)
    channels = {
        n: c.select((np.arange(len(c)) / len(c) < 0.3) | (np.arange(len(c)) / len(c) > 0.4))
        for n, c in holes.channels.items()
    }
    assert check_recording(replace(holes, channels=channels)) == ()


@pytest.mark.parametrize("count", [0, 1, 5, 30, 500])
def test_short_recordings_are_no_problem(count):
    short = {n: c.select(np.arange(len(c)) < count) for n, c in bag("noise").channels.items()}
    assert check_recording(replace(bag("noise"), channels=short)) == ()


def test_a_recording_without_force_or_current_is_checked_as_far_as_it_goes():
    channels = {n: c for n, c in bag("noise").channels.items() if n == "position"}
    assert check_recording(Recording("bare", channels, {"current": 0.0})) == ()
    in_mm = {"position": Channel("position", "m", channels["position"].stamps_ns, 1e3 * channels["position"].values)}
    assert [f.severity for f in check_recording(Recording("bare", in_mm, {"current": 0.0}))] == ["wrong model"]


def test_wrong_models_are_refused_unless_one_goes_on():
    found = check_together([changed(bag("noise"), force=scaled(-1.0), current=scaled(1e3))])
    with pytest.raises(
        RecordingError, match=r"noise: .*\(and 1 more findings like this\).*--ignore-findings identifies all the same"
    ):
        require_sound(found)
    assert len(require_sound(found, ignore_findings=True)) == 2
    assert require_sound(()) == ()
