"""Probes of simulations that treat their inputs in a known way; in the diagnoses nothing is withheld."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from made_recordings import recording_of
from physical_models import fitted_model
from scipy.signal import butter, lfilter

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_gap.augmented import load_augmented
from ces_gap.baseline.wrappers import InputTiming, RetimedSimulation
from ces_gap.diagnosis import NO_GAP, Diagnosis
from ces_gap.inputs.probe_result import EARLY, HELD, INTERPOLATED, LATE, STATIC, UNCLEAR, SimulationProbe
from ces_gap.inputs.probes import correct_inputs, probe
from ces_gap.limits import TwinLimits
from ces_gap.pipeline import DiagnoseOptions, diagnose
from ces_gap.result_files import result_files
from ces_gap.trace import open_trace
from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, RecordedSimulation, Simulation
from ces_observer.errors import CesError
from ces_rig.experiments.virtual import load_rig

RATE_HZ, LAG_S, FINER = 500.0, 0.012, 16
Damper = Callable[[F, F, F], F]


def static(time_s: F, position_m: F, current_A: F) -> F:
    """A map of speed and current, softer in compression."""
    speed = np.gradient(position_m, time_s)
    force = (200.0 + 700.0 * current_A) * np.tanh(speed / 0.06) + (300.0 + 500.0 * current_A) * speed
    return np.asarray(np.where(speed > 0.0, 0.7, 1.0) * force)


def lagged(current_A: F, step_s: float) -> F:
    """The current behind a valve's lag, exactly for one that is held until the next sample."""
    pole = np.exp(-step_s / LAG_S)
    return np.asarray(current_A[0] + lfilter([0.0, 1.0 - pole], [1.0, -pole], current_A - current_A[0]))


def held(time_s: F, position_m: F, current_A: F) -> F:
    return static(time_s, position_m, lagged(current_A, time_s[1] - time_s[0]))


def interpolating(time_s: F, position_m: F, current_A: F) -> F:
    step_s = (time_s[1] - time_s[0]) / FINER
    fine = time_s[0] + step_s * np.arange(FINER * (len(time_s) - 1) + 1)
    return static(time_s, position_m, lagged(np.interp(fine, time_s, current_A), step_s)[::FINER])


def backward(time_s: F, position_m: F, current_A: F) -> F:
    return held(time_s, position_m, np.append(current_A[1:], current_A[-1]))


def two_late(time_s: F, position_m: F, current_A: F) -> F:
    return static(time_s, position_m, np.append(np.repeat(current_A[0], 2), current_A[:-2]))


def low_passed(time_s: F, position_m: F, current_A: F, order: int) -> F:
    """The held one behind a filter of 60 Hz on its position."""
    b, a = butter(order, 60.0, fs=1.0 / (time_s[1] - time_s[0]))
    moved = position_m - position_m[0]
    return held(time_s, position_m[0] + lfilter(b, a, moved), current_A)


def late_by_three(time_s: F, position_m: F, current_A: F) -> F:
    return held(time_s, np.append(np.repeat(position_m[0], 3), position_m[:-3]), current_A)


def sprung(time_s: F, position_m: F, current_A: F) -> F:
    """A dashpot that the current changes, behind a spring: no filter, though its force lags."""
    step_s, stiffness, force = time_s[1] - time_s[0], 1e6, np.zeros_like(position_m)
    speed = np.diff(position_m) / step_s
    for k, v in enumerate(speed):
        damping = 900.0 + 1500.0 * current_A[k]
        pole = np.exp(-stiffness / damping * step_s)
        force[k + 1] = pole * force[k] + (1.0 - pole) * damping * v
    return force


@cache
def recording(of: Damper = held, seed: int = 1, noise_N: float = 3.0, rate_Hz: float = RATE_HZ) -> Recording:
    """A random stroke of a few hertz, a current that steps ten times a second, and the force with noise."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(8.0 * rate_Hz)) / rate_Hz
    position = np.zeros_like(time_s)
    for frequency in rng.uniform(0.3, 6.0, 12):
        position += 0.01 / frequency**0.7 * np.sin(2.0 * np.pi * (frequency * time_s + rng.random()))
    current = rng.choice([0.1, 0.4, 0.8, 1.2], 81)[(10.0 * time_s).astype(int)]
    force = of(time_s, position, current) + noise_N * rng.standard_normal(len(time_s))
    return recording_of(time_s, f"made{seed}", position=position, current=current, force=force)


def simulation(function: Damper) -> FunctionSimulation:
    return FunctionSimulation("simulation", function)


def probed(function: Damper, rate_Hz: float = RATE_HZ, like: Damper = static) -> SimulationProbe:
    return probe(simulation(function), open_trace(simulation(static), recording(like, rate_Hz=rate_Hz), False))


@pytest.mark.parametrize("rate_Hz", [250.0, 500.0, 1000.0])
@pytest.mark.parametrize(
    ("function", "convention", "lead"),
    [
        (static, STATIC, 0.0),
        (held, HELD, 0.0),
        (interpolating, INTERPOLATED, 0.5 - 0.5 / FINER),
        (backward, EARLY, 1.0),
        (two_late, LATE, -2.0),
    ],
)
def test_the_convention_of_the_current_is_found(function: Damper, convention: str, lead: float, rate_Hz: float) -> None:
    result = probed(function, rate_Hz)
    assert result.current_convention == convention
    assert result.current_lead_samples == pytest.approx(lead, abs=0.1)
    assert result.current_lead_s == pytest.approx(lead / rate_Hz, abs=0.1 / rate_Hz)
    assert result.position_delay_s[0] == 0.0
    assert result.noise_N == result.memory_N == 0.0 and result.calls == 5
    assert bool(result.findings) == bool(result.timing) == (lead != 0.0)
    assert ("Nothing found" in result.summary) == (lead == 0.0)


@pytest.mark.parametrize(
    ("function", "rate_Hz", "delay_s"),
    [
        (partial(low_passed, order=1), 1000.0, 2.65e-3),
        (partial(low_passed, order=2), 1000.0, 3.75e-3),
        (partial(low_passed, order=4), 1000.0, 6.93e-3),
        (late_by_three, RATE_HZ, 3.0 / RATE_HZ),
    ],
)
def test_the_delay_of_a_filter_and_a_dead_time_are_found(function: Damper, rate_Hz: float, delay_s: float) -> None:
    result = probed(function, rate_Hz)
    assert result.position_delay_s == pytest.approx((delay_s, delay_s), rel=0.05)
    assert "ms late" in result.findings[0].found


@pytest.mark.parametrize("order", [0, 2])
def test_a_spring_beside_the_damper_is_no_filter(order: int) -> None:
    def pressed(time_s: F, position_m: F, current_A: F) -> F:
        b, a = butter(order, 60.0, fs=1.0 / (time_s[1] - time_s[0])) if order else ([1.0], [1.0])
        moved = position_m[0] + lfilter(b, a, position_m - position_m[0])
        return held(time_s, moved, current_A) + 1e4 * moved

    assert probed(pressed, 1000.0).position_delay_s[0] == pytest.approx(3.75e-3 if order else 0.0, rel=0.05)


def test_the_lag_of_a_soft_damper_is_no_filter() -> None:
    result = probed(sprung, 1000.0)
    assert result.position_delay_s[0] < 0.6e-3 < result.position_delay_s[1]  # half a sample: it interpolates the stroke


def test_a_hydraulic_damper_has_no_delay_of_its_own(tmp_path: Path) -> None:
    """The rig interpolates the current, and smooths a noisy position at 70 Hz without delay; a filter adds its own."""
    path = tmp_path / "rig.yaml"
    path.write_text("seal: {viscous_Ns_m: 30.0}\n")
    rig = load_rig(path)

    def behind_a_filter(time_s: F, position_m: F, current_A: F) -> F:
        b, a = butter(2, 60.0, fs=1.0 / (time_s[1] - time_s[0]))
        return rig(time_s, position_m[0] + lfilter(b, a, position_m - position_m[0]), current_A)

    own, late = probed(rig, 1000.0), probed(behind_a_filter, 1000.0)
    assert own.current_convention == INTERPOLATED and own.position_delay_s == (0.0, 0.0)
    assert own.noise_N == own.memory_N == 0.0
    assert 2e-3 < late.position_delay_s[0] <= late.position_delay_s[1] < 3.8e-3  # of 3.75 ms less the damper's lead


def test_noise_is_measured_and_hides_what_is_smaller() -> None:
    rng = np.random.default_rng(1)

    def noisy(time_s: F, position_m: F, current_A: F) -> F:
        return held(time_s, position_m, current_A) + 20.0 * rng.standard_normal(len(time_s))

    def seeded(time_s: F, position_m: F, current_A: F) -> F:
        return held(time_s, position_m, current_A) + 20.0 * np.random.default_rng(2).standard_normal(len(time_s))

    result, same = probed(noisy), probed(seeded)
    assert result.noise_N == pytest.approx(20.0, rel=0.1) and result.memory_N == 0.0
    assert result.current_convention == UNCLEAR and not result.timing
    assert same.noise_N == pytest.approx(20.0, rel=0.3)


def test_a_state_between_calls_is_found() -> None:
    last = [0.0]

    def warming(time_s: F, position_m: F, current_A: F) -> F:
        before, last[0] = last[0], float(np.ptp(position_m)) + float(position_m[-1])
        return held(time_s, position_m, current_A) + 1e3 * before * np.exp(-time_s)

    result = probed(warming)
    assert result.memory_N > 1.0 and result.noise_N == 0.0
    assert "order" in result.findings[-1].meaning


def test_what_cannot_be_probed_says_why() -> None:
    trace = open_trace(simulation(static), recording(), False)

    def refusing(time_s: F, position_m: F, current_A: F) -> F:
        raise CesError("only strokes of a road")

    class Mistaken(Simulation):
        def force(self, recording: Recording) -> F:
            raise TypeError("a mistake of the program")

    result, gone = probe(RecordedSimulation("/force"), trace), probe(simulation(refusing), trace)
    assert result.calls == 0 and "recorded predictions" in result.summary
    assert "only strokes of a road" in gone.summary and gone.findings == ()
    assert "not available: TypeError: a mistake of the program" in probe(Mistaken(), trace).summary


def test_a_constant_current_and_a_slow_sampling_leave_questions_open() -> None:
    still = recording(static)
    channel = still.channel("current")
    constant = replace(channel, values=np.full(len(channel), 0.5))
    trace = open_trace(simulation(static), replace(still, channels={**still.channels, "current": constant}), False)
    result = probe(simulation(interpolating), trace)
    assert result.current_convention == UNCLEAR and not result.timing and result.calls == 3
    slow = probed(static, 100.0)
    assert slow.current_convention == STATIC and np.isnan(slow.position_delay_s[1])


@pytest.mark.parametrize("rate_Hz", [40.0, 99.7, 316.3, 2000.0])
def test_no_sample_rate_is_an_obstacle(rate_Hz: float) -> None:
    """Real stamps jitter, a rate is no round number, and a force may vanish at low speed."""

    def loose(time_s: F, position_m: F, current_A: F) -> F:
        speed = np.gradient(position_m, time_s)
        return np.asarray(np.where(np.abs(speed) < 0.08, 0.0, interpolating(time_s, position_m, current_A)))

    known = recording(static, rate_Hz=rate_Hz)
    jitter = np.random.default_rng(3).integers(-50_000, 50_000, len(known.channel("position")))
    channels = {n: replace(c, stamps_ns=c.stamps_ns + jitter) for n, c in known.channels.items()}
    result = probe(simulation(loose), open_trace(simulation(static), replace(known, channels=channels), False))
    assert ("not probed" in result.summary) == (rate_Hz < 80.0)
    assert rate_Hz < 80.0 or result.current_lead_samples == pytest.approx(0.5, abs=0.12)


def test_a_correction_that_the_recordings_contradict_is_not_made() -> None:
    """The real current is interpolated, too; and a model has learnt the timing of its inputs."""
    own = simulation(interpolating)
    real = open_trace(own, recording(interpolating), False)
    result, used = correct_inputs(own, [real], [])
    assert result.timing and not result.corrected and used is own
    assert "not corrected" in result.findings[0].meaning
    model = ModelSimulation(fitted_model("hydraulic"))
    result, used = correct_inputs(model, [real], [])
    assert used is model and result.is_learnt and not result.corrected
    assert result.findings == () and "keeps the timing" in result.summary


def test_references_decide_on_a_correction() -> None:
    own = simulation(interpolating)
    real, reference = (open_trace(own, recording(of, 2), False) for of in (interpolating, held))
    result, used = correct_inputs(own, [real], [reference])
    assert result.corrected.current_lead_samples == pytest.approx(0.5, abs=0.1)
    assert isinstance(used, RetimedSimulation) and used.innermost is own


@pytest.mark.parametrize(
    ("function", "timing"),
    [
        (interpolating, InputTiming(0.5 - 0.5 / FINER, 0.0)),
        (backward, InputTiming(1.0, 0.0)),
        (late_by_three, InputTiming(0.0, 3.0 / RATE_HZ)),
    ],
)
def test_a_corrected_simulation_answers_on_time(function: Damper, timing: InputTiming) -> None:
    real = recording(held, noise_N=0.0)
    inner, truth = slice(100, -100), real.channel("force").values
    off, left = (
        np.std((sim.force(real) - truth)[inner])
        for sim in (simulation(function), RetimedSimulation(simulation(function), timing))
    )
    assert left < 0.3 * off


def run(function: Damper, noise_N: float = 3.0) -> Diagnosis:
    """Diagnose a simulation of the held damper, with nothing withheld."""
    real, held_out = [recording(held, seed, noise_N) for seed in (1, 2)], [recording(held, 3, noise_N)]
    return diagnose(simulation(function), "here:f", real, held_out, (), DiagnoseOptions(experiment=False))


@pytest.fixture
def fast(monkeypatch: pytest.MonkeyPatch) -> None:
    """No simulation is slow."""
    monkeypatch.setattr(TwinLimits, "SLOW_S", 60.0)
    monkeypatch.setattr(TwinLimits, "SLOW_CLOCK_S", 60.0)


@pytest.mark.slow
def test_a_filter_inside_is_no_position_delay(fast: None, tmp_path: Path) -> None:
    result = run(partial(low_passed, order=1))
    assert result.verdict == NO_GAP and result.composition.effects == ()
    assert result.gap.rms_N > 30.0 > 10.0 * result.gap.corrected_N  # the gap is that of the simulation as it is run
    assert result.probe.corrected.position_delay_s == pytest.approx(2.6e-3, rel=0.1)
    assert "beyond the timing" in result.sentence
    files = result_files(result, {"spec": "here:f", "sha256": None}, ())
    assert "What the simulation does to its inputs" in files["report.html"] and "ms late" in files["report.html"]
    told = json.loads(files["gap.json"])["input_probe"]
    assert told["corrected"]["position_delay_s"] == pytest.approx(result.probe.corrected.position_delay_s, rel=1e-4)
    path = tmp_path / "augmented.json"
    path.write_text(files["augmented.json"])
    again = load_augmented(path, lambda spec: simulation(partial(low_passed, order=1)))
    real = recording(held, 3)
    assert np.std((again.force(real) - real.channel("force").values)[100:-100]) < 4.0
    path.write_text(files["augmented.json"].replace('"position_delay_s": 0.0', '"position_delay_s": 9'))
    with pytest.raises(CesError, match="position_delay_s"):
        load_augmented(path, lambda spec: simulation(held))


@pytest.mark.slow
def test_an_interpolated_current_is_no_valve_lag(fast: None) -> None:
    result = run(interpolating, 1.0)
    assert result.verdict == NO_GAP and result.composition.effects == ()
    assert result.gap.rms_N > 3.0 * result.gap.corrected_N
    assert result.probe.corrected.current_lead_samples == pytest.approx(0.5, abs=0.1)
