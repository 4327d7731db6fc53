"""Arrivals of samples: rates, jitter, gaps, duplicates, and the losses of the middleware."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt
from statistics import fmean, median_low

FULL_SHARE = 0.9  # of the queue's length in time: the period is an average
MAX_SWITCHES = 20  # numbers that do not follow the last one; more show that several publishers share the topic


class Losses:
    """Losses on one topic whose queue holds `depth` messages.

    `lost` counts the messages that did not reach the node's callback, by their numbers; None if they have no numbers.
    `overflowed` counts those of them that its own queue dropped.
    """

    def __init__(self, depth: int) -> None:
        self.depth = depth
        self.lost: int | None = None
        self.overflowed = 0
        self._last: int | None = None
        self._switches = 0

    def take_number(self, number: int | None) -> bool:
        """Take the number of the next message; return whether this topic's numbers can be used."""
        if number is None or self._switches > MAX_SWITCHES:
            self.lost = None
            return False
        if self._last is None:
            self.lost = 0
        elif number > self._last:
            self.lost = (self.lost or 0) + number - self._last - 1
        else:  # another publisher, or one that was started again
            self._switches += 1
        self._last = number
        return True

    def take_gap(self, missing: int, waited_ns: int, period_ns: int) -> bool:
        """Count `missing` samples as overflowed if the message after them had waited for a full queue; return this."""
        if self.lost is not None:
            missing = min(missing, self.lost - self.overflowed)
        if missing <= 0 or waited_ns < FULL_SHARE * self.depth * period_ns:
            return False
        self.overflowed += missing
        return True


UNKNOWN = "unknown: the middleware does not number the messages"
LEARN = 11  # intervals to learn the period, and unusual ones in a row after which it is learnt again
BACK_NS, BACK_PERIODS = 50_000_000, 20  # a stamp further back than both: clock set back, not late
SILENCE_NS, SILENCE_PERIODS = 1_000_000_000, 10  # longer than both: silence, not lost messages
MIN_AGE_NS = -(1 << 62)
MAX_DEPTH = 1 << 62  # messages: a queue that is never full
MAX_LOST_SHARE = 0.5  # of messages while learning; a period that implies more is rejected


@dataclass(frozen=True)
class StreamFigures:
    """One window of a topic; times in s. Counts named `total_` are since the start, the others in the window.

    `age` is arrival minus stamp, `jitter` the standard deviation of the usual intervals between stamps. `dropped` is
    estimated from gaps in the stamps; it is None for messages without stamps, where a gap may be a stalled computer. Of
    these samples `lost` are known to have been lost, None if that is not known (`Losses`), and `overflowed` in the
    node's own queue; the source has not sent the others. Interruptions are stamps out of line with the others, or
    silences too long to be lost messages.
    """

    samples: int = 0
    total_samples: int = 0
    rate_Hz: float = 0.0
    period_s: float = 0.0
    mean_age_s: float = 0.0
    max_age_s: float = 0.0
    jitter_s: float = 0.0
    dropped: int | None = None
    total_dropped: int | None = None
    lost: int | None = None
    total_lost: int | None = None
    overflowed: int = 0
    total_overflowed: int = 0
    total_out_of_order: int = 0
    total_duplicates: int = 0
    total_interruptions: int = 0

    def values(self, name: str) -> Iterator[tuple[str, str]]:
        """Yield the key-value pairs of the input `name` for diagnostics, once a message has arrived."""
        if not self.total_samples:
            return
        yield f"{name}: rate [Hz]", f"{self.rate_Hz:.1f}"
        yield f"{name}: age, mean [ms]", f"{self.mean_age_s * 1e3:.3f}"
        yield f"{name}: age, max [ms]", f"{self.max_age_s * 1e3:.3f}"
        yield f"{name}: jitter [ms]", f"{self.jitter_s * 1e3:.3f}"
        if self.total_dropped is not None:
            lost, overflowed = self.total_lost, self.total_overflowed
            yield f"{name}: dropped", str(self.total_dropped)
            yield f"{name}: dropped, in this node's queue", str(overflowed)
            yield f"{name}: dropped, lost on the way", UNKNOWN if lost is None else str(max(0, lost - overflowed))
            yield f"{name}: dropped, not sent", UNKNOWN if lost is None else str(max(0, self.total_dropped - lost))
        yield f"{name}: out of order", str(self.total_out_of_order)
        yield f"{name}: duplicates", str(self.total_duplicates)
        yield f"{name}: interruptions", str(self.total_interruptions)

    def describe_missing(self) -> str:
        """Return what became of the samples that are missing in this window, as the end of a sentence."""
        if self.overflowed:
            return f"missing, {self.overflowed} of them dropped by this node's queue: set input_depth higher"
        if self.lost is None:
            return "missing: lost on the way, or the source paused"
        return f"missing, {self.lost} of them lost on the way" if self.lost else "missing: the source paused"


class Arrivals:
    """Counts the messages of one topic; `figures` are those of the last window.

    `stamped` is False if the messages have no stamps, so that `take` gets their arrival instead. A late message,
    stamped before the newest, cancels one that would be counted as dropped. A stamp that ran further back, or that was
    sent after it arrived as the others are stamped, is out of line, and counts go on as if it had not come, unless the
    next confirms it. `losses` are those of the topic.
    """

    def __init__(self, stamped: bool = True, losses: Losses | None = None) -> None:
        self._stamped = stamped
        self._losses = losses or Losses(MAX_DEPTH)
        self._newest_ns = self._period_ns = 0
        self._usual_age_ns: int | None = None
        self._last_age_ns: float | None = None  # mean of the last window
        self._doubtful_ns: int | None = None  # the last stamp, if it was out of line
        self._age_sum_ns, self._max_age_ns = 0, MIN_AGE_NS
        self._usual = self._rare = self._pending = self._streak = 0
        self._missing = self._late = self._duplicates = self._interruptions = 0
        self._steps: list[int] = []
        self._before = self._aged = 0  # messages until the last roll, and those whose ages do not count
        self._set_period(0.0)
        self.figures = StreamFigures(dropped=0, total_dropped=0) if stamped else StreamFigures()

    def take(self, stamp_ns: int, now_ns: int) -> None:
        """Count a message stamped `stamp_ns` that arrived at `now_ns` of the node's clock."""
        age = now_ns - stamp_ns
        step = stamp_ns - self._newest_ns
        if self._short_ns < step < self._long_ns:
            self._newest_ns = stamp_ns
            self._usual += 1
            deviation = step - self._period_ns
            self._deviation_ns += deviation
            self._deviation_ns2 += deviation * deviation
        else:
            age = self._take_rare(stamp_ns, step, age)
        self._age_sum_ns += age
        if age > self._max_age_ns:  # noqa: PLR1730  # faster than max()
            self._max_age_ns = age

    def roll(self, elapsed_s: float) -> StreamFigures:
        """Close a window of `elapsed_s` seconds and return its figures."""
        if self._usual != self._streak_at:
            self._count_pending()
        self._missing = max(self._missing, self._late + (self.figures.total_dropped or 0))
        dropped = self._missing - self._late if self._stamped else None
        samples = self._usual + self._rare - self._before
        mean_ns = jitter_ns = 0.0  # mean deviation from the period and standard deviation of the usual intervals
        if intervals := self._usual - self._unmeasured:
            mean_ns = self._deviation_ns / intervals
            jitter_ns = sqrt(max(0.0, self._deviation_ns2 / intervals - mean_ns * mean_ns))
        before, losses, aged = self.figures, self._losses, samples - self._aged
        mean_age_ns = self._age_sum_ns / aged if aged else 0.0
        self.figures = StreamFigures(
            samples=samples, total_samples=self._usual + self._rare,
            rate_Hz=samples / elapsed_s if elapsed_s > 0.0 else 0.0, period_s=(self._period_ns + mean_ns) * 1e-9,
            mean_age_s=mean_age_ns * 1e-9, max_age_s=self._max_age_ns * 1e-9 if aged else 0.0,
            jitter_s=jitter_ns * 1e-9,
            dropped=None if dropped is None else dropped - (before.total_dropped or 0), total_dropped=dropped,
            lost=None if losses.lost is None else losses.lost - (before.total_lost or 0), total_lost=losses.lost,
            overflowed=losses.overflowed - before.total_overflowed, total_overflowed=losses.overflowed,
            total_out_of_order=self._late, total_duplicates=self._duplicates, total_interruptions=self._interruptions,
        )  # fmt: skip
        if aged:  # a window with a stall is none of usual ages
            self._usual_age_ns = round(min(mean_age_ns, self._last_age_ns or mean_age_ns))
        self._last_age_ns = mean_age_ns if aged else None
        if self._period_ns:
            self._set_period(self._period_ns + mean_ns)
        self._before += samples
        self._aged, self._age_sum_ns, self._max_age_ns = 0, 0, MIN_AGE_NS
        return self.figures

    def restart_ages(self) -> None:
        """Forget the ages of messages: the node's clock was set."""
        self._aged, self._age_sum_ns, self._max_age_ns = self._usual + self._rare - self._before, 0, MIN_AGE_NS
        self._usual_age_ns = self._last_age_ns = None

    def _take_rare(self, stamp_ns: int, step_ns: int, age_ns: int) -> int:
        """Count a message whose stamp is not about one period after the newest; return its age, or the usual one.

        The usual age, that of the first message until a window is closed, replaces one that means nothing.
        """
        self._rare += 1
        if self._usual_age_ns is None:
            self._usual_age_ns = age_ns
        if self._usual + self._rare == 1:
            self._newest_ns = stamp_ns
            return age_ns
        back_ns = max(BACK_NS, BACK_PERIODS * self._period_ns)
        waited_ns = age_ns - self._usual_age_ns
        if step_ns < -back_ns or (step_ns > 0 and waited_ns < -back_ns):
            return self._take_doubtful(stamp_ns, step_ns, age_ns)
        self._doubtful_ns = None
        if step_ns == 0:
            self._duplicates += self._stamped
        elif step_ns < 0:
            self._late += 1
        else:
            self._take_gap(stamp_ns, step_ns, waited_ns)
        return age_ns

    def _take_doubtful(self, stamp_ns: int, step_ns: int, age_ns: int) -> int:
        """Count a stamp out of line, once; the next one beside it shows that the clock was set."""
        doubtful_ns, self._doubtful_ns = self._doubtful_ns, stamp_ns
        if step_ns < 0:  # the gap before it was none
            self._pending = self._streak = 0
        if doubtful_ns is None or abs(stamp_ns - doubtful_ns) > self._silence_ns():
            self._interruptions += 1
            return self._usual_age_ns or 0
        self.restart_ages()
        self._newest_ns, self._doubtful_ns, self._usual_age_ns = stamp_ns, None, age_ns
        self._aged -= 1  # this message counts
        self._pending = self._streak = 0
        return age_ns

    def _silence_ns(self) -> int:
        return max(SILENCE_NS, SILENCE_PERIODS * self._period_ns)

    def _take_gap(self, stamp_ns: int, step_ns: int, waited_ns: int) -> None:
        self._newest_ns = stamp_ns
        missing = round(step_ns / self._period_ns) - 1 if self._period_ns else 0
        if self._losses.take_gap(missing, waited_ns, self._period_ns) or step_ns <= self._silence_ns():
            self._take_unusual(step_ns)
        else:
            self._interruptions += 1

    def _take_unusual(self, step_ns: int) -> None:
        """Learn from an interval, or count the messages missing in it; a short one cancels a long one."""
        if not self._period_ns:
            self._learn(step_ns)
            return
        if self._usual != self._streak_at:
            self._count_pending()
        self._pending += round(step_ns / self._period_ns) - 1
        self._streak += 1
        if self._streak < LEARN:
            return
        if abs(self._pending) > LEARN // 2:  # nothing was lost: the rate has changed
            self._steps.clear()
            self._pending = self._streak = 0
            self._set_period(0.0)
        else:
            self._count_pending()

    def _count_pending(self) -> None:
        """Count the pending messages: usual intervals have ended the row of unusual ones."""
        self._missing += self._pending
        self._pending = self._streak = 0
        self._streak_at = self._usual

    def _learn(self, step_ns: int) -> None:
        self._steps.append(step_ns)
        if len(self._steps) < LEARN:
            return
        period_ns: float = median_low(self._steps)
        lost = sum(round(step / period_ns) - 1 for step in self._steps)
        if lost > MAX_LOST_SHARE * (lost + LEARN):
            period_ns, lost = fmean(self._steps), 0
        self._missing += max(0, lost)
        self._set_period(period_ns)

    def _set_period(self, period_ns: float) -> None:
        """Count relative to this period from now on; 0 while it is unknown."""
        self._period_ns = round(period_ns)
        self._short_ns, self._long_ns = round(0.5 * period_ns), round(1.5 * period_ns)
        self._deviation_ns = self._deviation_ns2 = 0
        self._unmeasured = self._streak_at = self._usual
