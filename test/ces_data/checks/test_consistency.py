"""Units mixed and opposite signs are reported; experiments that only differ are not."""

import numpy as np
import pytest
from made_recordings import recording_of

from ces_data.checks.check import find_differences, find_traits, require_consistent
from ces_data.recording import Channel, Recording
from ces_observer.errors import RecordingError

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
