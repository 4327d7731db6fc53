"""Checks that a diagnosis is possible: recordings and traces in, notes for the user out; GapError if it is not.

A saturated force is not used, a simulation far outside its range or in a wrong unit or sign is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ces_data.checks.check import check_each, require_consistent
from ces_data.checks.content import find_known_recording, shared_content
from ces_data.checks.sensors import SATURATES, describe_saturations, find_saturations
from ces_data.findings import SaturationFinding
from ces_data.recording import Recording
from ces_gap.effects.effect import Effect
from ces_gap.errors import GapError
from ces_gap.grid import is_constant, rms
from ces_gap.limits import AgreementLimits, DiagnosisLimits
from ces_gap.trace import Trace, usable_inputs, usable_values
from ces_identify.limits import LackLimits
from ces_identify.simulations.simulate import is_outside, sample_run
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.validation.evaluate import describe_held, find_outside
from ces_observer.errors import OptionName
from ces_observer.model import Model

AROUND_S = 0.01  # [s] on both sides of a saturated sample that filters spread it over
REAL, HELD_OUT, REFERENCE = map(OptionName, ("real", "held_out", "reference"))
WHY = {
    HELD_OUT: "held-out recordings must not be fitted; without any, a part of the real ones is set aside",
    REFERENCE: "references must be free of the effect",
}


@dataclass(frozen=True)
class ForceUnit:
    """A ratio of measured to simulated force with its explanation; `rough` ones may be far off (`ROUGH`).

    `measured` if the measured force is in another unit than N, otherwise the simulated one is.
    """

    factor: float
    description: str
    rough: bool = False
    measured: bool = False


UNITS = (
    ForceUnit(1e3, "the simulation's force is in kN", rough=True),
    ForceUnit(1e-3, "the measured force is in kN, or the simulation's in mN", rough=True, measured=True),
    ForceUnit(4.4482216, "the simulation's force is in lbf"),
    ForceUnit(1.0 / 4.4482216, "the measured force is in lbf", measured=True),
    ForceUnit(9.80665, "the simulation's force is in kgf"),
    ForceUnit(1.0 / 9.80665, "the measured force is in kgf", measured=True),
    ForceUnit(9.80665e-3, "the simulation's force is in gf"),
    ForceUnit(1.0 / 9.80665e-3, "the measured force is in gf", measured=True),
)


def check_recordings(
    real: Sequence[Recording], held_out: Sequence[Recording], reference: Sequence[Recording]
) -> tuple[str, ...]:
    """Return notes on the recordings as logged.

    Raises GapError for recordings with seconds in common, a missing force or one that saturates for more than
    `RecordingLimits.MAX_SATURATED`, RecordingError if units or signs differ between recordings.
    """
    require_distinct(real, held_out, reference)
    everything = [*real, *held_out, *reference]
    for recording in everything:
        if "force" not in recording.channels:
            raise GapError(f"{recording.name}: no measured force; a diagnosis needs one: map it in the signals file")
    require_consistent(everything)
    findings = [f for f in check_each(everything) if not (isinstance(f, SaturationFinding) and f.signal == "force")]
    notes = [finding.text for finding in findings]
    for recording in everything:
        if limits := find_saturations(recording):
            text = f"{recording.name}: force: {SATURATES}: {describe_saturations(limits)}"
            if sum(s.share for s in limits) > DiagnosisLimits.MAX_SATURATED:
                most = f"expected at most {DiagnosisLimits.MAX_SATURATED:.0%}"
                raise GapError(f"{text}; {most}: record again with a larger range")
            notes.append(f"{text}; they are not used; record with a larger range")
    return tuple(notes)


def require_distinct(real: Sequence[Recording], held_out: Sequence[Recording], reference: Sequence[Recording]) -> None:
    """Raise GapError for duplicate recordings: a model validated on its fitting data would seem perfect."""
    recordings = [*((REAL, r) for r in real), *((HELD_OUT, r) for r in held_out), *((REFERENCE, r) for r in reference)]
    for (role, recording), (other_role, another) in combinations(recordings, 2):
        if shared := shared_content(recording, another):
            names = recording.name if recording.name == another.name else f"{recording.name} and {another.name}"
            if role == other_role:
                raise GapError(f"{names}: {shared}, twice under ", role, "; pass each recording once")
            raise GapError(f"{names}: {shared}, under ", role, " and ", other_role, f"; {WHY[other_role]}")


def exclude_saturated_ticks(trace: Trace) -> Trace:
    """Return the trace with the ticks near saturated samples marked unusable."""
    limits = find_saturations(trace.recording) if "force" in trace.recording.channels else ()
    if not limits:
        return trace
    force = trace.recording.channel("force")
    flat = np.isin(force.values, [s.limit for s in limits])
    start = int(trace.recording.channel("position").stamps_ns[0])
    seconds = np.sort((force.stamps_ns[flat] - start) * 1e-9)
    begin = np.searchsorted(seconds, trace.time_s - AROUND_S)
    near = begin < np.searchsorted(seconds, trace.time_s + AROUND_S, side="right")
    return replace(trace, usable=trace.usable & ~near)


def check_traces(traces: Sequence[Trace], simulation: Simulation, name: str) -> tuple[str, ...]:
    """Return notes on the simulation `name` compared with the measurements.

    Raises GapError if it has the wrong sign or unit, or if the recordings lie outside its range.
    """
    agreement = compare_forces(traces)
    require_same_sign_and_unit(agreement, name)
    notes = list(outside_notes(traces, simulation, name))
    if abs(agreement.correlation) < AgreementLimits.MIN_CORRELATION:
        notes.append(
            f"the force of {name} hardly correlates with the measured one (correlation {agreement.correlation:.2f}): "
            "check that it simulates this damper and that the signals are mapped correctly"
        )
    notes += missing_force_notes(traces, name)
    for trace in traces:
        speed = float(np.percentile(np.abs(trace.inputs.speed[trace.usable]), 99.0))
        if speed < DiagnosisLimits.MIN_SPEED_M_S:
            notes.append(f"{trace.name}: hardly moves (99 % of the time below {speed:.2g} m/s)")
    if is_current_constant(traces):
        level = float(np.mean([t.inputs.current[t.usable].mean() for t in traces]))
        notes.append(f"the current stays at {level:.3g} A: effects of the valve are not visible")
    return tuple(notes)


@dataclass(frozen=True)
class ForceAgreement:
    """Agreement of the forces: correlation, gain (slope of the reduced major axis), RMS [N] of both."""

    correlation: float
    gain: float
    measured_N: float
    simulated_N: float


def compare_forces(traces: Sequence[Trace]) -> ForceAgreement:
    """Compare measured and simulated force on all usable ticks."""
    measured = usable_values(traces, [t.force for t in traces])
    simulated = usable_values(traces, [t.simulated for t in traces])
    f, s = measured - measured.mean(), simulated - simulated.mean()
    spread_f, spread_s = rms(f), rms(s)
    if spread_f == 0.0 or spread_s == 0.0:
        return ForceAgreement(0.0, np.nan, spread_f, spread_s)
    correlation = float(np.mean(f * s)) / (spread_f * spread_s)
    return ForceAgreement(correlation, float(np.sign(correlation)) * spread_f / spread_s, spread_f, spread_s)


def require_same_sign_and_unit(agreement: ForceAgreement, name: str) -> None:
    """Raise GapError if the simulation `name` has the wrong sign, the wrong unit, or a constant force."""
    measured_N, simulated_N = agreement.measured_N, agreement.simulated_N
    if measured_N == 0.0 or simulated_N == 0.0:
        force = "the measured force" if measured_N == 0.0 else f"the force of {name}"
        raise GapError(f"{force} is constant; expected a force that changes with the stroke: check topic and field")
    unit, inverted = _find_unit(agreement), agreement.correlation <= -AgreementLimits.MIN_CORRELATION
    if unit is None and not inverted:
        if not 1.0 / AgreementLimits.IMPOSSIBLE < measured_N / simulated_N < AgreementLimits.IMPOSSIBLE:
            raise GapError(
                f"{name}: its force changes by {simulated_N:.3g} N RMS, the measured one by {measured_N:.3g} N; "
                "expected the same damper in the same unit: check the units of the simulation and of the signals file"
            )
        return
    sign, what = (-1.0 if inverted else 1.0), "the simulated force has the opposite sign of the measured one"
    remedy = "invert the simulation's output, or set scale: -1.0 for position or force in the signals file"
    if unit is not None:
        what = f"{what} and {unit.description}" if inverted else unit.description
        remedy = f"multiply the simulation's output by {sign * unit.factor:.6g}"
        if unit.measured:
            remedy = f"set scale: {sign / unit.factor:.6g} for force in the signals file"
    raise GapError(
        f"{name}: {what} (measured over simulated is {agreement.gain:.4g}, correlation {agreement.correlation:.2f}); "
        f"expected N, position and force positive in compression: {remedy}"
    )


def _find_unit(agreement: ForceAgreement) -> ForceUnit | None:
    """Return the unit that explains the gain, None if none does or the forces do not correlate."""
    sure = abs(agreement.correlation)
    for unit in UNITS if sure >= AgreementLimits.MIN_CORRELATION else ():
        off = abs(np.log(abs(agreement.gain) / unit.factor))
        least = AgreementLimits.MIN_CORRELATION if unit.rough else AgreementLimits.SURE
        if sure >= least and off < (np.log(AgreementLimits.ROUGH) if unit.rough else AgreementLimits.NEAR):
            return unit
    return None


def outside_notes(traces: Sequence[Trace], simulation: Simulation, name: str) -> Iterator[str]:
    """Yield a note, with the worst input, for each recording that is often outside the range of the simulation.

    And one for each on which the force of the model inside it was held at its envelope.
    Raises GapError if all together are outside for more than `LackLimits.MAX_OUTSIDE` of the time.
    """
    model = model_inside(simulation)
    if model is None:
        return
    outside: dict[str, tuple[float, str]] = {}  # share of usable ticks, and the ranges of the inputs that are outside
    for trace in traces:
        values = {signal: getattr(trace.inputs, signal)[trace.usable] for signal in ("position", "speed", "current")}
        beyond = np.zeros(int(trace.usable.sum()), bool)
        for signal in model.used_ranges:
            beyond |= is_outside(model, signal, values[signal], AgreementLimits.RANGE_SLACK)
        outside[trace.name] = float(beyond.mean()), "; ".join(map(str, find_outside(model, values)))
    ticks = np.array([int(t.usable.sum()) for t in traces])
    overall = float(ticks @ [outside[t.name][0] for t in traces]) / max(int(ticks.sum()), 1)
    if overall > LackLimits.MAX_OUTSIDE:
        worst = max(outside, key=lambda n: outside[n][0])
        raise GapError(
            f"{name}: outside the range it was identified on for {overall:.0%} of the time, most in {worst} "
            f"({outside[worst][1]}); expected an overlap: identify on recordings like these, or diagnose on others"
        )
    for recording, (share, where) in outside.items():
        if share > AgreementLimits.NOTED_OUTSIDE:
            yield (
                f"{recording}: {share:.0%} of the time outside the range {name} was identified on ({where}); part of "
                "the gap is extrapolation"
            )
    for recording, run in {trace.name: sample_run(model, trace.recording) for trace in traces}.items():
        if text := describe_held(recording, *run.held_at(np.isfinite(run.force))):
            yield text


def missing_force_notes(traces: Sequence[Trace], name: str) -> Iterator[str]:
    """Yield a note for each recording with many unusable ticks; traces of one recording count together."""
    wholes: list[tuple[Trace, NDArray[np.bool_]]] = []
    for trace in traces:
        if wholes and wholes[-1][0].recording is trace.recording:
            wholes[-1] = trace, wholes[-1][1] | trace.usable
        else:
            wholes.append((trace, trace.usable))
    for trace, usable in wholes:
        share = 1.0 - float(usable.mean())
        if share > DiagnosisLimits.MAX_UNUSED:
            yield (
                f"{trace.name}: {share:.0%} of the time is not used: position, current, measured force or the force of "
                f"{name} is missing"
            )


def seen_notes(traces: Sequence[Trace], simulation: Simulation, name: str) -> tuple[str, ...]:
    """Return a note for each recording that the simulation, a model or a wrapped one, was identified on."""
    seen = sorted({t.name for t in traces if is_seen(t.recording, simulation)})
    return tuple(
        f"{recording}: {name} was identified on seconds of this recording: it has learned part of the gap, so that the "
        "gap found here is smaller than on new recordings, and effects may be missing; identify it on references, or "
        "diagnose on other recordings"
        for recording in seen
    )


def is_seen(recording: Recording, simulation: Simulation) -> bool:
    """Return whether the model inside a simulation was identified on seconds of a recording."""
    model = model_inside(simulation)
    return model is not None and bool(find_known_recording(recording, model.provenance))


def model_inside(simulation: Simulation) -> Model | None:
    """Return the model inside a simulation, None if there is none."""
    inside = simulation.innermost
    return inside.model if isinstance(inside, ModelSimulation) else None


def is_current_constant(traces: Sequence[Trace]) -> bool:
    """True if the current is constant within and between recordings."""
    current = usable_inputs(traces, "current")
    return bool(len(current)) and is_constant(current, DiagnosisLimits.MIN_CURRENT_A)


def find_invisible_effects(effects: Sequence[Effect], traces: Sequence[Trace]) -> tuple[tuple[str, str], ...]:
    """Return the effects that are not visible in these recordings in any form, each with the reason.

    The criterion is the current that an effect's `needs` requires: changing, reversing or other than zero.
    """
    if not is_current_constant(traces):
        return ()
    level = float(np.abs(usable_inputs(traces, "current")).mean())
    is_zero = level <= DiagnosisLimits.MIN_CURRENT_A
    visible = {e.name for e in effects if "current" not in e.needs or ("zero" in e.needs and not is_zero)}
    by_name = {e.name: e for e in reversed(effects)}  # the first form of each
    names = [name for name in dict.fromkeys(e.name for e in effects) if name not in visible]
    return tuple((name, f"it needs {by_name[name].needs}; the current stays at {level:.3g} A") for name in names)
