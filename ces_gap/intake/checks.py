"""What makes a diagnosis impossible or doubtful, told before any effect is tried.

Recordings, and their traces beside the simulation, go in; notes for people come out. What cannot be diagnosed raises
GapError in one line.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.effect import Effect
from ces_gap.errors import GapError
from ces_gap.intake.force_units import MIN_CORRELATION, compare_forces, require_same_sign_and_unit
from ces_gap.intake.operating_range import outside_notes
from ces_gap.intake.saturation import saturation_notes
from ces_gap.trace import F, Trace
from ces_identify.recordings.consistency import require_consistent
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation

SAME_CURRENT = 0.02  # spread of the current, over its mean, below which it counts as constant
NO_CURRENT = 1e-3  # [A] below which it counts as none
NO_FORCE = 0.2  # share of samples without a simulated force from which that is told
SLOW_M_S = 0.01  # [m/s] a damper that never moved faster shows next to nothing
REAL, HELD_OUT, REFERENCE = "--real", "--held-out", "--reference"


def require_distinct(real: Sequence[Recording], held_out: Sequence[Recording], reference: Sequence[Recording]) -> None:
    """Raise GapError if a recording was given twice: judged on what was fitted, no gap would seem left."""
    given = [*((REAL, r) for r in real), *((HELD_OUT, r) for r in held_out), *((REFERENCE, r) for r in reference)]
    for (one, first), (other, second) in combinations(given, 2):
        if _same(first, second):
            raise GapError(_describe_duplicate(one, first, other, second))


def check_recordings(
    real: Sequence[Recording], held_out: Sequence[Recording], reference: Sequence[Recording]
) -> tuple[str, ...]:
    """Return what is doubtful about the recordings as logged.

    Raises GapError if one was given twice or has no force, RecordingError if units or signs differ between them.
    """
    require_distinct(real, held_out, reference)
    everything = [*real, *held_out, *reference]
    for recording in everything:
        if "force" not in recording.channels:
            raise GapError(f"{recording.name}: no measured force; a diagnosis compares it with the simulation's")
    notes = [finding.text for finding in require_consistent(everything)]
    return (*notes, *(note for recording in everything for note in saturation_notes(recording)))


def check_traces(traces: Sequence[Trace], simulation: Simulation, name: str) -> tuple[str, ...]:
    """Return what is doubtful about the simulation beside what was measured; `name` is the simulation's.

    Raises GapError if it has the wrong sign or unit, or if the recordings lie outside what it was made for.
    """
    require_same_sign_and_unit(traces, name)
    notes = [*outside_notes(traces, simulation, name), *_correlation_notes(traces, name)]
    notes += [*_missing_force_notes(traces, name), *_slow_motion_notes(traces)]
    if is_current_constant(traces):
        level = float(np.mean([t.inputs.current[t.usable].mean() for t in traces]))
        notes.append(f"the current stays at {level:.3g} A: what the valve does cannot be seen")
    return tuple(notes)


def is_current_constant(traces: Sequence[Trace]) -> bool:
    """True if the current never changes, from recording to recording either."""
    current = _current(traces)
    return bool(len(current)) and float(current.std()) <= SAME_CURRENT * max(abs(float(current.mean())), NO_CURRENT)


def find_invisible_effects(effects: Sequence[Effect], traces: Sequence[Trace]) -> tuple[tuple[str, str], ...]:
    """Return the effects that these recordings cannot show in any form, each with the reason.

    An effect tells in its `needs` what it lives on; what is looked for there is a current that changes, turns back, or
    is there at all.
    """
    reasons: dict[str, str] = {}
    seen: set[str] = set()
    for effect in effects:
        reason = explain_invisibility(effect, traces)
        if reason is None:
            seen.add(effect.name)
        else:
            reasons.setdefault(effect.name, reason)
    return tuple((name, reason) for name, reason in reasons.items() if name not in seen)


def explain_invisibility(effect: Effect, traces: Sequence[Trace]) -> str | None:
    """Return why these recordings cannot show this form of an effect, None if they can."""
    if "current" not in effect.needs or not is_current_constant(traces):
        return None
    level = float(np.abs(_current(traces)).mean())
    if "zero" in effect.needs and level > NO_CURRENT:
        return None
    return f"it needs {effect.needs}; the current stays at {level:.3g} A"


def _same(one: Recording, other: Recording) -> bool:
    if one.sha256 and other.sha256:
        return one.sha256 == other.sha256
    return all(
        np.array_equal(one.channels[name].values, other.channels[name].values, equal_nan=True)
        for name in ("position", "force")
        if name in one.channels and name in other.channels
    )


def _describe_duplicate(one: str, first: Recording, other: str, second: Recording) -> str:
    names = first.name if first.name == second.name else f"{first.name} and {second.name}"
    if one == other:
        return f"{names}: the same recording twice under {one}; give each once"
    why = {
        HELD_OUT: "what is judged on must not have been fitted: leave --held-out away and a part is set aside",
        REFERENCE: "references are recordings free of the effect that is looked for",
    }
    return f"{names}: the same recording under {one} and {other}; {why[other]}"


def _current(traces: Sequence[Trace]) -> F:
    return np.concatenate([t.inputs.current[t.usable] for t in traces])


def _correlation_notes(traces: Sequence[Trace], name: str) -> Iterator[str]:
    correlation = compare_forces(traces).correlation
    if abs(correlation) < MIN_CORRELATION:
        yield (
            f"the force of {name} hardly goes with the measured one (correlation {correlation:.2f}): is it a "
            "simulation of this damper, and are the signals the right ones?"
        )


def _missing_force_notes(traces: Sequence[Trace], name: str) -> Iterator[str]:
    """Tell which recordings are not used in good part; those of one recording are parts of it."""
    wholes: list[tuple[Trace, NDArray[np.bool_]]] = []
    for trace in traces:
        if wholes and _same(wholes[-1][0].recording, trace.recording):
            wholes[-1] = trace, wholes[-1][1] | trace.usable
        else:
            wholes.append((trace, trace.usable))
    for trace, usable in wholes:
        share = 1.0 - float(usable.mean())
        if share > NO_FORCE:
            yield (
                f"{trace.name}: {share:.0%} of the time is left out: position, current, measured force or the force of "
                f"{name} is missing there"
            )


def _slow_motion_notes(traces: Sequence[Trace]) -> Iterator[str]:
    for trace in traces:
        speed = float(np.percentile(np.abs(trace.inputs.speed[trace.usable]), 99.0))
        if speed < SLOW_M_S:
            yield f"{trace.name}: hardly moves (99 % of the time below {speed:.2g} m/s)"
