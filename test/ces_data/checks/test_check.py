"""Faults put into sound recordings are named with their remedy; sound recordings, also of other dampers, are not."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_recordings import recording_of
from spoilt_recordings import ROOT, bag, changed, held, sine, thinned

from bench.sense_faults import restamp
from ces_data.checks.check import (
    check_recording,
    check_together,
    find_differences,
    find_traits,
    require_consistent,
    require_sound,
)
from ces_data.checks.sensors import find_saturations
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Channel, Recording
from ces_identify.scripting.recording import with_methods
from ces_observer.errors import RecordingError

DATA = Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
BAGS = ("noise", "road", "sine_4hz", "sweep")


def scaled(factor):
    return lambda values: factor * values


def spiked(count, size, length=1):
    """Return a change of `count` stretches to a value, in turn positive and negative."""

    def apply(values):
        at = np.linspace(500, len(values) - 500, count).astype(int)
        spoilt = values.copy()
        for k in range(length):
            spoilt[at + k] = size * (-1.0) ** np.arange(count)
        return spoilt

    return apply


def wrapped(share):
    """Return a change by a counter whose range is a share of the signal's."""

    def apply(values):
        middle, half = 0.5 * (values.max() + values.min()), 0.5 * share * np.ptp(values)
        return (values - middle + half) % (2.0 * half) + middle - half

    return apply


def retimed(recording, factor):
    """Return the recording with all times since its start in another unit."""
    start = recording.channels["position"].stamps_ns[0]
    stamps = {n: np.rint(factor * (c.stamps_ns - start)).astype(np.int64) for n, c in recording.channels.items()}
    return replace(recording, channels={n: replace(c, stamps_ns=stamps[n]) for n, c in recording.channels.items()})


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


def utfsm(name):
    """Return a measured recording of a damper that rests before and after its strokes."""
    return import_log(DATA / "utfsm_mr" / name, load_dyno_mapping(ROOT / "config" / "import" / "utfsm_mr.yaml"))


@measured
@pytest.mark.parametrize(("current_A", "seconds"), [(0.5, 6.0), (0.5, 7.0), (0.0, 5.0)])
def test_the_stillness_before_a_sweep_shows_no_drift_and_hides_no_sign(current_A, seconds):
    """The clocks were said to drift by 14 to 30 ms over the begin of a sound recording."""
    whole = utfsm(f"sweep_15Hz_{current_A}A.csv")
    begin = whole.share(0.0, seconds / whole.duration_s)
    assert check_recording(begin) == ()
    (found,) = check_recording(changed(begin, force=scaled(-1.0)))
    assert found.text.startswith("force: acts with the motion instead of against it")


@measured
@pytest.mark.parametrize("name", ["sine_5mm4Hz_0.50A.csv", "sine_10mm2Hz_0.00A.csv"])
def test_clocks_that_drift_apart_are_told_although_the_piston_rests_half_of_the_time(name):
    (found,) = check_recording(restamp(["force"], lambda t: 0.998 * t)(utfsm(name)))
    assert "their clocks drift apart" in found.text


@measured
def test_a_force_that_is_sampled_too_slowly_is_no_overflow():
    """Of the sweep to 15 Hz at 50 Hz, a counter was said to overflow."""
    slow = with_methods(utfsm("sweep_15Hz_0.5A.csv")).resample(50.0)
    (found,) = check_recording(slow)
    assert found.text.startswith("force: changes too fast for 50 Hz")


@pytest.mark.parametrize(
    ("change", "severity", "text"),
    [
        ({"force": scaled(-1.0)}, "wrong model", "force: acts with the motion instead of against it"),
        ({"position": scaled(-1.0)}, "wrong model", "multiply the scale of the one that is not by -1"),
        ({"force": scaled(1e-3)}, "wrong model", "by 1000 if it is in kN"),
        ({"force": scaled(1e-3 / 4.448)}, "wrong model", "by 4448.22 if it is in kip"),
        ({"force": scaled(1e3)}, "wrong model", "in mN"),
        ({"force": scaled(20.0 / 3525.0)}, "warning", "little for a damper; multiply its scale"),  # or a bicycle's
        ({"position": scaled(1e3)}, "wrong model", "by 0.001 if it is in mm"),
        ({"position": scaled(39.37)}, "wrong model", "by 0.0254 if it is in inches"),
        ({"position": scaled(1e-3)}, "wrong model", "was it taken for mm? multiply its scale in"),
        ({"position": wrapped(0.8)}, "wrong model", "its counter or converter overflows"),
        ({"force": wrapped(0.8)}, "wrong model", "its counter or converter overflows"),
        ({"force": spiked(12, 999e3)}, "warning", "force: 12 of 25000 samples are spikes, first 9.99e+05 N at 0.500 s"),
        ({"force": spiked(300, 2e4)}, "wrong model", "force: 300 of 25000 samples are spikes"),
        ({"force": spiked(12, 2e4, 9)}, "warning", "108 of 25000 samples are spikes, or between"),
        ({"position": spiked(12, 0.2)}, "warning", "position: 12 of 25000 samples are spikes"),
        ({"current": spiked(12, 99.0)}, "warning", "current: 12 of 12501 samples are spikes"),
        ({"position": lambda x: x + 0.02 * (np.arange(len(x)) > 9000)}, "wrong model", "as no piston moves"),
        ({"force": held(0.4, 0.402)}, "warning", "force: stuck once, at 10.00 s, 0.2% of the time"),
        ({"current": scaled(1e3)}, "wrong model", "by 0.001 if it is in mA"),
        ({"current": scaled(100.0)}, "warning", "percent or raw counts"),
        ({"current": scaled(1e-3)}, "warning", "opens no valve; was it taken for mA? Then multiply its scale in the"),
        ({"position": lambda x: 0.02 * (x - x.mean())}, "warning", "was it taken for mm? multiply its scale in the"),
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


@pytest.mark.parametrize(
    ("factor", "text"),
    [
        (1e3, "if the times are in ms (1000 Hz, 0.97 m/s), whatever their column says, multiply the scale of time in"),
        (1e6, "if the times are in us (1000 Hz"),
        (1e-3, "if the times are in s, not ms (1000 Hz"),
        (1 / 60, "if the times are in min (1000 Hz"),
    ],
)
def test_times_in_another_unit_are_one_finding_with_their_factor(factor, text):
    (found,) = check_recording(retimed(bag("noise"), factor))
    assert found.severity == "wrong model" and found.text.startswith("position: sampled at ")
    assert text in found.text, found.text


def test_slow_strong_or_switched_dampers_are_no_faults():
    """A creeping test is at most suspicious, and a force that flips or is switched does not overflow."""
    time, dice = np.arange(12000) * 5e-3, np.random.default_rng(1)
    x, i = 0.05 * np.sin(0.4 * time), 1.0 * (np.sin(2.1 * time) > 0.0)
    force = 9e4 * np.sign(np.cos(0.4 * time)) * (1.0 + 0.9 * i) + dice.normal(0.0, 50.0, len(time))
    noisy = x + dice.normal(0.0, 1e-5, len(time))
    strong = recording_of(time, position=noisy, current=i + dice.normal(0.0, 1e-3, len(time)), force=force)
    assert [f for f in check_recording(strong) if f.severity != "warning" or "spike" in f.text] == []
    creeping = retimed(recording_of(time, position=noisy, current=0.0 * i, force=force / (1.0 + 0.9 * i)), 20.0)
    assert {f.severity for f in check_recording(creeping)} == {"warning"}


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
        RecordingError,
        match=r"noise: .*\(and 1 more findings like this\).*ignore_findings=True identifies",
    ):
        require_sound(found)
    assert len(require_sound(found, ignore_findings=True)) == 2
    assert require_sound(()) == ()


# --------------------------------- Units mixed and opposite signs are reported; experiments that only differ are not.


START = 10**18


def made(name="run", hz=4.0, stroke_m=0.04, current_A=0.6, seed=1, rate=1000.0, noise_N=20.0, **scales):
    """Return a recording of a sine on a made-up damper; `scales` multiply channels."""
    dice = np.random.default_rng(seed)
    t = np.arange(round(10.0 * rate)) / rate
    x = 0.5 * stroke_m * np.sin(2 * np.pi * hz * t)
    v = np.gradient(x, t)
    damping = (400.0 + 1500.0 * current_A) * np.sign(v) * np.sqrt(np.abs(v))
    columns = {
        "position": x + dice.normal(0, 15e-6, len(t)),
        "current": current_A + dice.normal(0, 1e-3, len(t)),
        "force": damping + 2000.0 * x + dice.normal(0, noise_N, len(t)),
    }
    return recording_of(t, name, START, **{n: scales.get(n, 1.0) * values for n, values in columns.items()})


def without(recording, signal, **constants):
    channels = {name: channel for name, channel in recording.channels.items() if name != signal}
    return Recording(recording.name, channels, constants)


@pytest.mark.parametrize(
    "others",
    [
        [made("slow", hz=0.05, stroke_m=0.06), made("fast", hz=12.0, stroke_m=0.02)],
        [made("passive", current_A=0.0), made("hard", current_A=1.6)],
        [made("still", stroke_m=1e-5, noise_N=1.0), made("all", stroke_m=0.12)],
        [made("coarse", rate=100.0), made("fine", rate=4000.0)],
        [without(made("no current"), "current", current=0.0)],
        [without(made("no force"), "force")],
    ],
    ids=lambda rows: " and ".join(row.name for row in rows),
)
def test_experiments_that_only_differ_are_no_finding(others):
    assert find_differences([made("usual"), *others]) == ()
    assert find_differences([others[0]]) == ()


def test_signs_that_are_turned_everywhere_are_no_difference():
    assert require_consistent([made(f"r{k}", seed=k, force=-1.0) for k in range(3)]) == ()
    assert find_differences([made("one"), made("both", position=-1.0, force=-1.0)]) == ()


@pytest.mark.parametrize(
    ("scales", "message"),
    [
        (
            {"position": 1000.0},
            r"position: spans [34]\d\.?\d* m in odd, 0\.0\d+ m in \w+; expected one unit: .* in mm, cm or inches\?",
        ),
        (
            {"current": 1000.0},
            r"current: reaches 602\.\d A in odd, 0\.602\d A in \w+; expected one unit: is one of them in mA\?",
        ),
        ({"force": 1e-3}, r"force: spans .* N in \w+, .* N in odd, at speeds of 1.* m/s; .*one of them in kN or kip\?"),
        (
            {"force": -1.0},
            r"force goes against speed \(correlation -0\.9\d\) in odd, goes with speed .* in usual, third",
        ),
        ({"position": -1.0}, "force goes against speed .* in odd, .*set scale: -1"),
    ],
)
def test_mixed_units_and_signs_are_refused_naming_the_recordings(scales, message):
    with pytest.raises(RecordingError, match=message) as caught:
        require_consistent([made("usual"), made("odd", seed=2, **scales), made("third", seed=3, hz=5.0)])
    assert "\n" not in str(caught.value)


def test_gaps_jumps_and_samples_that_are_not_finite_do_not_matter():
    channels = dict(made("holes").channels)
    for name in ("position", "force"):
        c = channels[name]
        values, stamps = c.values.copy(), c.stamps_ns.copy()
        values[::50] = np.nan
        stamps[5000:] += 10**17  # three years
        channels[name] = Channel(name, c.unit, stamps, values)
    result = find_traits(Recording("holes", channels))
    assert result.damping > 0.9
    assert result.speed_m_s == pytest.approx(find_traits(made()).speed_m_s, rel=0.05)


def test_hardly_any_samples_tell_nothing():
    for count in (0, 1, 5):
        stamps, values = START + np.arange(count) * 1_000_000, np.arange(count) * 1e-4
        few = Recording("few", {n: Channel(n, "", stamps, values) for n in ("position", "current", "force")})
        assert np.isnan(find_traits(few).damping) and find_differences([few, made("usual")]) == ()
