"""The rows of the tables: one frozen dataclass for each table, one field for each column, with unit and meaning.

A missing value is NaN, an empty cell in CSV and null in JSON; `note` says why it is missing. `difference_...` is a
simulation's value minus the measured one over the same cycles, NaN in rows of the measurement.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from ces_data.reading import import_pandas
from ces_identify.characteristics.cycles import REASONS, Cycles
from ces_identify.characteristics.motion import MEASURED, RecordingMotion
from ces_identify.characteristics.rules import BenchRules
from ces_observer.errors import CesError, suggest
from ces_report.table import PrintedResult, column, whole, words

ALL = "all"
NO_CYCLES = (
    "no cycle repeats at a constant current: record sines, triangles or a slow sweep, each at a constant current "
    "('ces rig characterise' shows how); the bins of speed describe any motion"
)
NO_STEPS = "cannot know: the current has no steps"
NO_STEPS_READ = "cannot know: no step of the current while the piston moves at a constant speed; see the table of steps"


@dataclass(frozen=True, kw_only=True)
class ConditionRow:
    """What was recorded: source of the force, current, stroke, and the number of cycles."""

    source: str = words("`measured`, or the simulation", "Force")
    current_A: float = column("A", "mean current of the level", "Current", "current")
    current_width_A: float = column("A", "largest minus smallest mean current of the level's cycles")
    amplitude_m: float = column(
        "m", "mean amplitude: half the distance between the turning points", "Amplitude", "ampl.", milli=True
    )
    frequency_Hz: float = column("Hz", "mean frequency of the cycles", "Frequency", "freq.")
    cycles: int = whole("number of cycles", "Cycles", "cycles")


@dataclass(frozen=True, kw_only=True)
class PeakForce(ConditionRow):
    """The force of a stroke by the rules; by default at its peak speed (peak velocity pick-up)."""

    direction: str = words("compression or rebound", "Direction")
    target_m_s: float = column("m/s", "target speed that this one is within the tolerance of", "Target")
    speed_m_s: float = column("m/s", "mean speed where it is read, negative in rebound", "Speed", "speed")
    force_N: float = column("N", "mean force there", "Force", "force", digits=4, spread="sd")
    force_sd_N: float = column("N", "standard deviation between cycles")
    raw_N: float = column("N", "mean force without the gas force of the rules", "As logged", digits=4)
    difference_N: float = column("N", "simulated minus measured force", "Difference", "difference", spread="sd")
    difference_sd_N: float = column("N", "standard deviation of the difference between cycles")
    note: str = words("reason for an empty cell")


@dataclass(frozen=True, kw_only=True)
class CurrentForce(ConditionRow):
    """Force over current at a speed: branches of raised and lowered currents, hysteresis, linearity."""

    direction: str = words("compression or rebound", "Direction")
    target_m_s: float = column("m/s", "target speed")
    speed_m_s: float = column("m/s", "mean speed, negative in rebound", "Speed", "speed")
    force_N: float = column("N", "mean force of all cycles", "Force", "force", digits=4, spread="sd")
    force_sd_N: float = column("N", "standard deviation between cycles")
    raw_N: float = column("N", "mean force without the gas force of the rules")
    raised_N: float = column("N", "mean force where the current was raised to its level", "Raised", digits=4)
    lowered_N: float = column("N", "mean force where the current was lowered to its level", "Lowered", digits=4)
    width_N: float = column(
        "N", "magnetic hysteresis: how much more it resists where lowered", "Hysteresis", "hysteresis", spread="ci95"
    )
    width_ci95_N: float = column("N", "half its 95 % interval")
    width_share: float = column("1", "hysteresis over the range from soft to hard", "of the range", digits=2)
    linearity: float = column("1", "(F - F soft) / (F hard - F soft)", "Linearity", "linearity")
    difference_N: float = column("N", "simulated minus measured force", "Difference", "difference", spread="sd")
    difference_sd_N: float = column("N", "standard deviation of the difference between cycles")


@dataclass(frozen=True, kw_only=True)
class ControlRange:
    """Range and ratio of the force at a speed, from the softest to the hardest current."""

    source: str = words("`measured`, or the simulation", "Force", "force")
    direction: str = words("compression or rebound", "Direction")
    target_m_s: float = column("m/s", "target speed")
    speed_m_s: float = column("m/s", "mean speed, negative in rebound", "Speed", "speed")
    amplitude_m: float = column("m", "mean amplitude", "Amplitude", milli=True)
    frequency_Hz: float = column("Hz", "mean frequency", "Frequency")
    soft_A: float = column("A", "current of the softest setting", "Soft", "soft")
    hard_A: float = column("A", "current of the hardest setting", "Hard", "hard")
    soft_N: float = column("N", "force there", "F soft", digits=4)
    hard_N: float = column("N", "force there", "F hard", digits=4)
    range_N: float = column("N", "hard minus soft, as resistance", "Range", "range", digits=4, spread="ci95")
    range_ci95_N: float = column("N", "half its 95 % interval")
    ratio: float = column("1", "hard over soft", "Ratio", "ratio", spread="ci95")
    ratio_ci95: float = column("1", "half its 95 % interval")
    hysteresis_N: float = column("N", "largest of all currents", "Hysteresis", "hysteresis", spread="ci95")
    hysteresis_ci95_N: float = column("N", "half its 95 % interval")
    difference_N: float = column("N", "simulated minus measured range", "Difference", "difference")
    difference_ratio: float = column("1", "simulated minus measured ratio", "of the ratio")
    note: str = words("reason for an empty cell")


@dataclass(frozen=True, kw_only=True)
class ContinuousForce(ConditionRow):
    """Continuous force-speed diagram: both branches of a stroke at a share of its peak speed, and hysteresis."""

    direction: str = words("compression or rebound", "Direction")
    speed_m_s: float = column("m/s", "speed, negative in rebound")
    accelerating_N: float = column("N", "mean force while the speed rises")
    decelerating_N: float = column("N", "mean force while the speed falls")
    force_N: float = column("N", "mean of both branches", "Force", digits=4)
    force_sd_N: float = column("N", "its standard deviation between cycles")
    width_N: float = column("N", "hysteresis: how much more the decelerating branch resists", "Width", spread="sd")
    width_sd_N: float = column("N", "its standard deviation between cycles")
    difference_N: float = column("N", "simulated minus measured mean force of both branches")


@dataclass(frozen=True, kw_only=True)
class LoopPoint(ConditionRow):
    """A point of the mean loop; the first half of the phase is compression."""

    phase: float = column("1", "0 at full rebound, 0.5 at full compression, 1 at full rebound")
    position_m: float = column("m", "mean position")
    speed_m_s: float = column("m/s", "mean speed")
    force_N: float = column("N", "mean force")
    force_sd_N: float = column("N", "standard deviation between cycles")


@dataclass(frozen=True, kw_only=True)
class CycleWork(ConditionRow):
    """Work of a cycle, and what the force does at zero speed."""

    work_J: float = column(
        "J",
        "mean energy dissipated in a cycle: area of the loop force over position",
        "Work",
        "work",
        digits=4,
        spread="sd",
    )
    work_sd_J: float = column("J", "standard deviation between cycles")
    power_W: float = column("W", "work times frequency")
    damping_Ns_m: float = column(
        "Ns/m",
        "viscous damping that dissipates as much: work over the integral of speed squared",
        "Equivalent damping",
        "damping",
    )
    damping_sd_Ns_m: float = column("Ns/m", "standard deviation between cycles")
    mid_force_N: float = column(
        "N",
        "mean of the forces at the two zero speeds: gas force and static offset",
        "Mid force at zero speed",
        spread="sd",
    )
    mid_force_sd_N: float = column("N", "standard deviation between cycles")
    zero_width_N: float = column(
        "N",
        "force at full compression minus force at full rebound, both at zero speed",
        "Width at zero speed",
        "width at 0",
        spread="sd",
    )
    zero_width_sd_N: float = column("N", "standard deviation between cycles")
    zero_width_per_ms_N: float = column("N", "its change if force and position were 1 ms apart", "Per 1 ms of delay")
    rebound_ratio: float = column(
        "1",
        "peak force of rebound over that of compression, as measured, without sign",
        "Rebound / compression",
        "ratio",
    )
    difference_J: float = column("J", "simulated minus measured work", "Difference", "difference", spread="sd")
    difference_sd_J: float = column("J", "standard deviation of the difference between cycles")
    note: str = words("reason for an empty cell")


@dataclass(frozen=True, kw_only=True)
class SpeedBin:
    """Quantiles of the force in a bin of speed, over any motion."""

    source: str = words("`measured`, or the simulation")
    current_from_A: float = column("A", "lowest current in the group")
    current_to_A: float = column("A", "highest current in the group")
    speed_from_m_s: float = column("m/s", "lower edge of the bin")
    speed_to_m_s: float = column("m/s", "upper edge of the bin")
    samples: int = whole("samples in the bin")
    visits: int = whole("separate passes through the bin")
    low_N: float = column("N", "10 % quantile of the force")
    median_N: float = column("N", "median of the force")
    high_N: float = column("N", "90 % quantile of the force")


@dataclass(frozen=True, kw_only=True)
class StepResponse:
    """The response of the force to one step of the current."""

    source: str = words("`measured`, or the simulation")
    recording: str = words("name of the recording")
    time_s: float = column("s", "when the current had changed by the rules' share, from the first position sample")
    time_doubt_s: float = column("s", "half the sampling interval of the current in which it did")
    from_A: float = column("A", "current before")
    to_A: float = column("A", "current after")
    direction: str = words("compression or rebound")
    speed_m_s: float = column("m/s", "mean speed before the step")
    before_N: float = column("N", "force before")
    after_N: float = column("N", "force after it has settled")
    time_63_s: float = column("s", "from the step to 63.2 % of the change")
    time_90_s: float = column("s", "from the step to 90 % of the change")
    dead_time_s: float = column("s", "dead time of a first-order lag through 28.3 % and 63.2 %")
    time_constant_s: float = column("s", "its time constant: 63.2 % after the dead time")
    rise_s: float = column("s", "from 10 % to 90 % of the change")
    dip: float = column("1", "share of the change by which the force falls back before it stays; 0: none")
    note: str = words("why the response cannot be read")


@dataclass(frozen=True, kw_only=True)
class ValveResponse:
    """Mean response to steps of one kind; `..._ci95` is half the 95 % interval, with the sampling of the current."""

    source: str = words("`measured`, or the simulation", "Force", "force")
    from_A: float = column("A", "current before", "From", "from", digits=2)
    to_A: float = column("A", "current after", "To", "to", digits=2)
    change: str = words("soft to hard, or hard to soft", "Step")
    direction: str = words("compression or rebound", "Direction")
    steps: int = whole("number of steps read", "Steps", "steps")
    speed_m_s: float = column("m/s", "mean speed at the steps", "Speed", "speed", digits=2)
    force_change_N: float = column("N", "mean change of force", "Change")
    time_63_s: float = column(
        "s",
        "from the step to 63.2 % of the change",
        "63\N{NO-BREAK SPACE}% after the step",
        "63 % after",
        milli=True,
        spread="ci95",
    )
    time_63_ci95_s: float = column("s", "half its interval")
    time_90_s: float = column(
        "s", "from the step to 90 % of the change", "90\N{NO-BREAK SPACE}%", "90 %", milli=True, spread="ci95"
    )
    time_90_ci95_s: float = column("s", "half its interval")
    dead_time_s: float = column("s", "dead time", "Dead time", "dead time", milli=True, spread="ci95")
    dead_time_ci95_s: float = column("s", "half its interval")
    time_constant_s: float = column(
        "s", "63.2 % after the dead time", "63\N{NO-BREAK SPACE}% after it", milli=True, spread="ci95"
    )
    time_constant_ci95_s: float = column("s", "half its interval")
    rise_s: float = column(
        "s", "from 10 % to 90 % of the change", "10 to 90\N{NO-BREAK SPACE}%", milli=True, spread="ci95"
    )
    rise_ci95_s: float = column("s", "half its interval")
    settled_s: float = column("s", "from the step until it settles", "Settled", milli=True, spread="ci95")
    settled_ci95_s: float = column("s", "half its interval")
    overshoot: float = column("1", "largest share of the change above 1; 0: no more than noise", "Overshoot", digits=2)
    overshoot_ci95: float = column("1", "half its interval")
    dips: int = whole("steps with a dip that recovers", "Dips")
    note: str = words("reason for an empty cell")


@dataclass(frozen=True, kw_only=True)
class ResponsePoint:
    """A point of the mean response to steps of one kind: 0 before the step, 1 when the force has settled."""

    source: str = words("`measured`, or the simulation")
    from_A: float = column("A", "current before")
    to_A: float = column("A", "current after")
    direction: str = words("compression or rebound")
    speed_m_s: float = column("m/s", "mean speed at the steps")
    time_s: float = column("s", "from the step")
    steps: int = whole("steps with a value at this time")
    share: float = column("1", "mean share of the change of force")
    share_sd: float = column("1", "standard deviation between steps")


@dataclass(frozen=True, kw_only=True)
class JudgedValue:
    """A value beside the limit that the rules give it."""

    source: str = words("`measured`, or the simulation", "Force", "force")
    limit: str = words("the limit's key in the rules", "Limit", "limit")
    subject: str = words("step, or speed, that the value belongs to", "Of", "of")
    value: float = column("1", "the value, in the unit of the key", "Value", "value", spread="ci95")
    value_ci95: float = column("1", "half its 95 % interval")
    allowed: float = column("1", "the limit: at least for `range_N` and `ratio`, else at most", "Allowed", "allowed")
    verdict: str = words(
        "within, outside, undecided (the interval includes the limit) or not known", "Verdict", "verdict"
    )


@dataclass(frozen=True, kw_only=True)
class Omission:
    """Something that was recorded and not used, or that could not be computed, with the reason."""

    subject: str = words("what is missing: cycles, steps, a table", "What")
    recording: str = words("name of the recording, or `all`", "Recording")
    count: int = whole("how many", "How many")
    of: int = whole("of how many", "Of")
    reason: str = words("why", "Reason")


@dataclass(frozen=True, kw_only=True)
class RecordingFacts:
    """A recording: what the results rest on."""

    name: str = words("name of the recording", "Recording")
    duration_s: float = column("s", "time without gaps", "Length")
    rate_Hz: float = column("Hz", "rate of the position samples", "Rate", digits=4)
    bandwidth_Hz: float = column("Hz", "bandwidth of the speed", "Bandwidth of the speed")
    speed_noise_m_s: float = column("m/s", "its noise", "Noise of the speed", digits=2, milli=True)
    force_noise_N: float = column("N", "noise from sample to sample", "Noise of the force", digits=2)
    cycles: int = whole("cycles found", "Cycles")
    cycles_used: int = whole("cycles that repeat at a constant current", "Cycles used")


@dataclass(frozen=True, repr=False)
class Characteristics(PrintedResult):
    """The tables; `sources` are "measured" and the simulations, in the order of the rows."""

    rules: BenchRules
    sources: tuple[str, ...]
    current_tolerance_A: float
    recordings: tuple[RecordingFacts, ...]
    peak_velocity: tuple[PeakForce, ...]
    over_current: tuple[CurrentForce, ...]
    ranges: tuple[ControlRange, ...]
    continuous: tuple[ContinuousForce, ...]
    loops: tuple[LoopPoint, ...]
    work: tuple[CycleWork, ...]
    responses: tuple[ValveResponse, ...]
    response_points: tuple[ResponsePoint, ...]
    steps: tuple[StepResponse, ...]
    speed_bins: tuple[SpeedBin, ...]
    judged: tuple[JudgedValue, ...]
    omissions: tuple[Omission, ...]

    def to_frame(self, table: str = "peak_velocity") -> Any:
        """Return a table as a DataFrame: one of TABLES, or "recordings". Raises CesError."""
        if table not in (names := [*TABLES, "recordings"]):
            raise CesError(f"{table!r}: is no table{suggest(str(table), names)}")
        columns = [f.name for f in fields(TABLES.get(table, RecordingFacts))]
        return import_pandas().DataFrame([asdict(row) for row in getattr(self, table)], columns=columns)


TABLES: dict[str, type[Any]] = {
    "peak_velocity": PeakForce,
    "over_current": CurrentForce,
    "ranges": ControlRange,
    "continuous": ContinuousForce,
    "loops": LoopPoint,
    "work": CycleWork,
    "responses": ValveResponse,
    "response_points": ResponsePoint,
    "steps": StepResponse,
    "speed_bins": SpeedBin,
    "judged": JudgedValue,
    "omissions": Omission,
}


def find_omissions(
    motions: Sequence[RecordingMotion],
    cycles: Cycles,
    steps: Sequence[StepResponse],
    tables: Mapping[str, Any],
    rules: BenchRules,
) -> Iterator[Omission]:
    """Yield why cycles and steps were not used, which tables and cells are empty, and which target speeds."""
    measured = [step for step in steps if step.source == MEASURED]
    for number, motion in enumerate(motions):
        reasons = np.sort(cycles.reason[cycles.recording == number])
        yield from _count("cycles", motion.name, ["" if k < 0 else REASONS[k] for k in reasons])
        yield from _count("steps", motion.name, [step.note for step in measured if step.recording == motion.name])
    if not cycles.used.any():
        yield Omission(subject="force over speed, loops, work", recording=ALL, reason=NO_CYCLES)
    if all(step.note for step in measured):
        reason = NO_STEPS_READ if steps else NO_STEPS
        yield Omission(subject="response of the valve", recording=ALL, reason=reason)
    yield from _count("rows of the work per cycle", ALL, [row.note for row in tables["work"]])
    for speed in sorted(set(rules.speeds_m_s) - {row.target_m_s for row in tables["peak_velocity"]}):
        reason = f"no stroke is within {100 * rules.speed_tolerance:g} % of it"
        yield Omission(subject=f"target speed {speed:g} m/s", recording=ALL, reason=reason)


def _count(subject: str, recording: str, reasons: Sequence[str]) -> Iterator[Omission]:
    """Yield each reason with its count; the empty one stands for what was used."""
    for reason, count in Counter(filter(None, reasons)).items():
        yield Omission(subject=subject, recording=recording, count=count, of=len(reasons), reason=reason)
