"""How one input topic arrives: rate, age, jitter and what is missing, counted with each message, told once a second.

Stamps and arrival times go in one by one, `StreamFigures` come out of each `roll`; memory does not grow. The time
between two messages is learnt from the stamps and followed: what lies between half and one and a half of it is usual
and counted in a few additions; everything else is told apart in `_take_rare`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from statistics import fmean, median_low

LEARN = 11  # intervals from which the period is learnt, and unusual ones in a row after which it is learnt anew
BACK_NS, BACK_PERIODS = 50_000_000, 20  # a stamp further back than both is a clock set back, not a late message
SILENCE_NS, SILENCE_PERIODS = 1_000_000_000, 10  # a longer interval than both is a silence, not a row of lost messages
MIN_AGE_NS = -(1 << 62)
MAX_LOST_SHARE = 0.5  # a period under which more than this share would have been lost while learning is not believed


@dataclass(frozen=True)
class StreamFigures:
    """One window of a topic; times in s. Counts named `total_` are of all time, the others of the window.

    `age` is arrival minus stamp, of the newest message and over the window. `jitter` is the standard deviation of the
    usual intervals between stamps, `longest` the longest interval of all. `burst` is the most messages that arrived
    within a quarter of the period of one another. `dropped` is estimated from gaps in the stamps; None if the messages
    have no stamps, as a gap in their arrival may as well be a stalled computer. Interruptions are stamps that ran back
    or left a silence too long to be a row of lost messages.
    """

    samples: int = 0
    total_samples: int = 0
    rate_Hz: float = 0.0
    period_s: float = 0.0
    age_s: float = 0.0
    mean_age_s: float = 0.0
    max_age_s: float = 0.0
    jitter_s: float = 0.0
    longest_s: float = 0.0
    burst: int = 0
    dropped: int | None = None
    total_dropped: int | None = None
    total_out_of_order: int = 0
    total_duplicates: int = 0
    total_interruptions: int = 0


class Arrivals:
    """Counts the messages of one topic; `figures` are those of the last window.

    `stamped` is False if the messages have no stamps of their own, so that `take` is given their arrival twice. A late
    message, one stamped before the newest, makes up for one that was counted as dropped when it did not come.
    """

    def __init__(self, stamped: bool = True) -> None:
        self._stamped = stamped
        self._newest_ns = self._now_ns = self._period_ns = 0
        self._age_sum_ns = self._longest_ns = self._max_run = 0
        self._max_age_ns = MIN_AGE_NS
        self._usual = self._rare = self._run = self._pending = self._streak = 0
        self._missing = self._late = self._duplicates = self._interruptions = 0
        self._steps: list[int] = []
        self._before = 0  # messages until the last roll
        self._set_period(0.0)
        self.figures = StreamFigures(dropped=0, total_dropped=0) if stamped else StreamFigures()

    def take(self, stamp_ns: int, now_ns: int) -> None:
        """Take a message stamped `stamp_ns` that arrived at `now_ns` of the node's clock."""
        age = now_ns - stamp_ns
        self._age_sum_ns += age
        if age > self._max_age_ns:  # noqa: PLR1730  # a call of max takes longer
            self._max_age_ns = age
        step = stamp_ns - self._newest_ns
        if self._short_ns < step < self._long_ns:
            self._newest_ns = stamp_ns
            self._usual += 1
            deviation = step - self._period_ns
            self._deviation_ns += deviation
            self._deviation_ns2 += deviation * deviation
            if step > self._longest_ns:  # noqa: PLR1730
                self._longest_ns = step
        else:
            self._take_rare(stamp_ns, step)
        if now_ns - self._now_ns < self._close_ns:
            self._run += 1
        elif self._run:
            self._end_run()
        self._now_ns = now_ns

    def roll(self, elapsed_s: float) -> StreamFigures:
        """Close a window of `elapsed_s` seconds and return its figures."""
        if self._usual != self._streak_at:
            self._count_pending()
        self._end_run()
        self._missing = max(self._missing, self._late)
        dropped = self._missing - self._late if self._stamped else None
        samples = self._usual + self._rare - self._before
        mean_ns, jitter_ns = self._spread()
        self.figures = StreamFigures(
            samples=samples,
            total_samples=self._usual + self._rare,
            rate_Hz=samples / elapsed_s if elapsed_s > 0.0 else 0.0,
            period_s=(self._period_ns + mean_ns) * 1e-9,
            age_s=(self._now_ns - self._newest_ns) * 1e-9 if samples else 0.0,
            mean_age_s=self._age_sum_ns / samples * 1e-9 if samples else 0.0,
            max_age_s=self._max_age_ns * 1e-9 if samples else 0.0,
            jitter_s=jitter_ns * 1e-9,
            longest_s=self._longest_ns * 1e-9,
            burst=self._max_run + 1 if samples else 0,
            dropped=None if dropped is None else max(0, dropped - (self.figures.total_dropped or 0)),
            total_dropped=dropped,
            total_out_of_order=self._late,
            total_duplicates=self._duplicates,
            total_interruptions=self._interruptions,
        )
        if self._period_ns:
            self._set_period(self._period_ns + mean_ns)
        self._before += samples
        self._begin_window()
        return self.figures

    def _begin_window(self) -> None:
        self._age_sum_ns = self._longest_ns = self._max_run = 0
        self._max_age_ns = MIN_AGE_NS

    def _spread(self) -> tuple[float, float]:
        """Return mean deviation from the period and standard deviation of the usual intervals [ns]."""
        count = self._usual - self._unmeasured
        if not count:
            return 0.0, 0.0
        mean = self._deviation_ns / count
        return mean, sqrt(max(0.0, self._deviation_ns2 / count - mean * mean))

    def _end_run(self) -> None:
        self._max_run = max(self._max_run, self._run)
        self._run = 0

    def _take_rare(self, stamp_ns: int, step_ns: int) -> None:
        """Take a message whose stamp is not about one period after the newest."""
        self._rare += 1
        period_ns = self._period_ns
        if self._usual + self._rare == 1:
            self._newest_ns = stamp_ns
        elif step_ns == 0:
            self._duplicates += self._stamped
        elif -max(BACK_NS, BACK_PERIODS * period_ns) <= step_ns < 0:
            self._late += 1
        else:
            self._newest_ns = stamp_ns
            if 0 < step_ns <= max(SILENCE_NS, SILENCE_PERIODS * period_ns):
                self._longest_ns = max(self._longest_ns, step_ns)
                self._take_unusual(step_ns)
            else:
                self._interruptions += 1

    def _take_unusual(self, step_ns: int) -> None:
        """Learn from an interval, or count how many messages are missing in it; a short one makes up for a long one."""
        if not self._period_ns:
            self._learn(step_ns)
            return
        if self._usual != self._streak_at:
            self._count_pending()
        self._pending += round(step_ns / self._period_ns) - 1
        self._streak += 1
        if self._streak < LEARN:
            return
        if abs(self._pending) > LEARN // 2:  # nothing was lost: the rate is another one
            self._forget_period()
        else:
            self._count_pending()

    def _count_pending(self) -> None:
        """Count what was pending: usual intervals have ended the row of unusual ones."""
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

    def _forget_period(self) -> None:
        self._steps.clear()
        self._pending = self._streak = 0
        self._set_period(0.0)

    def _set_period(self, period_ns: float) -> None:
        """Count from now on against this period, 0 while it is unknown."""
        self._period_ns = round(period_ns)
        self._short_ns, self._long_ns = round(0.5 * period_ns), round(1.5 * period_ns)
        self._close_ns = round(0.25 * period_ns)
        self._deviation_ns = self._deviation_ns2 = 0
        self._unmeasured = self._streak_at = self._usual
