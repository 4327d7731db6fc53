"""Faults of a recording that can be detected before it is used: findings in plain words, errors first."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import chain, combinations

import numpy as np

from ces_data.arrays import I
from ces_data.limits import RecordingLimits
from ces_data.recording import Channel, Recording, Stamps, Values
from ces_observer.errors import RecordingError

ERROR, WRONG_MODEL, WARNING = SEVERITIES = ("error", "wrong model", "warning")  # worst first
SECOND = 1e9
SUITE = ("ces", "ces_cli", "ces_data", "ces_gap", "ces_identify", "ces_rig", "numba", "contextlib")


@dataclass(frozen=True)
class Finding:
    """A fault: with severity "error" the recording cannot be used; with "wrong model" it can be read, but a model of it
    would be wrong; with "warning" it can be used.

    `signal` is the one that it is about, empty if it is about several; `recording` the name of the one that it is
    about, empty where the caller knows it, or if it is about several.
    """

    severity: str
    text: str
    signal: str = ""
    recording: str = ""


class DelayFinding(Finding):
    """A signal is logged later or earlier than another; the remedy is the key delay in the signals file."""


class SaturationFinding(Finding):
    """A channel saturates."""


def findings(recording: Recording) -> tuple[Finding, ...]:
    """Return all faults of a recording, errors first.

    Errors: constant position; an empty channel, or one with more than 1 % NaN or infinite samples; a value beyond all
    units; time running backwards, or standing still; rates a factor of 100 apart; current absent for more than 1 % of
    the time. Warnings: fewer NaN or infinite samples, a pause of all signals, a short absence of the current, positions
    and forces that are missing in a table.
    """
    start_ns = min((int(c.stamps_ns[0]) for c in recording.channels.values() if len(c)), default=0)
    single = (_check_channel(channel, start_ns) for channel in recording.channels.values())
    of_all = _check_position_and_rates(recording), _check_gaps(recording, start_ns), _check_blanks(recording)
    return sort_findings(*single, *of_all)


def sort_findings(*groups: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return the findings of all groups, the worst first."""
    return tuple(sorted(chain(*groups), key=lambda finding: SEVERITIES.index(finding.severity)))


def warn(text: str) -> None:
    """Warn of something, on the line of the user's code that called the suite."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).split(".")[0] in SUITE:
        frame, level = frame.f_back, level + 1
    warnings.warn(text, stacklevel=level)


def require_usable(recording: Recording) -> tuple[Finding, ...]:
    """Return the warnings about a recording; raises RecordingError with the first error if there is one."""
    results = findings(recording)
    if results and results[0].severity == ERROR:
        raise RecordingError(f"{recording.source or recording.name}: {results[0].text}")
    return results


def mean_rate(channel: Channel) -> float:
    """Return the mean rate [Hz] of a channel between its pauses; 0 if its span is empty."""
    return rate_between_pauses(channel.stamps_ns)


def rate_between_pauses(stamps_ns: Stamps) -> float:
    """Return the mean rate [Hz] of stamps (n,) in any order, without pauses; 0 if their span is empty.

    A pause is longer than 20 median intervals, and rare or longer than 0.5 s: samples may come in batches.
    """
    steps = np.diff(stamps_ns if (stamps_ns[1:] >= stamps_ns[:-1]).all() else np.sort(stamps_ns))
    if not len(steps):
        return 0.0
    pauses = steps > RecordingLimits.USUAL_INTERVALS * np.median(steps)
    if pauses.mean() > RecordingLimits.RARE_SHARE:
        pauses &= steps > RecordingLimits.MISSING_S * SECOND
    span = int(steps[~pauses].sum())
    return float((~pauses).sum() * SECOND / span) if span else 0.0


def _check_channel(channel: Channel, start_ns: int) -> Iterator[Finding]:
    name, stamps, values = channel.name, channel.stamps_ns, channel.values
    if not len(channel):
        yield Finding(ERROR, f"{name}: the channel is empty; expected samples", name)
        return
    at = (stamps - start_ns) / SECOND
    bad = ~np.isfinite(values)
    if bad.any():
        text = f"{name}: {int(bad.sum())} of {len(bad)} samples are NaN or infinite, the first at {at[bad][0]:.3f} s"
        if bad.mean() > RecordingLimits.BAD_SHARE:
            yield Finding(ERROR, f"{text}; expected at most {RecordingLimits.BAD_SHARE:.0%}", name)
        else:
            yield Finding(WARNING, f"{text}; they are left out", name)
    worst, limit = int(np.argmax(np.where(bad, 0.0, np.abs(values)))), RecordingLimits.POSSIBLE.get(name, np.inf)
    if not bad[worst] and abs(values[worst]) > limit:  # no sensor can have measured it: a wrong type, field or scale
        text = f"{name}: {values[worst]:.4g} {channel.unit} at {at[worst]:.3f} s; expected at most {limit:g}"
        yield Finding(ERROR, f"{text}: check type, field and scale in the signals file, or remove the sample", name)
    yield from _check_stamps(name, stamps, at)


def _check_stamps(name: str, stamps: Stamps, at: Values) -> Iterator[Finding]:
    steps = np.diff(stamps)
    runs = runs_of_equal(stamps)
    begin, end = runs[np.argmax(runs[:, 1] - runs[:, 0])]
    if end - begin > RecordingLimits.MAX_EQUAL_STAMPS:
        text = f"{name}: {end - begin} samples in a row have the same stamp, at {at[begin]:.3f} s; expected a stamp for"
        yield Finding(ERROR, f"{text} each sample (is the header's stamp filled in?)", name)
    elif len(steps) and (steps == 0).mean() > RecordingLimits.MAX_EQUAL_SHARE:
        text = f"{name}: {(steps == 0).mean():.0%} of the samples have the same stamp as the one before: times are"
        yield Finding(
            WARNING, f"{text} rounded, or samples are repeated; log times that tell one sample from the next", name
        )
    if (steps < 0).any():
        row = int(np.argmin(steps))
        times = f"{int((steps < 0).sum())} times, most at {at[row]:.3f} s by {-steps[row] / SECOND:.6f} s"
        hint = "record it again (was a clock set back, or a bag played in a loop? Sorting would mix the two times)"
        yield Finding(ERROR, f"{name}: time runs backwards {times}; {hint}", name)


def runs_of_equal(values: Values | Stamps) -> I:
    """Return begin and end (n, 2) of the runs of equal values."""
    changes = np.flatnonzero(np.diff(values) != 0) + 1
    return np.stack([np.concatenate([[0], changes]), np.concatenate([changes, [len(values)]])], axis=1)


def _check_position_and_rates(recording: Recording) -> Iterator[Finding]:
    values = finite_values(recording, "position")
    if "position" in recording.constants:
        text = "position: is a constant in the signals file; expected a recorded stroke"
        yield Finding(ERROR, text, "position")
    elif len(values) and values.min() == values.max():
        text = f"position: constant at {values[0]:g} m; expected a stroke (is it the right field?)"
        yield Finding(ERROR if "force" in recording.channels else WARNING, text, "position")
    rates = {name: rate for name, channel in recording.channels.items() if (rate := mean_rate(channel)) > 0.0}
    for (slow, low), (fast, high) in combinations(sorted(rates.items(), key=lambda item: item[1]), 2):
        if high >= RecordingLimits.RATE_RATIO * low and "temperature" not in (slow, fast):
            what = f"{slow} at {low:.4g} Hz and {fast} at {high:.4g} Hz"
            yield Finding(ERROR, f"{what}: rates more than {RecordingLimits.RATE_RATIO:g} times apart")


def _check_gaps(recording: Recording, start_ns: int) -> Iterator[Finding]:
    """Report once that all signals pause, and the longest stretch without current: beyond its limit, an error."""
    stamps = [channel.stamps_ns for channel in recording.channels.values() if len(channel)]
    pauses = reduce(_intersect, [missing_stretches(own, own) for own in stamps] if len(stamps) > 1 else [[]])
    if pauses:
        span = _describe_stretches(pauses, start_ns)
        yield Finding(WARNING, f"all signals pause {span} (was the recorder paused?); nothing is bridged")
    if not all(len(recording.channels.get(name, ())) for name in ("position", "current")):
        return
    position, current = (recording.channel(name).stamps_ns for name in ("position", "current"))
    lengths = {  # without the pauses
        (begin, end): end - begin - sum(max(0, min(end, last) - max(begin, first)) for first, last in pauses)
        for begin, end in missing_stretches(position, current)
    }
    absent = [stretch for stretch, length in lengths.items() if length > RecordingLimits.MISSING_S * SECOND]
    if absent:
        share = sum(lengths[stretch] for stretch in absent) / int(np.ptp(position))
        text = f"current: absent {_describe_stretches(absent, start_ns)}, {share:.1%} of the time; expected it wherever"
        severity = ERROR if share > RecordingLimits.MISSING_SHARE else WARNING
        yield Finding(severity, f"{text} position is recorded", "current")


def _check_blanks(recording: Recording) -> Iterator[Finding]:
    """Report positions and forces that are missing at times of a table; those of a slower signal are none."""
    whole = max((channel.stamps_ns for channel in recording.channels.values()), key=len)
    for channel in (recording.channels[name] for name in ("position", "force") if name in recording.channels):
        own = channel.stamps_ns
        if not 2 < len(own) < len(whole) or not np.isin(own, whole).all():
            continue
        usual = float(np.median(np.diff(own)))
        steps = np.diff(np.concatenate([whole[:1] - usual, own, whole[-1:] + usual]))
        lost = int((np.rint(steps / usual) - 1.0)[steps > 1.5 * usual].sum()) if usual else 0
        if lost > RecordingLimits.BAD_SHARE * len(own) or steps.max() > RecordingLimits.GAP_INTERVALS * usual > 0.0:
            text = (
                f"{channel.name}: {lost} of {lost + len(own)} samples are missing, for up to {steps.max() / SECOND:.3g}"
            )
            yield Finding(WARNING, f"{text} s; longer gaps than 0.05 s are not bridged", channel.name)


def _intersect(some: list[tuple[int, int]], others: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return the stretches that are in both lists."""
    both = ((max(a, c), min(b, d)) for a, b in some for c, d in others)
    return [(begin, end) for begin, end in both if end - begin > RecordingLimits.MISSING_S * SECOND]


def _describe_stretches(stretches: Sequence[tuple[int, int]], start_ns: int) -> str:
    """Return when the longest stretch is, and how many there are besides."""
    begin, end = max(stretches, key=lambda stretch: stretch[1] - stretch[0])
    more = f" and {len(stretches) - 1} times more" if len(stretches) > 1 else ""
    return f"from {(begin - start_ns) / SECOND:.3f} s to {(end - start_ns) / SECOND:.3f} s{more}"


def finite_values(recording: Recording, signal: str) -> Values:
    """Return the finite values (n,) of a signal's channel, none without a channel."""
    values = recording.channels[signal].values if signal in recording.channels else np.empty(0)
    return np.asarray(values[np.isfinite(values)])


def missing_stretches(reference_ns: Stamps, stamps_ns: Stamps) -> list[tuple[int, int]]:
    """Return begin and end [ns] of the stretches inside the reference's span without stamps.

    A stretch is longer than 0.5 s and 20 median intervals; at both ends, where topics start and stop, than 1 s.
    """
    begin, end = int(reference_ns.min()), int(reference_ns.max())
    edges = np.concatenate([[begin], np.sort(np.clip(stamps_ns, begin, end)), [end]])
    lengths = np.diff(edges)
    usual = float(np.median(lengths[1:-1])) if len(lengths) > 2 else 0.0
    longest_allowed = np.full(
        len(lengths), max(RecordingLimits.MISSING_S * SECOND, RecordingLimits.USUAL_INTERVALS * usual)
    )
    longest_allowed[[0, -1]] = np.maximum(longest_allowed[[0, -1]], RecordingLimits.EDGE_S * SECOND)
    return [(int(edges[i]), int(edges[i + 1])) for i in np.flatnonzero(lengths > longest_allowed)]
