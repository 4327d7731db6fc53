"""Models whose speed is known from a measured speed or acceleration, too: online, offline, and when it is missing."""

import json
from dataclasses import replace

import numpy as np
import pytest
from damper_models import plain_damper
from rough_samples import AMPLITUDE_M, MS, OMEGA
from samplings import make_sampling

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import hold_current, hold_motion, prepare
from ces_identify.simulations.simulate import sample_force
from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.damper_observer import NO_MOTION, DamperObserver
from ces_observer.errors import ModelError, RecordingError
from ces_observer.estimator import Estimator
from ces_observer.model import parse_model
from ces_observer.reasons import OK

MOTIONS = {"": {}, "speed": {"motion_noise": 2e-3}, "acceleration": {"motion_noise": 0.1}}


def sampling_of(motion, **changes):
    return make_sampling(**{"outlier_m": 0.004, "warm_up_s": 0.3, "motion": motion, **MOTIONS[motion], **changes})


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


def test_a_measured_speed_is_known_from_the_first_sample_on():
    series = prepare(recording(), sampling_of("speed"))
    true = AMPLITUDE_M * OMEGA * np.cos(OMEGA * series.time_s)
    assert np.abs(series.speed - true).max() < 0.03 * AMPLITUDE_M * OMEGA


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("made", [{"gap_at": 2500}, {"without": slice(1000, 1200)}])
@pytest.mark.parametrize("delay_s", [0.0, 0.003])
def test_estimator_and_batch_run_agree(motion, made, delay_s):
    """At once, or late: at the stamps that the late estimates name, and nowhere else at first samples of ticks."""
    made = recording(**made)
    model = replace(plain_damper(), sampling=sampling_of(motion, delay_s=delay_s))
    estimator, position = Estimator(model), made.channel("position")
    current = hold_current(made, position.stamps_ns, 0.2)
    columns = position.stamps_ns, position.values, current, hold_motion(made, position.stamps_ns, model.sampling)
    stepped = np.full(len(position), np.nan)
    index = {stamp: k for k, stamp in enumerate(position.stamps_ns.tolist())}
    for k, row in enumerate(zip(*(c.tolist() for c in columns), strict=True)):
        force = estimator.step(*row)
        stepped[k] = np.nan if force is None else force
        for one in estimator.late:
            stepped[index[one.stamp_ns]] = one.force
    np.testing.assert_allclose(sample_force(model, made), stepped, rtol=1e-9, atol=1e-9)
    assert np.isfinite(stepped).sum() > 3000


def test_a_recording_without_the_signal_is_refused():
    made = recording()
    bare = replace(made, channels={"position": made.channel("position")})
    with pytest.raises(RecordingError, match="made: no 'speed' channel"):
        prepare(bare, sampling_of("speed"))
    old = replace(made, channels={**made.channels, "speed": made.channel("speed").select(np.arange(5000) < 0)})
    with pytest.raises(RecordingError, match=r"no position sample with a speed at most 0\.05 s old"):
        prepare(old, sampling_of("speed"))


# -------------------------------------------------------------------------------------------------- the damper observer


def measured_model():
    return plain_damper(motion="speed", motion_noise=2e-3)


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
    assert damper.motion_name == "speed"
    assert damper.speed == pytest.approx(AMPLITUDE_M * OMEGA * np.cos(OMEGA * 1e-3 * 699), abs=1e-3)


# ------------------------------------------------------------------------------------------------------ the model file


@pytest.mark.parametrize(
    ("motion", "change", "message"),
    [
        ("speed", {"motion": "force"}, "motion is 'force'; expected one of speed, acceleration"),
        ("speed", {"motion": 3}, "motion is 3; expected one of"),
        ("", {"motion_noise": 1e-5}, "unknown key 'motion_noise'"),
        ("", {"motion": "speed"}, "key 'motion_noise' is missing"),
    ],
)
def test_what_is_wrong_is_named(motion, change, message):
    content = json.loads(replace(plain_damper(), sampling=sampling_of(motion)).to_json())
    content["sampling"].update(change)
    with pytest.raises(ModelError) as error:
        parse_model(json.dumps(content), "m.json")
    assert message in str(error.value)
