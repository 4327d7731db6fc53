"""What probes found in a simulation: numbers, what was corrected, and the sentences of the report."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ces_gap.baseline.wrappers import MAX_DELAY_S, MAX_LEAD_SAMPLES, ON_TIME, InputTiming
from ces_gap.limits import ProbeLimits

STATIC, HELD, INTERPOLATED, EARLY, LATE, UNCLEAR = "static", "held", "interpolated", "early", "late", "unclear"


@dataclass(frozen=True)
class ProbeFinding:
    """One line of the report: what was asked, the answer, and a sentence that says what it means."""

    about: str
    found: str
    meaning: str
    is_corrected: bool = False


@dataclass(frozen=True)
class SimulationProbe:
    """What a simulation does to its inputs.

    `current_convention` is one of those above, `current_lead_samples` how much earlier than to a held current it
    answers (NaN if unknown). `position_delay_s` is the delay of a filter inside, between a value that is certain and
    one that is not exceeded. `noise_N` (RMS) differs between equal calls or makes a force at constant speed and current
    rough, `memory_N` depends on earlier calls. `corrected` was undone before the diagnosis; nothing is if the timing
    `is_learnt`, as that of an identified model. `note` says why the simulation could not be probed.
    """

    current_convention: str = UNCLEAR
    current_lead_samples: float = math.nan
    sample_s: float = math.nan
    position_delay_s: tuple[float, float] = (0.0, math.nan)
    noise_N: float = 0.0
    memory_N: float = 0.0
    calls: int = 0
    seconds: float = 0.0
    corrected: InputTiming = ON_TIME
    is_learnt: bool = False
    note: str = ""

    @property
    def current_lead_s(self) -> float:
        """The lead of the current [s] at the sample interval of the probe."""
        return self.current_lead_samples * self.sample_s

    @property
    def findings(self) -> tuple[ProbeFinding, ...]:
        """What was found, nothing if the simulation takes its inputs as they are."""
        return tuple(_describe(self))

    @property
    def summary(self) -> str:
        """What was done, in one sentence or two."""
        if not self.calls:
            return self.note or "The simulation was not probed."
        text = f"{self.calls} short synthetic recordings, {self.seconds:.1f} s"
        if self.note:
            return f"Probed with {text}: {self.note}."
        if self.is_learnt:
            return f"Probed with {text}: the model keeps the timing with which it was identified."
        if self.findings:
            return f"Probed with {text}. The reported gap is that of the simulation as it is."
        return f"Nothing found with {text}: current {self.current_convention}, no delay of the position."

    @property
    def timing(self) -> InputTiming:
        """The timing that can be undone, at its certain values."""
        lead, delay_s = self.current_lead_samples, self.position_delay_s[0]
        is_lead = math.isfinite(lead) and ProbeLimits.MIN_SHIFT_SAMPLES <= abs(lead) <= MAX_LEAD_SAMPLES
        return InputTiming(round(lead, 2) if is_lead else 0.0, min(delay_s, MAX_DELAY_S))


NOT_PROBED = SimulationProbe()
CURRENT_MEANINGS = {
    STATIC: "answers at once, without a memory of the current",
    HELD: "holds the current between samples, as a real driver does",
    INTERPOLATED: "interpolates the current where a driver holds it: the answer begins before the step",
    EARLY: "takes the current of a later sample: the answer comes before the step",
    LATE: "takes the current of an earlier sample",
    UNCLEAR: "not visible: the current is constant, has no influence, or the answer is hidden in noise",
}


def _describe(probe: SimulationProbe) -> Iterator[ProbeFinding]:
    """Yield a finding for each question whose answer is not what it should be."""
    done, lead, (delay_s, highest_s) = probe.corrected, probe.current_lead_samples, probe.position_delay_s
    if probe.is_learnt:
        lead, delay_s = 0.0, 0.0
    if abs(lead) >= ProbeLimits.MIN_SHIFT_SAMPLES:  # not if it is unknown
        text = f"{abs(lead):.2g} samples ({1e3 * abs(probe.current_lead_s):.2g} ms) {'early' if lead > 0.0 else 'late'}"
        corrected = _say_corrected(bool(done.current_lead_samples), "valve lag")
        meaning = f"{CURRENT_MEANINGS[probe.current_convention]}; {corrected}"
        yield ProbeFinding("Current", text, meaning, bool(done.current_lead_samples))
    if delay_s > 0.0:
        upto = f" to {1e3 * highest_s:.2g}" if highest_s > 1.1 * delay_s else ""
        why = "the force lags by this at every damping, as behind a filter or a dead time"
        corrected = _say_corrected(bool(done.position_delay_s), "position delay")
        is_corrected = bool(done.position_delay_s)
        yield ProbeFinding("Position", f"{1e3 * delay_s:.2g}{upto} ms late", f"{why}; {corrected}", is_corrected)
    if probe.noise_N > 0.0:
        why = "equal calls differ, or the force is rough at constant speed and current: a part of the gap is this noise"
        yield ProbeFinding("Noise", f"{probe.noise_N:.2g} N RMS", why)
    if probe.memory_N > 0.0:
        why = "equal calls differ after another one: the simulation keeps a state, so results depend on their order"
        yield ProbeFinding("Earlier calls", f"{probe.memory_N:.2g} N RMS", why)


def _say_corrected(corrected: bool, effect: str) -> str:
    if corrected:
        return f"corrected, so that {effect} counts beyond it"
    return "not corrected: the simulation would come no closer"
