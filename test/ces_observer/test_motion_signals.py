"""Models whose speed is measured, or fused from position and acceleration: online, offline, and when it is missing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from damper_models import plain_damper

from ces_data.recording import Channel, Recording
from ces_identify.numerics import kernels
from ces_identify.prepare.series import hold_current, hold_motion, prepare
from ces_identify.simulations.simulate import sample_force
from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import NO_MOTION, DamperObserver
from ces_observer.errors import ModelError, RecordingError
from ces_observer.estimator import Estimator
from ces_observer.model import ADAPTIVE, FUSED, KALMAN, MEASURED, Sampling, parse_model
from ces_observer.tracker import OK, OUT_OF_ORDER, OUTLIER, RESTARTED, UNSETTLED, Tracker

STATUS = {OK: 0, OUT_OF_ORDER: 1, OUTLIER: 2, RESTARTED: 3, UNSETTLED: 4}
KINDS = (KALMAN, ADAPTIVE, FUSED, MEASURED)
MS = 1_000_000
OMEGA = 30.0
AMPLITUDE_M = 0.02


def sampling_of(kind, rate=1000.0, order=3):
    bandwidth, outlier = (3.0, 0.03) if kind == FUSED else (90.0, 0.004)
    noise = 15e-6 if kind == ADAPTIVE else 0.0
    return Sampling(rate, bandwidth, outlier, warm_up_s=0.3, order=order, differentiator=kind, noise_m=noise)


def rough_samples(seed):
    """Stamps, positions, and speeds or accelerations: jitter, gaps, lost, repeated, late and wild samples, a jump."""
    dice = np.random.default_rng(seed)
    stamps = (np.arange(4000) * MS + dice.normal(0, 150_000, 4000)).astype(np.int64)
    stamps[900:] += 60 * MS
    stamps[2000:] += 20 * MS
    stamps[3500:] -= 400 * MS
    stamps[300] = stamps[299]
    phase = OMEGA * 1e-9 * stamps
    positions = AMPLITUDE_M * np.sin(phase) + dice.normal(0, 15e-6, 4000)
    wild = dice.choice(4000, 40, replace=False)
    positions[wild] += dice.choice([-0.2, 0.05], 40)
    positions[2700:] += 0.06
    speeds = AMPLITUDE_M * OMEGA * np.cos(phase)
    accelerations = 0.3 - AMPLITUDE_M * OMEGA**2 * np.sin(phase) + dice.normal(0, 0.05, 4000)
    kept = dice.random(4000) > 0.05
    return stamps[kept], positions[kept], {"speed": speeds[kept], "acceleration": accelerations[kept]}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("rate", "order"), [(400.0, 3), (1000.0, 3), (2500.0, 2)])
def test_offline_twin_gives_the_same_ticks(kind, rate, order):
    stamps, positions, motions = rough_samples(5)
    s = sampling_of(kind, rate, 3 if kind == FUSED else order)
    motion = motions[s.motion_signal] if s.motion_signal else np.zeros(len(stamps))
    ticks, _, total, status, ahead, _ = kernels.track(
        stamps, positions, rate, s.bandwidth_Hz, 50 * MS, s.outlier_m, s.order, motion, kind, s.noise_m
    )
    tracker, slow = Tracker(s), []
    for i, sample in enumerate(zip(stamps.tolist(), positions.tolist(), motion.tolist(), strict=True)):
        assert STATUS[tracker.advance(*sample)] == status[i]
        slow += tracker.ticks
        assert total[i] == len(slow)
        if status[i] == kernels.STATUS_OK:
            assert ahead[i] == tracker.ahead
    assert set(status.tolist()) >= {0, 1, 2, 3}
    np.testing.assert_allclose(ticks, slow, rtol=1e-10, atol=1e-12)


def recording(gap_at=None, without=slice(0, 0), phase_ns=-200_000):
    """5 s at 1 kHz; speed and acceleration are sampled 0.2 ms before the position, and missing in `without`."""
    stamps = np.arange(5000) * MS + 10**18
    if gap_at is not None:
        stamps[gap_at:] += 80 * MS
    time = 1e-9 * (stamps - stamps[0])
    dice = np.random.default_rng(1)
    stamps = stamps + dice.integers(-50_000, 50_000, 5000)
    position = AMPLITUDE_M * np.sin(OMEGA * time) + dice.normal(0, 15e-6, 5000)
    kept = np.ones(5000, bool)
    kept[without] = False
    early = time + 1e-9 * phase_ns
    speed = AMPLITUDE_M * OMEGA * np.cos(OMEGA * early)
    acceleration = -AMPLITUDE_M * OMEGA**2 * np.sin(OMEGA * early)
    channels = {
        "position": Channel("position", "m", stamps, position),
        "speed": Channel("speed", "m/s", stamps[kept] + phase_ns, speed[kept]),
        "acceleration": Channel("acceleration", "m/s2", stamps[kept] + phase_ns, acceleration[kept]),
    }
    return Recording("made", channels, {"current": 0.5})


def test_a_measured_speed_is_used_as_it_is():
    made = recording()
    series = prepare(made, sampling_of(MEASURED))
    logged = made.channel("speed")
    expected = np.interp(series.time_s, 1e-9 * (made.channel("position").stamps_ns - 10**18), logged.values)
    assert np.abs(series.speed - expected)[1:].max() < 0.02 * np.abs(logged.values).max()
    np.testing.assert_allclose(series.speed[0], logged.values[0])  # at once, without settling


def test_a_fused_speed_has_less_noise_than_that_of_the_position_alone():
    made, late = recording(), slice(1500, None)

    def error(kind):
        series = prepare(made, sampling_of(kind))
        return np.std((series.speed - AMPLITUDE_M * OMEGA * np.cos(OMEGA * series.time_s))[late])

    assert error(FUSED) < 0.6 * error(KALMAN)


def test_a_constant_error_of_the_acceleration_is_found():
    made = recording()
    channel = made.channel("acceleration")
    off = {**made.channels, "acceleration": replace(channel, values=channel.values + 2.0)}
    good, bad = (prepare(r, sampling_of(FUSED)) for r in (made, replace(made, channels=off)))
    assert np.abs(good.speed - bad.speed)[:100].max() > 0.05
    assert np.abs(good.speed - bad.speed)[2000:].max() < 1e-3


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("made", [{"gap_at": 2500}, {"without": slice(1000, 1200)}])
def test_estimator_and_batch_run_agree(kind, made):
    made = recording(**made)
    model = plain_damper()
    model = replace(model, sampling=sampling_of(kind))
    estimator, position = Estimator(model), made.channel("position")
    current = hold_current(made, position.stamps_ns, 0.2)
    motion = hold_motion(made, position.stamps_ns, model.sampling)
    columns = (position.stamps_ns, position.values, current, motion)
    forces = [estimator.step(*row) for row in zip(*(c.tolist() for c in columns), strict=True)]
    stepped = np.array([np.nan if force is None else force for force in forces])
    np.testing.assert_allclose(sample_force(model, made), stepped, rtol=1e-9, atol=1e-9)
    assert np.isfinite(stepped).sum() > 3000


def test_a_recording_without_the_signal_is_refused():
    made = recording()
    bare = replace(made, channels={"position": made.channel("position")})
    with pytest.raises(RecordingError, match="made: no 'speed' channel, which the differentiator 'measured' needs"):
        prepare(bare, sampling_of(MEASURED))
    old = replace(made, channels={**made.channels, "speed": made.channel("speed").select(np.arange(5000) < 0)})
    with pytest.raises(RecordingError, match=r"no position sample with a speed at most 0\.05 s old"):
        prepare(old, sampling_of(MEASURED))


# -------------------------------------------------------------------------------------------------- the damper observer


def measured_model():
    model = plain_damper()
    return replace(model, sampling=replace(model.sampling, differentiator=MEASURED))


def observer(model, **motions):
    return DamperObserver(model, ConstantCurrent(0.5), 0.0, motions)


def drive(damper, first, last, speed=True):
    forces = []
    for k in range(first, last):
        stamp = 10**18 + k * MS
        if speed:
            damper.take_motion("speed", stamp, AMPLITUDE_M * OMEGA * np.cos(OMEGA * 1e-3 * k))
        forces.append(damper.step(stamp, AMPLITUDE_M * np.sin(OMEGA * 1e-3 * k), stamp))
    return forces


def test_a_force_is_withheld_while_no_speed_arrives_and_comes_back():
    damper = observer(measured_model(), speed=CurrentHold(0.05))
    assert drive(damper, 0, 50, speed=False) == [None] * 50
    assert (damper.reason, damper.explain()) == (NO_MOTION, "")
    drive(damper, 50, 400)
    assert damper.reason == OK
    drive(damper, 400, 600, speed=False)
    assert damper.reason == NO_MOTION
    assert "the newest speed is 0.2 s older than the position" in damper.explain()
    assert drive(damper, 600, 900)[-1] is not None
    assert damper.tally.withheld[NO_MOTION] == 50 + 150  # the newest speed is used for 50 ms


def test_a_model_that_needs_a_signal_that_is_not_there_is_refused():
    with pytest.raises(ModelError, match="needs the signal 'speed'"):
        observer(measured_model())
    damper = observer(plain_damper(), acceleration=CurrentHold(0.05))
    for refuse in (damper.motion_for, damper.load):
        with pytest.raises(ModelError, match=r"set speed\.topic"):
            refuse(measured_model())
    assert damper.next_model is None


def test_a_model_with_another_speed_takes_over():
    damper = observer(plain_damper(), speed=CurrentHold(0.05))
    drive(damper, 0, 400)
    damper.load(measured_model())
    drive(damper, 400, 700)
    assert damper.model.sampling.differentiator == MEASURED
    assert damper.speed == AMPLITUDE_M * OMEGA * np.cos(OMEGA * 1e-3 * 699)


# ------------------------------------------------------------------------------------------------------ the model file


@pytest.mark.parametrize("kind", KINDS)
def test_a_saved_model_reads_back_equal(kind):
    model = replace(plain_damper(), sampling=sampling_of(kind))
    assert parse_model(model.to_json(), "m") == model
    assert ('"differentiator"' in model.to_json()) == (kind != KALMAN)  # older versions read plain models


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        (MEASURED, {"differentiator": "best"}, "differentiator is 'best'; expected one of kalman, adaptive, fused"),
        (MEASURED, {"differentiator": 3}, "differentiator is 3; expected one of"),
        (MEASURED, {"noise_m": 1e-5}, "unknown key 'noise_m'"),
        (FUSED, {"order": 2}, "order is 2; expected 3 with differentiator fused"),
        (ADAPTIVE, {"noise_m": 0.0}, "noise_m is 0.0; expected a finite number from 1e-12 to 1"),
        (ADAPTIVE, {"noise_m": None}, "noise_m is None; expected a finite number"),
    ],
)
def test_what_is_wrong_is_named(kind, change, message):
    content = json.loads(replace(plain_damper(), sampling=sampling_of(kind)).to_json())
    content["sampling"].update(change)
    with pytest.raises(ModelError) as error:
        parse_model(json.dumps(content), "m.json")
    assert message in str(error.value)
