"""The clocks of a bag: header stamps against the times at which the same messages were logged.

A topic without a header has log times only. Where the headers' clock is another one, they are moved to it, or refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ces_data.limits import DriftLimits, RecordingLimits, StatisticLimits
from ces_data.recording import Stamps
from ces_observer.errors import RecordingError

SECOND = 1e9


@dataclass(frozen=True)
class HeaderClock:
    """How far the header stamps of a topic are behind its log times [ns]: the median, and what it grows by.

    `rate` is that of the headers' clock over that of the log, `boot` whether it counts from the start of a computer.
    """

    topic: str
    behind_ns: int
    growth_ns: int
    rate: float
    boot: bool


def compare_clocks(topic: str, header_ns: Stamps, log_ns: Stamps) -> HeaderClock | None:
    """Return the clock of a topic's headers, None without headers or with too few messages."""
    if len(header_ns) < StatisticLimits.ENOUGH or not header_ns.all():
        return None
    behind, third = log_ns - header_ns, len(header_ns) // 3
    growth = int(np.median(behind[-third:]) - np.median(behind[:third]))
    passed = float(np.median(log_ns[-third:]) - np.median(log_ns[:third]))
    rate = 1.0 - growth / passed if passed else 1.0
    boot = header_ns[-1] < RecordingLimits.BOOT_S * SECOND < log_ns[-1]
    return HeaderClock(topic, int(np.median(behind)), growth, rate, bool(boot))


def find_shift(clocks: Sequence[HeaderClock], unstamped: Iterable[str], where: str) -> tuple[int, str]:
    """Return by how much log times are moved back to the headers' clock [ns], and what to say about it.

    Raises RecordingError if that clock drifts or runs at another rate, or if topics have two.
    """
    for clock in clocks:
        first = clocks[0]
        apart = abs(clock.behind_ns - first.behind_ns)
        if apart > RecordingLimits.OTHER_CLOCK_S * SECOND:
            text = f"the headers of {first.topic} and {clock.topic} are of two clocks, {apart / SECOND:.3f} s apart"
            boot = f" ({clock.topic if clock.boot else first.topic} counts from a computer's start)"
            remedy = "stamp both by one clock, or give the difference as delay of one signal in the signals file"
            named = boot if clock.boot != first.boot else ""
            raise RecordingError(f"{where}: {text}{named}; {remedy}")
    names = ", ".join(unstamped)
    if not clocks or not names:
        return 0, ""
    clock = max(clocks, key=lambda clock: abs(clock.growth_ns))
    if abs(clock.growth_ns) > DriftLimits.MIN_CHANGE_S * SECOND:
        text = f"the header clock of {clock.topic} runs at {clock.rate:.4g} times the speed of the log's"
        grows = f"they are {abs(clock.growth_ns) / SECOND:.3f} s further apart at the end"
        remedy = f"no time of {names}, which has no header, fits; record it with a stamped type"
        raise RecordingError(f"{where}: {text}, {grows}; {remedy}")
    behind = int(np.median([clock.behind_ns for clock in clocks]))
    if abs(behind) < RecordingLimits.CLOCK_OFFSET_S * SECOND:
        return 0, ""
    kind = "count from a computer's start and are" if clock.boot else "are"
    size, side = abs(behind) / SECOND, "behind" if behind > 0 else "ahead of"
    text = f"header stamps of {clock.topic} {kind} {size:.3f} s {side} the log's clock"
    return behind, f"{text}; {names} has no header, and its log times are moved by that"
