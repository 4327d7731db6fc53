"""Delays between channels are told with their interval; what only looks like one is not."""

from dataclasses import replace

import numpy as np
import pytest
from spoilt_recordings import bag, changed, shifted, sine

from bench.look_alikes import make_look_alike
from ces_data.checks.check import check_each, check_recording
from ces_data.checks.delays import (
    DelayEstimate,
    current_delay,
    delay_findings,
    force_delay,
)
from ces_data.checks.jumps import find_clock_drift, find_drift_within
from ces_data.checks.motion import recorded_motion


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
    sines = [sine(1.0), sine(5.0), sine(8.0)]
    assert check_each(sines) == ()
    (found,) = check_each([shifted(one, "force", 0.03) for one in sines])
    assert found.severity == "wrong model"
    assert found.text.startswith("3 recordings together: force: logged ")


def test_a_delay_beyond_what_is_tried_has_no_figure():
    estimate = DelayEstimate(0.07, 0.04, 0.07, 0.3, 0.1)
    assert estimate.beyond and estimate.open_ended
    (found,) = delay_findings(recorded_motion(bag("noise")), estimate)
    assert found.text.startswith("force: logged at least 40 ms after the position, too much to estimate;")


@pytest.mark.parametrize(
    ("kind", "stroke", "current"),
    [
        ("inertia", "steps", "constant"),
        ("inertia", "moves", "constant"),
        ("inertia", "moves", "sine"),
        ("position-sensitive", "moves", "stepped"),
        ("all of them", "noise", "stepped"),
    ],
)
@pytest.mark.parametrize("seed", [26, 27])
def test_what_looks_like_a_delay_is_none(kind, stroke, current, seed):
    """Each was told to be logged 8 to 49 ms late, at one of the seeds."""
    assert check_recording(make_look_alike(kind, stroke, current, seed)) == ()


def test_a_mass_that_explains_the_force_as_well_as_a_delay_is_named_beside_it():
    motion = recorded_motion(make_look_alike("inertia", "moves", "constant", 26))
    estimate = DelayEstimate(-0.008, -0.011, -0.005, 0.3, 0.1, alternatives=("inertia",))
    (found,) = delay_findings(motion, estimate)
    assert found.severity == "warning"
    assert found.text.startswith(
        "position: 8 ms after the force, or a mass of about 90 kg between piston and load cell:"
    )


@pytest.mark.parametrize(("name", "ppm"), [("road", -2000.0), ("noise", 1500.0), ("sine_4hz", 1500.0)])
def test_clocks_that_drift_apart_are_no_delay(name, ppm):
    """A constant delay would correct the middle of the recording only; on one sine it cannot be known, a drift can."""
    recording = bag(name)
    force = recording.channels["force"]
    since = force.stamps_ns - force.stamps_ns[0]
    stamps = force.stamps_ns[0] + np.rint(since * (1.0 + 1e-6 * ppm)).astype(np.int64)
    drifted = replace(recording, channels={**recording.channels, "force": replace(force, stamps_ns=stamps)})
    assert find_drift_within(recorded_motion(recording)) is None
    (found,) = check_recording(drifted)
    assert found.severity == "wrong model" and "their clocks drift apart" in found.text


def test_a_constant_delay_is_no_drift():
    assert find_clock_drift(shifted(bag("noise"), "force", 0.03)) is None


def test_a_channel_that_is_held_has_no_delay_of_its_own():
    """Repeated samples come late by half of their time: the sensor's rate is the remedy, not a delay."""
    held_at_50Hz = changed(bag("noise"), position=lambda v: v[np.arange(len(v)) // 20 * 20])
    found = [f.text for f in check_recording(held_at_50Hz)]
    assert any("position: stamped at 1000 Hz" in text for text in found)
    assert not any("logged" in text for text in found)


def test_a_current_that_comes_after_its_force_is_late():
    late = shifted(bag("noise"), "current", 0.06)
    assert current_delay(recorded_motion(late)).certain
    (found,) = check_recording(late)
    assert found.text.startswith("current: logged ")
    assert "after the force; add 0.0" in found.text
