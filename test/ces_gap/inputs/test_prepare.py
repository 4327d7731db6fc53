"""Preparation: held-out parts, refusal of short recordings, choice of the simulator."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from engine_plant import SIMULATION, F, add_predictions, damper, recorded, traced

from ces_data.recording import Recording
from ces_gap.baseline.plant import DirectSimulator
from ces_gap.baseline.twin import Twin
from ces_gap.errors import GapError
from ces_gap.grid import rms, thin_out
from ces_gap.inputs import prepare as prepare_module
from ces_gap.inputs.prepare import DiagnosisInput, prepare_recordings, set_aside
from ces_gap.limits import TwinLimits
from ces_gap.trace import Trace
from ces_identify.simulations.simulation import FunctionSimulation, RecordedSimulation


def prepare(real: list[Recording], held_out: list[Recording] | None = None, **more: list[Recording]) -> DiagnosisInput:
    return prepare_recordings(SIMULATION, real, held_out or [], more.get("reference", []))


@pytest.mark.parametrize(("count", "count_fitted"), [(2, 1), (3, 2), (7, 5)])
def test_the_last_third_of_the_recordings_is_set_aside(count: int, count_fitted: int) -> None:
    traces = [traced(seed=s, seconds=1.0) for s in range(count)]
    fitted, held = set_aside(traces)
    assert [t.name for t in fitted] == [t.name for t in traces[:count_fitted]]
    assert [t.name for t in held] == [t.name for t in traces[count_fitted:]]


@pytest.mark.parametrize("seconds", [4.0, 60.0])
def test_every_third_part_of_a_single_recording_is_set_aside(seconds: float) -> None:
    only = traced(seconds=seconds)
    (fitted,), (held,) = set_aside([only])
    np.testing.assert_array_equal(fitted.usable | held.usable, only.usable)
    assert not (fitted.usable & held.usable).any()
    assert 0.15 < held.usable.sum() / only.usable.sum() < 0.4
    switches = int(np.abs(np.diff(held.usable.astype(int))).sum())
    assert switches <= 8  # whole parts, not ticks here and there


def test_recordings_keep_their_roles() -> None:
    real, held_out, reference = [recorded(seed=s) for s in (1, 2)], [recorded(seed=3)], [recorded(seed=4)]
    inputs = prepare(real, held_out, reference=reference)
    assert [t.name for t in inputs.real] == ["made1", "made2"]
    assert [t.name for t in inputs.held_out] == ["made3"] and [t.name for t in inputs.reference] == ["made4"]
    assert [t.name for t in prepare(real).held_out] == ["made2"]


def test_a_fast_simulation_is_run_directly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TwinLimits, "SLOW_S", 60.0)
    monkeypatch.setattr(TwinLimits, "SLOW_CLOCK_S", 60.0)
    inputs = prepare([recorded()])
    assert isinstance(inputs.exact, DirectSimulator) and inputs.cheap is inputs.exact
    assert inputs.best is inputs.exact and inputs.slow is None


@pytest.mark.slow
def test_the_twin_replaces_a_slow_simulation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TwinLimits, "SLOW_S", 0.0)
    inputs = prepare([recorded(seed=1, seconds=5.0), recorded(seed=2, seconds=5.0)])
    assert isinstance(inputs.exact, DirectSimulator) and isinstance(inputs.twin, Twin)
    assert inputs.cheap is inputs.twin
    assert inputs.best is inputs.exact and inputs.slow is inputs.exact
    (trace, *_) = inputs.real
    weaker = trace.inputs.with_current(0.95 * trace.inputs.current)
    changed = inputs.exact.force(trace, weaker) - trace.simulated
    predicted = inputs.cheap.force(trace, weaker) - trace.simulated
    assert np.std((predicted - changed)[trace.usable]) < 0.5 * np.std(changed[trace.usable])


@pytest.mark.parametrize("each_time", [True, False])
def test_a_simulation_that_waits_each_time_is_slow(monkeypatch: pytest.MonkeyPatch, each_time: bool) -> None:
    """One that waits in the first measured run only was held up by something else."""
    now_s, readings = [0.0], [0]

    def read() -> float:
        readings[0] += 1
        return now_s[0]

    def wait(time_s: F, position_m: F, current_A: F) -> F:
        now_s[0] += 0.3 if each_time or readings[0] == 1 else 0.0
        return damper(time_s, position_m, current_A)

    monkeypatch.setattr(prepare_module, "time", SimpleNamespace(process_time=lambda: 0.0))
    nothing: Any = object()
    monkeypatch.setattr(prepare_module, "find_twin", lambda *_: nothing)
    monkeypatch.setattr(prepare_module, "clock_s", read)
    inputs = prepare_recordings(FunctionSimulation("waiting", wait), [recorded(seconds=6.5)], [], [])
    assert (inputs.slow is not None) == each_time
    assert inputs.cheap is (nothing if each_time else inputs.exact)


def test_the_twin_is_fitted_to_the_force_behind_corrected_inputs(monkeypatch: pytest.MonkeyPatch) -> None:
    def late(time_s: F, position_m: F, current_A: F) -> F:
        return damper(time_s, np.append(np.repeat(position_m[0], 3), position_m[:-3]), current_A)

    fitted: list[Trace] = []
    monkeypatch.setattr(prepare_module, "find_twin", lambda traces, *_: fitted.extend(traces))
    inputs = prepare_recordings(FunctionSimulation("late", late), [recorded()], [recorded(seed=2)], [])
    assert inputs.probe.corrected.position_delay_s == pytest.approx(0.006, abs=0.001)
    for trace in fitted:
        wanted = SIMULATION.force(trace.recording)
        assert rms(trace.simulated_at_base - wanted) < 0.1 * rms(wanted)
        np.testing.assert_array_equal(thin_out(trace.simulated_at_base, trace.base_grid[2]), trace.simulated)


@pytest.mark.slow
def test_recorded_predictions_cannot_be_rerun() -> None:
    recordings = [add_predictions(recorded(seed=s, seconds=5.0)) for s in (1, 2)]
    inputs = prepare_recordings(RecordedSimulation("/prediction"), recordings, [], [])
    assert inputs.exact is None and inputs.slow is None and inputs.best is inputs.cheap is inputs.twin
    assert inputs.twin is not None and 0.0 < inputs.twin.cost_J < 20.0


def spoil(signal: str, spoil: Callable[[F], F], seconds: float = 8.0) -> Recording:
    recording = recorded(seconds=seconds)
    channel = recording.channel(signal)
    return replace(recording, channels={**recording.channels, signal: replace(channel, values=spoil(channel.values))})


@pytest.mark.parametrize("signal", ["force", "current"])
def test_less_than_a_second_of_data_is_refused_by_name(signal: str) -> None:
    lost = spoil(signal, lambda values: np.where(np.arange(len(values)) < 300, values, np.nan))
    if signal == "current":
        lost = replace(
            lost, channels={**lost.channels, "current": lost.channel("current").select(np.arange(4000) < 50)}
        )
    with pytest.raises(GapError, match=r"made1.*expected at least 1 s") as messages:
        prepare([lost])
    assert "\n" not in str(messages.value)


def test_progress_is_reported_for_each_recording() -> None:
    messages: list[str] = []
    prepare_recordings(SIMULATION, [recorded()], [recorded(seed=2)], [], lambda what, share: messages.append(what))
    assert [name in what for name, what in zip(("made1", "made2"), messages, strict=False)] == [True, True]
