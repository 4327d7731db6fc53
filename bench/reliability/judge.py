"""The faults, and the judge of one episode: report in the diagnostics, allowed output, time of recovery.

It is independent of ROS, so that its own tests can show that it detects violations.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from math import isfinite, isnan, nan
from typing import Protocol

TRUE = "as undisturbed"  # estimates continue and equal those of an undisturbed observer
NONE = "none"  # no estimate for the corrupted samples
BOUNDED = "bounded"  # estimates are allowed inside the model's envelope


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    `spoiler` names the change at the source, `action` the action on the processes or the node instead. The episode is
    reported if one of `evidence` is in a message, in the name of a count that rises or in a text that changes, or if
    the value named by `doubles` doubles. `output` is the rule for estimates of the fault's samples; with NONE they are
    still allowed for `holds_s` after its beginning. With `restarts` the model's warm-up is added to the time allowed
    for recovery.
    """

    name: str
    evidence: tuple[str, ...]
    output: str
    spoiler: str = "nothing"
    action: str = ""
    seconds: tuple[float, float] = (0.3, 1.0)
    holds_s: float = 0.0
    restarts: bool = False
    doubles: str = ""


OUT_OF_ORDER = "stamp repeats or runs backwards"
NO_CURRENT = "no usable current"
OFF_CLOCK = "off the node's clock"
SILENT = "no position samples arrive"
RESTART = ("warming up", "restarted", "jumped")

POSITIONS = (
    Fault("rows of 1 to 5 samples lost", ("position: dropped",), TRUE, "short dropouts"),
    Fault("rows of 20 to 100 samples lost", ("position: dropped",), BOUNDED, "long dropouts", restarts=True),
    Fault("no samples", (SILENT,), NONE, "silence", seconds=(0.6, 1.5), restarts=True),
    Fault("each sample one to three times", (OUT_OF_ORDER, "position: duplicates"), TRUE, "duplicates"),
    Fault("reordered, four at a time", (OUT_OF_ORDER, "position: out of order"), TRUE, "reordering"),
    Fault("position NaN", ("position is not finite",), NONE, "nan", restarts=True),
    Fault("a fifth of the positions NaN", ("position is not finite",), TRUE, "some nan"),
    Fault("position infinite", ("position is not finite",), NONE, "inf", restarts=True),
    Fault("position of 1e300 m", ("outlier", "outside"), BOUNDED, "huge", restarts=True),
    Fault("spikes of 0.2 to 1 m", ("outlier",), TRUE, "spikes"),
    Fault("sensor stuck", ("has not changed", "unchanged"), BOUNDED, "stuck", seconds=(1.5, 2.5), restarts=True),
)
TIMES = (
    Fault("stamps 2 to 60 s ahead", (OFF_CLOCK,), NONE, "ahead", restarts=True),
    Fault("stamps 2 to 60 s behind", (OFF_CLOCK,), NONE, "behind", restarts=True),
    Fault("stamps 0.1 to 0.4 s ahead", RESTART, BOUNDED, "a little ahead", seconds=(0.7, 1.2), restarts=True),
    Fault("stamps 0.1 to 0.4 s behind", RESTART, BOUNDED, "a little behind", seconds=(0.7, 1.2), restarts=True),
)
MESSAGES = (
    Fault("wrong joint name", ("no joint 'rear_damper'",), NONE, "wrong joint", seconds=(0.6, 1.2), restarts=True),
    Fault("flood at 10 kHz", (), BOUNDED, "flood", doubles="position: rate [Hz]"),
    Fault("garbage among the messages", ("messages without the field",), TRUE, "garbage among"),
    Fault("nothing but garbage", (SILENT,), NONE, "garbage", seconds=(0.6, 1.2), restarts=True),
)
PROCESSES = (
    Fault(
        "publisher stalls, then a burst", (SILENT,), BOUNDED, action="stop source", seconds=(0.5, 2.0), restarts=True
    ),
    Fault(
        "observer stalls, then a burst",
        (OFF_CLOCK, *RESTART),
        BOUNDED,
        action="stop observer",
        seconds=(0.7, 2.0),  # longer than max_age_s: after a shorter stall no force is withheld
        restarts=True,
    ),
    Fault(
        "publisher killed, another started", (SILENT,), NONE, action="kill source", seconds=(0.5, 1.5), restarts=True
    ),
)
CHANGES = (
    Fault("another model by parameter", ("model sha256",), TRUE, action="other model"),
    Fault("a bad model by parameter", (), TRUE, action="bad model"),
    Fault("model file read again", ("model sha256",), TRUE, action="reload"),
    Fault("a bad model file read again", ("refused",), TRUE, action="bad reload"),
    Fault("max_age_s changed", (), TRUE, action="age"),
    Fault("max_age_s out of range", (), TRUE, action="bad age"),
)


def faults(current_hold_s: float) -> tuple[Fault, ...]:
    """Return all faults; `current_hold_s` is the longest time for which the model may hold a current."""
    return (*POSITIONS, *_currents(current_hold_s), *TIMES, *MESSAGES, *PROCESSES, *CHANGES)


def _currents(hold_s: float) -> tuple[Fault, ...]:
    held = hold_s + 0.05  # a current is stamped when it arrives
    return (
        Fault("current lost", (NO_CURRENT,), NONE, "no current", seconds=(0.6, 1.2), holds_s=held, restarts=True),
        Fault("current NaN", (NO_CURRENT,), NONE, "nan current", seconds=(0.6, 1.2), holds_s=held, restarts=True),
        Fault("current infinite", (NO_CURRENT,), NONE, "inf current", seconds=(0.6, 1.2), holds_s=held, restarts=True),
        Fault("current of 1e300 A", ("outside",), BOUNDED, "huge current"),
    )


RECOVERY_S = 0.2
LONGEST_PAUSE_S = 0.2  # between two estimates, while estimates must continue
REPORT_WITHIN_NS = 1_500_000_000  # counts are published once a second
IN_FLIGHT_NS = 50_000_000
SETTLE_S = 0.5  # after recovery, until the force must equal that of an undisturbed observer
ANSWERED = "the node's answer"
MAX_ERROR_SHARE = 0.1  # of the ride's largest force


class EstimateSequence(Protocol):
    """Estimates in the order of their arrival: times of arrival and stamps [ns], forces [N]."""

    at: Sequence[int]
    stamps: Sequence[int]
    forces: Sequence[float]
    others: Sequence[float]


class StatusEntry(Protocol):
    """A received diagnostic status."""

    at: int
    message: str
    values: dict[str, str]


@dataclass
class FaultEpisode:
    """An injected fault: wall times [ns] of begin and end, corrupted stamps (0: none), first good stamp."""

    fault: Fault
    began_at: int = 0
    good_at: int = 0
    first_ns: int = 0
    last_ns: int = 0
    good_ns: int = 0
    wrong: list[str] = field(default_factory=list)  # wrong answers of the node


@dataclass(frozen=True)
class EpisodeLimits:
    """Limits from model, ride and parameters: force envelope [N], true force by stamp [N], its maximum, warm-up [s].

    `max_age_s` is the observer's limit on the age of its estimates.
    """

    envelope_N: tuple[float, float]
    truth: Callable[[int], float]
    max_force_N: float
    warm_up_s: float
    max_age_s: float
    recovery_s: float = RECOVERY_S
    longest_pause_s: float = LONGEST_PAUSE_S


@dataclass(frozen=True)
class FaultOutcome:
    """The outcome of an episode; `wrong` lists violations. Times in s, forces in N, NaN if there is no value."""

    fault: str
    reason: str
    recovery_s: float
    worst_force_N: float
    worst_error_N: float
    wrong: tuple[str, ...]


def evaluate_episode(
    episode: FaultEpisode, estimates: EstimateSequence, statuses: Sequence[StatusEntry], rules: EpisodeLimits
) -> FaultOutcome:
    """Evaluate an episode; estimates and diagnoses up to REPORT_WITHIN_NS after `good_at` must have been received."""
    until = episode.good_at + REPORT_WITHIN_NS
    span = range(bisect_left(estimates.at, episode.began_at), bisect_left(estimates.at, until))
    reason = find_evidence(episode.fault, statuses, episode.began_at, until)
    recovery = recovery_time_s(episode, estimates, span)
    error = worst_error_N(episode, estimates, span, rules, recovery)
    wrong = [
        *episode.wrong,
        *[s.message for s in statuses if episode.began_at <= s.at <= until and "unexpected error" in s.message][:1],
        *([] if reason else ["is not in the diagnostics"]),
        *check_bounds(estimates, span, rules),
        *_check_stamps(episode, estimates, span, rules),
        *_check_recovery(episode.fault, recovery, rules),
        *([f"force off by {error:.0f} N"] if error > MAX_ERROR_SHARE * rules.max_force_N else []),
        *_check_pauses(episode, estimates, span, rules),
    ]
    worst = max((abs(estimates.forces[k]) for k in span), default=nan)
    return FaultOutcome(episode.fault.name, reason, recovery, worst, error, tuple(wrong))


def find_evidence(fault: Fault, statuses: Sequence[StatusEntry], began_at: int, until: int) -> str:
    """Return the words by which the diagnostics report the fault, empty if they do not.

    Counts and texts are compared with the last diagnosis before the fault. A fault without evidence was a request,
    which the node itself answered.
    """
    if not (fault.evidence or fault.doubles):
        return ANSWERED
    first = bisect_left(statuses, began_at, key=lambda one: one.at)
    before = statuses[first - 1].values if first else {}
    for one in statuses[first:]:
        if one.at > until:
            break
        for words in fault.evidence:
            if words in one.message or _mentions(words, before, one.values):
                return words
        if fault.doubles and _number(one.values, fault.doubles) > 2.0 * _number(before, fault.doubles):
            return fault.doubles
    return ""


def _mentions(words: str, before: Mapping[str, str], now: Mapping[str, str]) -> bool:
    """Return whether a count whose name holds `words` has risen, or a text has changed to one that contains them."""
    for key, value in now.items():
        if words in f"{key}: {value}" and value != before.get(key):
            number = _number(now, key)
            if isnan(number) or number > _number(before, key, 0.0):
                return True
    return False


def _number(values: Mapping[str, str], key: str, otherwise: float = nan) -> float:
    try:
        return float(values[key])
    except (KeyError, ValueError):
        return otherwise


def recovery_time_s(episode: FaultEpisode, estimates: EstimateSequence, span: Iterable[int]) -> float:
    """Return the time from the first good sample to the first estimate of it or a later one; NaN if there is none."""
    for k in span:
        if (
            estimates.at[k] >= episode.good_at
            and episode.good_ns <= estimates.stamps[k] <= episode.good_ns + REPORT_WITHIN_NS
        ):
            return (estimates.at[k] - episode.good_at) * 1e-9
    return nan


def worst_error_N(
    episode: FaultEpisode, estimates: EstimateSequence, span: Iterable[int], rules: EpisodeLimits, recovery_s: float
) -> float:
    """Return the largest error of the estimates that must be accurate: all, or those after settling."""
    settled = episode.good_ns + round((recovery_s + SETTLE_S) * 1e9) if isfinite(recovery_s) else 0
    first = 0 if episode.fault.output == TRUE else settled
    chosen = [k for k in span if estimates.stamps[k] >= first and (not first or estimates.at[k] > episode.good_at)]
    return max((abs(estimates.forces[k] - rules.truth(estimates.stamps[k])) for k in chosen), default=nan)


def check_bounds(estimates: EstimateSequence, span: Iterable[int], rules: EpisodeLimits) -> list[str]:
    """Return the violations of the force envelope by the estimates in `span`."""
    low, high = rules.envelope_N
    bad = [k for k in span if not (low <= estimates.forces[k] <= high and isfinite(estimates.others[k]))]
    return [f"{len(bad)} estimates not finite or outside the envelope"] if bad else []


def _check_stamps(
    episode: FaultEpisode, estimates: EstimateSequence, span: Iterable[int], rules: EpisodeLimits
) -> list[str]:
    """Return the violations by estimates of unusable samples, and by old ones."""
    first, limit = episode.first_ns + round(episode.fault.holds_s * 1e9), round(rules.max_age_s * 1e9) + IN_FLIGHT_NS
    unusable = old = 0
    if episode.fault.output == NONE and episode.last_ns:
        unusable = sum(first <= estimates.stamps[k] <= episode.last_ns for k in span)
    if rules.max_age_s:
        old = sum(abs(estimates.at[k] - estimates.stamps[k]) > limit for k in span)
    wrong = [f"{unusable} estimates of unusable samples"] if unusable else []
    return wrong + ([f"{old} estimates older than max_age_s"] if old else [])


def _check_recovery(fault: Fault, recovery_s: float, rules: EpisodeLimits) -> list[str]:
    allowed_s = rules.recovery_s + (rules.warm_up_s if fault.restarts else 0.0)
    if recovery_s <= allowed_s:
        return []
    return ["no recovery" if isnan(recovery_s) else f"recovery took {recovery_s:.2f} s, allowed are {allowed_s:g}"]


def _check_pauses(
    episode: FaultEpisode, estimates: EstimateSequence, span: Iterable[int], rules: EpisodeLimits
) -> list[str]:
    if episode.fault.output != TRUE:
        return []
    times = [episode.began_at, *(estimates.at[k] for k in span if estimates.at[k] < episode.good_at), episode.good_at]
    longest = max(b - a for a, b in pairwise(times)) * 1e-9
    return [f"no estimate for {longest:.2f} s"] if longest > rules.longest_pause_s else []
