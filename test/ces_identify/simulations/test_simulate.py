"""Batch and step by step give the same force and the same band, for every structure: the estimator is the model."""

from dataclasses import replace

import numpy as np
import pytest
from bands import BAND, lower_bounds
from constructed_models import constructed_damper
from planted import FUZZY, NETWORK, SAMPLING, planted, stroked
from planted_dampers import planted_model
from residual_series import series
from samplings import make_sampling

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current, prepare
from ces_identify.simulations.simulate import sample_force, sample_run, simulate_series
from ces_identify.validation.band import band_half_width
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, parse_model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

TERMS = (
    Term(800.0, (Factor("speed", 0, 0.5),)),
    Term(500.0, (Factor("speed", 6, 1.0), Factor("current", 11, 1.0, signed=False))),
    Term(0.5, (Factor("force", 1),)),
    Term(0.2, (Factor("force", 9), Factor("current", 0, 2.0, signed=False))),
    Term(3.0, (Factor("position", 2, 1.0),)),
)
GAPS = ((1500, 30_000_000), (2500, 80_000_000))
SEGMENTS = np.array([[0, 900], [900, 901], [901, 3000]])
TIGHT = Envelope((-0.01, 0.012), (-0.3, 0.3), (0.35, 0.6))
LAGGED = {"network": NETWORK, "fuzzy": FUZZY}


def polynomial(rate=1000.0, band=None):
    envelope = Envelope((-0.018, 0.02), (-0.6, 0.6), (0.3, 0.65))
    return Model(make_sampling(rate, 0.004), Polynomial(TERMS), envelope, (-9e3, 9e3), band=band)


def rough(jitter_ns=60_000, rate=1000.0, gaps=GAPS):
    """A recording with jitter, gaps, an outlier and a position that is no number, of 4 s."""
    random = np.random.default_rng(3)
    n = round(4 * rate)
    stamps = (np.arange(n) * 1e9 / rate + random.normal(0, jitter_ns, n)).astype(np.int64) + 10**18
    for at, length in gaps:
        stamps[at:] += length
    t = (stamps - stamps[0]) * 1e-9
    x = 0.02 * np.sin(2 * np.pi * 4 * t) + random.normal(0, 1e-5, n)
    x[[777, 778]] = np.nan, 0.5
    slow = stamps[::10] + 12_345
    current = Channel("current", "A", slow, 0.5 + 0.2 * np.sin(9e-9 * (slow - slow[0])))
    return Recording("rough", {"position": Channel("position", "m", stamps, x), "current": current})


def broken_up(recording, at=(1200, 2500), by_ns=(30_000_000, 90_000_000)):
    """A recording of a slower model with jitter, a short gap, a long gap and a bad sample."""
    random = np.random.default_rng(2)
    position = recording.channel("position")
    stamps = position.stamps_ns + random.integers(-200_000, 200_000, len(position))
    for index, step in zip(at, by_ns, strict=True):
        stamps[index:] += step
    values = position.values.copy()
    values[777] = np.nan
    current = replace(recording.channel("current"), stamps_ns=stamps)
    return Recording("rough", {"position": Channel("position", "m", stamps, values), "current": current})


def stepped(m, recording):
    """Forces (samples,) of the estimator, half widths of its band where it has one, and where its force was held."""
    estimator = Estimator(m)
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, m.sampling.max_current_age_s)
    rows = zip(position.stamps_ns.tolist(), position.values.tolist(), current.tolist(), strict=True)
    found = np.full((3, len(position)), np.nan)
    for k, row in enumerate(rows):
        force = estimator.step(*row)
        if force is not None:
            found[:, k] = force, estimator.half_width() or np.nan, estimator.held
    return found


CASES = {
    "polynomial, steady": lambda: (polynomial(), rough(0, gaps=())),
    "polynomial, jitter and gaps": lambda: (polynomial(), rough()),
    "polynomial, slower model": lambda: (polynomial(400.0), rough(20_000, gaps=())),
    "polynomial, other rate": lambda: (polynomial(), rough(5_000, 777.0, ())),
    "constructed inputs": lambda: (constructed_damper(), rough()),
    "constructed inputs, slower model": lambda: (constructed_damper(rate_Hz=400.0), rough(20_000, gaps=())),
    "network": lambda: (NETWORK, broken_up(stroked(3))),
    "network, clamped": lambda: (replace(NETWORK, envelope=TIGHT), broken_up(stroked(3))),
    "fuzzy": lambda: (FUZZY, broken_up(stroked(3))),
    "fuzzy, clamped": lambda: (replace(FUZZY, envelope=TIGHT), broken_up(stroked(3))),
    "hydraulic": lambda: (planted_model("uniflow"), broken_up(stroked(3))),
    "hydraulic, bypass": lambda: (planted_model("twin tube", bypass=True), broken_up(stroked(3))),
}
HELD = {"polynomial": "polynomial, jitter and gaps"} | {name: name for name in ("network", "fuzzy", "hydraulic")}


def test_forces_are_withheld_until_the_model_has_settled():
    slow, recording = replace(polynomial(), settles_s=0.9), rough()
    forces, (steps, *_) = sample_force(slow, recording), stepped(slow, recording)
    assert np.array_equal(forces, steps, equal_nan=True)
    assert np.isnan(forces).sum() > np.isnan(sample_force(polynomial(), recording)).sum() + 500


@pytest.mark.parametrize("kind", HELD)
def test_estimator_and_batch_hold_the_same_forces_at_the_envelope(kind) -> None:
    model, recording = CASES[HELD[kind]]()
    low, high = np.nanquantile(sample_force(model, recording), (0.2, 0.7))
    tight = replace(model, force_envelope_N=(float(low), float(high)))
    batch, (steps, _, held) = sample_run(tight, recording), stepped(tight, recording)
    np.testing.assert_allclose(batch.force, steps, rtol=1e-9, atol=1e-9 * max(-low, high))
    known = np.isfinite(batch.force)
    np.testing.assert_array_equal(batch.held_at(known)[2], held[known] == 1.0)
    assert 0.1 < batch.held_at(known)[2].mean() < 0.9


def surge():
    """A ride of 3 s whose stroke is eight times as long from 1 s to 1.5 s."""
    time_s = np.arange(3000) / 1000.0
    stroke_m = 0.004 * np.where((time_s >= 1.0) & (time_s < 1.5), 8.0, 1.0)
    channels = {"position": stroke_m * np.sin(2 * np.pi * 4.0 * time_s), "current": np.full(3000, 0.5)}
    stamps = np.rint(time_s * 1e9).astype(np.int64) + 10**18
    return Recording("surge", {name: Channel(name, "", stamps, values) for name, values in channels.items()})


def test_a_certified_run_is_held_on_a_stroke_beyond_its_data_and_comes_back_by_itself() -> None:
    terms = (Term(0.9, (Factor("force", 1),)), Term(6e3, (Factor("position", 0, 1.0),)))
    free = Model(make_sampling(), Polynomial(terms), Envelope((-0.04, 0.04), (-2.0, 2.0), (0.0, 1.0)), (-1e5, 1e5))
    tight = replace(free, force_envelope_N=(-400.0, 500.0))
    assert tight.certify().holds and tight.certify().drive_N > 200.0
    run, whole, (steps, *_) = sample_run(tight, surge()), sample_force(free, surge()), stepped(tight, surge())
    past = np.arange(3000) >= 500  # the warm-up
    assert np.isfinite(run.force[past]).all() and np.isfinite(steps[past]).all()  # nothing is withheld after it
    limits, time_s, held = run.held_at(past)
    assert limits == (-400.0, 500.0) == (run.force[past].min(), run.force[past].max())
    assert 0.1 < held.mean() < 0.2 and not held[(time_s < 1.0) | (time_s > 1.52)].any()
    np.testing.assert_allclose(run.force[1700:], whole[1700:], rtol=1e-6)  # 0.9^200 of what was held is left


@pytest.mark.parametrize("kind", LAGGED)
def test_a_model_read_back_from_its_file_gives_the_same_force(kind) -> None:
    ride = prepare(planted(LAGGED[kind], 6), SAMPLING)
    again = parse_model(LAGGED[kind].to_json(), "m.json")
    np.testing.assert_array_equal(simulate_series(again, ride).force, simulate_series(LAGGED[kind], ride).force)


# ------------------------------------------------------------------------------------------------------- the band


def test_there_is_no_half_width_without_a_force() -> None:
    one, force = series(400, segments=np.array([[0, 200], [200, 400]])), np.ones(400)
    force[150:200] = np.nan
    np.testing.assert_array_equal(np.isnan(band_half_width(BAND, one, force)), np.isnan(force))


def test_bounds_at_the_samples_are_the_estimators() -> None:
    recording, m = rough(gaps=GAPS[1:]), polynomial(band=BAND)
    lower = lower_bounds(sample_run(m, recording))
    force, width, _ = stepped(m, recording)
    assert np.isfinite(lower).sum() > 2500
    np.testing.assert_allclose(lower, force - width, rtol=1e-9, atol=1e-7)
