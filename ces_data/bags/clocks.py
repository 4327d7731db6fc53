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

    `rate` is that of the headers' clock over that of the log, `boot` whether it counts from the start of a computer,
    `delay_ns` what the signals file states. `jump` counts the messages before a step that stays.
    """

    topic: str
    behind_ns: int
    growth_ns: int
    rate: float
    boot: bool
    jump: int = 0
    delay_ns: int = 0


def compare_clocks(topic: str, header_ns: Stamps, log_ns: Stamps, delay_ns: int = 0) -> HeaderClock | None:
    """Return the clock of a topic's headers; None with too few that are filled in."""
    filled = header_ns != 0
    header_ns, log_ns = header_ns[filled], log_ns[filled]
    if len(header_ns) < StatisticLimits.ENOUGH:
        return None
    behind, third = log_ns - header_ns, len(header_ns) // 3
    growth = int(np.median(behind[-third:]) - np.median(behind[:third]))
    passed = float(np.median(log_ns[-third:]) - np.median(log_ns[:third]))
    rate = 1.0 - growth / passed if passed else 1.0
    boot = bool(header_ns[-1] < RecordingLimits.BOOT_S * SECOND < log_ns[-1])
    at, jump = _find_jump(behind)
    return HeaderClock(topic, int(np.median(behind)), jump or growth, rate, boot, at, delay_ns)


def _find_jump(behind: Stamps) -> tuple[int, int]:
    """Return the message at which the difference steps and stays so, and by how much; 0 of both without a step.

    Where messages wait, it steps and goes back; where a clock drifts, the largest step is a small part of it.
    """
    steps = np.diff(behind)
    at = int(np.abs(steps).argmax()) + 1
    if min(at, len(behind) - at) < RecordingLimits.STAYS_SHARE * len(behind):
        return 0, 0
    jump = int(np.median(behind[at:]) - np.median(behind[:at]))
    stays = abs(jump) > RecordingLimits.CLOCK_OFFSET_S * SECOND and abs(jump - steps[at - 1]) < 0.5 * abs(jump)
    return (at, jump) if stays else (0, 0)


def find_shift(clocks: Sequence[HeaderClock], unstamped: Iterable[str], where: str) -> tuple[int, list[str]]:
    """Return by how much log times are moved back to the headers' clock [ns], and what to say about the clocks.

    Of topics that differ, the one whose headers are nearest to the log's clock counts: messages are logged late. Raises
    RecordingError if that clock drifts, steps or runs at another rate, or if topics have two.
    """
    notes = []
    for clock in clocks:
        first = clocks[0]
        late_ns = clock.behind_ns + clock.delay_ns - first.behind_ns - first.delay_ns
        apart = abs(late_ns)
        if apart > RecordingLimits.OTHER_CLOCK_S * SECOND:
            text = f"the headers of {first.topic} and {clock.topic} are of two clocks, {apart / SECOND:.3f} s apart"
            boot = f" ({clock.topic if clock.boot else first.topic} counts from a computer's start)"
            remedy = "stamp both by one clock"
            named = boot if clock.boot != first.boot else ""
            raise RecordingError(f"{where}: {text}{named}; {remedy}")
        if apart > RecordingLimits.LATE_S * SECOND:
            more, less = (clock, first) if late_ns > 0 else (first, clock)
            text = f"header stamps of {more.topic} are {apart / SECOND:.3f} s further behind the log's clock than those"
            remedy = f"if a clock is wrong, give the difference as delay of a signal, of {more.topic} a negative one"
            notes.append(f"{text} of {less.topic} (a slow way, or another clock?); {remedy}")
    names = ", ".join(unstamped)
    if not clocks or not names:
        return 0, notes
    clock = max(clocks, key=lambda clock: abs(clock.growth_ns))
    if abs(clock.growth_ns) > DriftLimits.MIN_CHANGE_S * SECOND:
        size = f"{abs(clock.growth_ns) / SECOND:.3f} s"
        text = f"the header clock of {clock.topic} runs at {clock.rate:.4g} times the speed of the log's"
        grows = f"they are {size} further apart at the end"
        if clock.jump:
            text, grows = f"the clock of the log or of the headers of {clock.topic} was set", f"they move by {size}"
            grows += f" against each other after {clock.jump} messages"
        remedy = f"no time of {names}, which has no header, fits; record it with a stamped type"
        raise RecordingError(f"{where}: {text}, {grows}; {remedy}")
    clock = min(clocks, key=lambda clock: abs(clock.behind_ns))
    behind = clock.behind_ns
    if abs(behind) < RecordingLimits.CLOCK_OFFSET_S * SECOND:
        return 0, notes
    kind = "count from a computer's start and are" if clock.boot else "are"
    apart_s, side = abs(behind) / SECOND, "behind" if behind > 0 else "ahead of"
    text = f"header stamps of {clock.topic} {kind} {apart_s:.3f} s {side} the log's clock"
    return behind, [*notes, f"{text}; {names} has no header, and its log times are moved by that"]
