"""The band of a model: its file, its half-width by hand, and what the estimator says of it."""

import json
import math

import pytest
from bands import BAND, make_band
from model_examples import make_model
from samplings import make_sampling

from ces_observer.errors import ModelError
from ces_observer.estimator import Estimator
from ces_observer.flat import ArrayLayout
from ces_observer.model import PARTS, parse_model
from ces_observer.tick.band import band_half_width, band_tick
from ces_observer.tick.model import K_STRUCTURE, N_STRUCTURE, P_STRUCTURE, S_STRUCTURE

MS = 1_000_000
NO_DISTANCE = {"whitening": ((0.0,) * 5, (0.0,) * 4, (0.0,) * 3, (0.0,) * 2, (0.0,)), "constant_share": 1.0}


def only(part, weight=1.0):
    """Return a band of one part, everywhere at the same distance."""
    return make_band(parts=tuple(weight if name == part else 0.0 for name in PARTS), **NO_DISTANCE)


def width_after(band, *ticks):
    layout = ArrayLayout(P_STRUCTURE, N_STRUCTURE, S_STRUCTURE, K_STRUCTURE)
    band.fill(layout, 1000.0)
    p, _, s, k = layout.arrays()
    for tick in ticks:
        band_tick(p, s, k, *tick)
    return band_half_width(p, s)


def test_a_model_without_a_band_has_no_such_key():
    text = make_model().to_json()
    assert "band" not in json.loads(text)
    assert parse_model(text, "m.json").band is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda b: b.pop("level"), "band: key 'level' is missing"),
        (lambda b: b.update(levl=0.9), "unknown key 'levl'"),
        (lambda b: b["parts"].update(quick_N=1.0), "parts: unknown key 'quick_N'"),
        (lambda b: b["parts"].pop("force"), "parts: key 'force' is missing"),
        (lambda b: b.update(mean=[0.0] * 4), "mean is .*expected a list of 5 numbers"),
        (lambda b: b["whitening"].append(1.0), "whitening is .*expected a list of 15"),
        (lambda b: b.update(current_A=[0.7, 0.2]), "current_A is .*expected \\[low, high\\]"),
    ],
)
def test_what_is_wrong_with_a_band_is_named(change, message):
    raw = json.loads(make_model(band=BAND).to_json())
    change(raw["band"])
    with pytest.raises(ModelError, match=message) as caught:
        parse_model(json.dumps(raw), "m.json")
    assert str(caught.value).startswith("m.json: band") and "\n" not in str(caught.value)


@pytest.mark.parametrize("value", [[], 3, "wide"])
def test_a_band_that_is_no_object_is_refused(value):
    raw = json.loads(make_model(band=BAND).to_json()) | {"band": value}
    with pytest.raises(ModelError, match=r"m\.json: band is .*; expected a mapping"):
        parse_model(json.dumps(raw), "m.json")


@pytest.mark.parametrize(
    ("part", "tick", "expected"),
    [
        ("low_current_N", (0.0, 0.3, 0.2, 100.0), 1.0),
        ("low_current_N", (0.0, 0.3, 0.3, 100.0), 0.8),
        ("high_current_N", (0.0, 0.3, 0.3, 100.0), 0.2),
        ("high_current_N", (0.0, 0.3, 9.0, 100.0), 1.0),
        ("slow_N", (0.0, 0.0, 0.3, 100.0), 1.0),
        ("slow_N", (0.0, -0.5, 0.3, 100.0), 0.5),
        ("fast_N", (0.0, -1.5, 0.3, 100.0), 3.0),
        ("force", (0.0, 0.3, 0.3, -250.0), 250.0),
        ("change_of_force", (0.0, 0.3, 0.3, -250.0), 0.0),
        ("reversal_N", (0.0, 0.3, 0.3, 100.0), 1.0),
    ],
)
def test_parts_at_the_first_tick(part, tick, expected):
    assert width_after(only(part), tick) == pytest.approx(expected)


def test_a_change_of_force_fades_with_its_time_constant():
    ticks = [(0.0, 0.3, 0.3, 0.0), *[(0.0, 0.3, 0.3, 100.0)] * 10]
    assert width_after(only("change_of_force"), *ticks) == pytest.approx(100.0 * math.exp(-1.0))


def test_a_reversal_fades_with_its_time_constant():
    ticks = [(0.0, 0.3, 0.3, 0.0)] * 500 + [(0.0, -0.1, 0.3, 0.0)] * 21
    assert width_after(only("reversal_N"), *ticks[:500]) < 1e-10
    assert width_after(only("reversal_N"), *ticks) == pytest.approx(math.exp(-1.0))


def test_growth_follows_the_distance_up_to_its_limit():
    flat = make_band(parts=(1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0), mean=(0.0,) * 5)
    band = make_band(
        parts=flat.parts, mean=flat.mean, whitening=((100.0, 0.0, 0.0, 0.0, 0.0), *NO_DISTANCE["whitening"][1:])
    )
    for position, distance in ((0.0, 0.0), (0.01, 1.0), (-0.03, 3.0), (0.05, 4.0), (1e300, 4.0)):
        expected = math.sqrt(0.2 + 0.8 * distance**2)
        assert width_after(band, (position, 0.3, 0.3, 0.0)) == pytest.approx(expected)


def test_all_directions_of_the_state_count():
    ticks = [(0.002, 0.1, 0.3, 50.0), (0.004, -0.2, 0.6, 80.0)]
    gain = 1.0 - math.exp(-0.1)
    z = [0.004 - 0.001, -0.2 - 0.02, 0.6 - 0.45, -0.3 * (1.0 - gain), 0.3 * (1.0 - gain)]
    rows = [sum(w * z[i + j] for j, w in enumerate(row)) for i, row in enumerate(BAND.whitening)]
    growth = math.sqrt(0.2 + 0.8 * min(sum(r * r for r in rows), 16.0))
    high, u = 0.8, 0.4
    change = 30.0 * (1.0 - gain)
    parts = 10.0 * (1 - high) + 30.0 * high + 20.0 / (1 + u) + 5.0 * u + 0.02 * 80.0 + 0.05 * change + 40.0
    assert width_after(BAND, *ticks) == pytest.approx(parts * growth)


def test_the_estimator_has_a_half_width_if_its_model_has_a_band():
    with_band, without = Estimator(make_model(band=BAND)), Estimator(make_model())
    for k in range(700):
        sample = (k * MS, 0.01 * math.sin(0.0126 * k), 0.5)
        assert with_band.step(*sample) == without.step(*sample)
    assert without.half_width() is None
    width = with_band.half_width()
    assert width is not None and 20.0 < width < 1e4


def test_a_restart_makes_the_half_width_forget_the_past():
    used, fresh = Estimator(make_model(band=BAND)), Estimator(make_model(band=BAND))
    for k in range(700):
        used.step(k * MS, 0.01 * math.sin(0.02 * k), 0.7)
    for k in range(700):
        sample = (0.005 * math.sin(0.0126 * k), 0.4)
        assert used.step((k + 5000) * MS, *sample) == fresh.step(k * MS, *sample)
    assert used.half_width() == fresh.half_width()


def test_positions_beyond_all_numbers_give_a_wide_band_and_no_error():
    endless = make_model(band=BAND, sampling=make_sampling(stroke_m=(-1e307, 1e307)))
    near, far = Estimator(endless), Estimator(endless)
    for k in range(600):
        near.step(k * MS, 0.001, 0.5)
        far.step(k * MS, 1e300, 0.5)
    assert far.half_width() == pytest.approx(
        near.half_width() * math.sqrt(0.2 + 0.8 * 16.0) / growth_at(0.001), rel=1e-6
    )


def growth_at(position):
    z = [position - 0.001, -0.02, 0.5 - 0.45, 0.0, 0.0]
    rows = [sum(w * z[i + j] for j, w in enumerate(row)) for i, row in enumerate(BAND.whitening)]
    return math.sqrt(0.2 + 0.8 * sum(r * r for r in rows))
