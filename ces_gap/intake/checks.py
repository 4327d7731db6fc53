"""Checks that a diagnosis is possible: recordings and traces in, notes for the user out; GapError if it is not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.effect import Effect
from ces_gap.errors import GapError
from ces_gap.intake.force_units import MIN_CORRELATION, compare_forces, require_same_sign_and_unit
from ces_gap.intake.operating_range import model_inside, outside_notes
from ces_gap.intake.saturation import saturation_notes
from ces_gap.trace import SEEN, F, Trace
from ces_identify.recordings.recording import Recording
from ces_identify.sense.consistency import require_consistent
from ces_identify.sense.content import find_known_recording, shared_content
from ces_identify.sense.saturation import SATURATES
from ces_identify.sense.sense import sense_each
from ces_identify.simulations.simulation import Simulation

SAME_CURRENT = 0.02  # relative spread below which a current counts as constant
NO_CURRENT = 1e-3  # [A] below it a current counts as zero
NO_FORCE = 0.2  # share of unusable ticks from which there is a note
SLOW_M_S = 0.01  # [m/s] a recording of slower motion contains hardly any information
REAL, HELD_OUT, REFERENCE = "--real", "--held-out", "--reference"


def require_distinct(real: Sequence[Recording], held_out: Sequence[Recording], reference: Sequence[Recording]) -> None:
    """Raise GapError for duplicate recordings: a model validated on its fitting data would seem perfect."""
    recordings = [*((REAL, r) for r in real), *((HELD_OUT, r) for r in held_out), *((REFERENCE, r) for r in reference)]
    for (one, first), (other, second) in combinations(recordings, 2):
        if shared := shared_content(first, second):
            raise GapError(_describe_duplicate(one, first, other, second, str(shared)))


def check_recordings(
    real: Sequence[Recording], held_out: Sequence[Recording], reference: Sequence[Recording]
) -> tuple[str, ...]:
    """Return notes on the recordings as logged.

    Raises GapError for recordings with seconds in common or a missing force, RecordingError if units or signs differ
    between recordings.
    """
    require_distinct(real, held_out, reference)
    everything = [*real, *held_out, *reference]
    for recording in everything:
        if "force" not in recording.channels:
            raise GapError(f"{recording.name}: no measured force; a diagnosis needs one: map it in the signals file")
    require_consistent(everything)
    notes = [finding.text for finding in sense_each(everything) if f"force: {SATURATES}" not in finding.text]
    return (*notes, *(note for recording in everything for note in saturation_notes(recording)))


def check_traces(traces: Sequence[Trace], simulation: Simulation, name: str) -> tuple[str, ...]:
    """Return notes on the simulation `name` compared with the measurements.

    Raises GapError if it has the wrong sign or unit, or if the recordings lie outside its range.
    """
    require_same_sign_and_unit(traces, name)
    notes = [*outside_notes(traces, simulation, name), *_correlation_notes(traces, name)]
    notes += [*_missing_force_notes(traces, name), *_slow_motion_notes(traces)]
    if is_current_constant(traces):
        level = float(np.mean([t.inputs.current[t.usable].mean() for t in traces]))
        notes.append(f"the current stays at {level:.3g} A: effects of the valve are not visible")
    return tuple(notes)


def seen_notes(traces: Sequence[Trace], simulation: Simulation, name: str) -> tuple[str, ...]:
    """Return a note for each recording that the simulation, a model or a wrapped one, was identified on."""
    seen = sorted({t.name for t in traces if is_seen(t.recording, simulation)})
    return tuple(
        f"{recording}: {name} {SEEN}: it has learned part of the gap, so that the "
        "gap found here is smaller than on new recordings, and effects may be missing; identify it on references, or "
        "diagnose on other recordings"
        for recording in seen
    )


def is_seen(recording: Recording, simulation: Simulation) -> bool:
    """Return whether the model inside a simulation was identified on seconds of a recording."""
    model = model_inside(simulation)
    return model is not None and bool(find_known_recording(recording, model.provenance))


def is_current_constant(traces: Sequence[Trace]) -> bool:
    """True if the current is constant within and between recordings."""
    current = _current(traces)
    return bool(len(current)) and float(current.std()) <= SAME_CURRENT * max(abs(float(current.mean())), NO_CURRENT)


def find_invisible_effects(effects: Sequence[Effect], traces: Sequence[Trace]) -> tuple[tuple[str, str], ...]:
    """Return the effects that are not visible in these recordings in any form, each with the reason.

    The criterion is the current that an effect's `needs` requires: changing, reversing or other than zero.
    """
    reasons: dict[str, str] = {}
    visible: set[str] = set()
    for effect in effects:
        reason = explain_invisibility(effect, traces)
        if reason is None:
            visible.add(effect.name)
        else:
            reasons.setdefault(effect.name, reason)
    return tuple((name, reason) for name, reason in reasons.items() if name not in visible)


def explain_invisibility(effect: Effect, traces: Sequence[Trace]) -> str | None:
    """Return the reason why this form of an effect is not visible in the recordings, None if it is visible."""
    if "current" not in effect.needs or not is_current_constant(traces):
        return None
    level = float(np.abs(_current(traces)).mean())
    if "zero" in effect.needs and level > NO_CURRENT:
        return None
    return f"it needs {effect.needs}; the current stays at {level:.3g} A"


def _describe_duplicate(one: str, first: Recording, other: str, second: Recording, shared: str) -> str:
    names = first.name if first.name == second.name else f"{first.name} and {second.name}"
    if one == other:
        return f"{names}: {shared}, twice under {one}; pass each recording once"
    why = {
        HELD_OUT: "held-out recordings must not be fitted: without --held-out a part of --real is set aside",
        REFERENCE: "references must be free of the effect",
    }
    return f"{names}: {shared}, under {one} and {other}; {why[other]}"


def _current(traces: Sequence[Trace]) -> F:
    return np.concatenate([t.inputs.current[t.usable] for t in traces])


def _correlation_notes(traces: Sequence[Trace], name: str) -> Iterator[str]:
    correlation = compare_forces(traces).correlation
    if abs(correlation) < MIN_CORRELATION:
        yield (
            f"the force of {name} hardly correlates with the measured one (correlation {correlation:.2f}): check "
            "that it simulates this damper and that the signals are mapped correctly"
        )


def _missing_force_notes(traces: Sequence[Trace], name: str) -> Iterator[str]:
    """Yield a note for each recording with many unusable ticks; traces of one recording count together."""
    wholes: list[tuple[Trace, NDArray[np.bool_]]] = []
    for trace in traces:
        if wholes and wholes[-1][0].recording is trace.recording:
            wholes[-1] = trace, wholes[-1][1] | trace.usable
        else:
            wholes.append((trace, trace.usable))
    for trace, usable in wholes:
        share = 1.0 - float(usable.mean())
        if share > NO_FORCE:
            yield (
                f"{trace.name}: {share:.0%} of the time is not used: position, current, measured force or the force of "
                f"{name} is missing"
            )


def _slow_motion_notes(traces: Sequence[Trace]) -> Iterator[str]:
    for trace in traces:
        speed = float(np.percentile(np.abs(trace.inputs.speed[trace.usable]), 99.0))
        if speed < SLOW_M_S:
            yield f"{trace.name}: hardly moves (99 % of the time below {speed:.2g} m/s)"
