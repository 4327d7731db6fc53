"""Faults put into sound recordings are named with their remedy; sound recordings, also of other dampers, are not."""

import os
import warnings
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.log_import import import_log
from ces_identify.recordings.log_mapping import load_dyno_mapping
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.sense.delays import current_delay, force_delay
from ces_identify.sense.motion import recorded_motion
from ces_identify.sense.sense import require_sensible, sense, sense_together
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


def scaled(factor):
    return lambda values: factor * values


@pytest.mark.parametrize("name", BAGS)
def test_the_sample_recordings_make_sense(name):
    assert sense(bag(name)) == ()


def test_they_make_sense_together():
    assert sense_together([bag(name) for name in BAGS]) == ()


@measured
def test_measured_recordings_make_sense():
    logs = (("brfd_backlash", "*.json"), ("dyke_mr", "*.csv"), ("utfsm_mr", "*.csv"))
    found = {}
    for folder, pattern in logs:
        mapping = load_dyno_mapping(ROOT / "config" / "import" / f"{folder}.yaml")
        recordings = [import_log(path, mapping) for path in sorted((DATA / folder).glob(pattern))]
        found |= {r.name: sense(r) for r in recordings}
        assert [f for f in sense_together(recordings) if f.severity != "warning"] == []
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
        ({"force": held(0.4, 0.5)}, "wrong model", "force: stuck 1 times, first at 10.00 s, 10.0% of the time"),
        ({"position": held(0.4, 0.41)}, "warning", "position: stuck 1 times"),
        ({"force": lambda f: f[np.arange(len(f)) // 10 * 10]}, "warning", "measured at 100 Hz"),
        ({"position": lambda x: 0.002 * np.round(x / 0.002)}, "warning", "position: only"),
        ({"force": lambda f: 200.0 * np.round(f / 200.0)}, "warning", "force: only"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_fault_is_one_line_with_its_remedy(change, severity, text):
    found = sense(changed(bag("noise"), **change))
    assert any(f.severity == severity and text in f.text for f in found), found
    assert not any("\n" in f.text for f in found)
    assert {f.text.partition(":")[0] for f in found} <= {*change, "force"}


def test_a_small_damper_is_doubted_but_not_refused():
    """A damper of a bicycle with 20 N at most could be one of 20 kN."""
    (found,) = sense(changed(bag("noise"), force=scaled(20.0 / 3525.0), current=scaled(1.0)))
    assert found.severity == "warning"
    assert "if it is in kN, multiply its scale in the signals file by 1000" in found.text


def test_both_signs_turned_and_pounds_alone_cannot_be_known():
    assert sense(changed(bag("noise"), force=scaled(-1.0), position=scaled(-1.0))) == ()
    assert sense(changed(bag("noise"), force=scaled(1 / 4.4482216))) == ()


@pytest.mark.parametrize(("factor", "unit"), [(4.4482216, "lbf"), (9.80665, "kgf")])
def test_another_unit_in_one_of_two_recordings_is_found(factor, unit):
    pounds = replace(changed(bag("sweep"), force=scaled(1.0 / factor)), name="odd")
    for together in ([bag("noise"), pounds], [pounds, bag("noise")]):
        (found,) = sense_together(together)
        assert found.severity == "wrong model"
        assert f"if odd is in {unit}, multiply its scale in the signals file by {factor:.6g}" in found.text


def test_a_sign_turned_in_one_of_two_recordings_is_named_once():
    found = sense_together([bag("noise"), changed(bag("sweep"), force=scaled(-1.0))])
    assert [(f.severity, f.text[:15]) for f in found] == [("wrong model", "sweep: force: a")]


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
    (found,) = (f for f in sense(shifted(bag("noise"), signal, seconds)) if "logged" in f.text)
    assert found.severity == "wrong model"
    assert found.text.startswith(f"{late}: logged ")
    assert found.text.endswith(f" to the key delay (default 0) of {late} in the signals file")


def test_a_single_sine_says_nothing_about_a_delay():
    """Elasticity, valve lag and a delay look alike there."""
    assert sense(shifted(bag("sine_4hz"), "force", 0.02)) == ()


def test_a_current_that_comes_after_its_force_is_late():
    late = shifted(bag("noise"), "current", 0.06)
    assert current_delay(recorded_motion(late)).certain
    (found,) = sense(late)
    assert found.text.startswith("current: logged ")
    assert "after the force; add 0.0" in found.text


def test_a_rate_too_low_for_the_force_is_named():
    (found,) = (f for f in sense(thinned(bag("noise"), 20)) if "rate" in f.text)
    assert found.severity == "warning"
    assert found.text.startswith("force: ") and "near half the rate of 50 Hz" in found.text
    assert not [f for f in sense(thinned(bag("sine_4hz"), 5)) if "rate" in f.text]


def test_one_current_in_all_recordings_is_a_warning_a_passive_damper_is_none():
    fixed = [changed(bag(name), current=lambda c: np.full(len(c), 0.5)) for name in ("noise", "sweep")]
    (found,) = sense_together(fixed)
    assert (found.severity, found.text[:36]) == ("warning", "current: 0.5 A in all recordings; a ")
    passive = [changed(r, current=scaled(0.0)) for r in fixed]
    assert sense_together(passive) == ()
    assert sense_together([fixed[0], changed(fixed[1], current=scaled(0.5))]) == ()


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
    assert sense(replace(holes, channels=channels)) == ()


@pytest.mark.parametrize("count", [0, 1, 5, 30, 500])
def test_short_recordings_are_no_problem(count):
    short = {n: c.select(np.arange(len(c)) < count) for n, c in bag("noise").channels.items()}
    assert sense(replace(bag("noise"), channels=short)) == ()


def test_a_recording_without_force_or_current_is_checked_as_far_as_it_goes():
    channels = {n: c for n, c in bag("noise").channels.items() if n == "position"}
    assert sense(Recording("bare", channels, {"current": 0.0})) == ()
    in_mm = {"position": Channel("position", "m", channels["position"].stamps_ns, 1e3 * channels["position"].values)}
    assert [f.severity for f in sense(Recording("bare", in_mm, {"current": 0.0}))] == ["wrong model"]


def test_wrong_models_are_refused_unless_one_goes_on():
    found = sense_together([changed(bag("noise"), force=scaled(-1.0), current=scaled(1e3))])
    with pytest.raises(
        RecordingError, match=r"noise: .*\(and 1 more findings like this\).*--force identifies all the same"
    ):
        require_sensible(found)
    assert len(require_sensible(found, go_on=True)) == 2
    assert require_sensible(()) == ()
