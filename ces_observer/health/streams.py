"""Arrivals of samples: rates, jitter, gaps, duplicates, and the losses of the middleware, for diagnostics.

`ces_observer.health.arrivals` counts, for the C++ node, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from ces_observer.health import arrivals as counts
from ces_observer.health.diagnostics import Figures, Remarks

MAX_DEPTH = 1 << 62  # messages: a queue that is never full


class Losses:
    """Losses on one topic whose queue holds `depth` messages.

    `lost` counts the messages that did not reach the node's callback, by their numbers; None if they have no numbers.
    `overflowed` counts those of them that its own queue dropped.
    """

    def __init__(self, depth: int) -> None:
        self.k = [0] * counts.K_LOSSES_END
        self.set_depth(depth)

    def set_depth(self, depth: int) -> None:
        """Set the length of the queue, which a user may have overridden."""
        self.k[counts.QUEUE_DEPTH] = depth

    @property
    def lost(self) -> int | None:
        """Messages lost by their numbers; None without numbers."""
        return self.k[counts.LOST] if self.k[counts.NUMBERED] else None

    @property
    def overflowed(self) -> int:
        """Messages that the node's own queue dropped."""
        return self.k[counts.OVERFLOWED]

    def take_number(self, number: int | None) -> bool:
        """Take the number of the next message; return whether this topic's numbers can be used."""
        return counts.losses_take_number(self.k, number is not None, number or 0)


@dataclass(frozen=True)
class StreamFigures:
    """One window of a topic; times in s. Counts named `total_` are since the start, the others in the window.

    `age` is arrival minus stamp, the usual one without stalls, `jitter` the standard deviation of the usual intervals
    between stamps. `dropped` is estimated from gaps in the stamps; it is None for messages without stamps, where a gap
    may be a stalled computer. Of these samples `lost` are known to have been lost, None if that is not known
    (`Losses`), and `overflowed` in the node's own queue; the source has not sent the others. Interruptions are stamps
    out of line with the others, or silences too long to be lost messages.
    """

    samples: int = 0
    total_samples: int = 0
    rate_Hz: float = 0.0
    period_s: float = 0.0
    mean_age_s: float = 0.0
    usual_age_s: float = 0.0
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
        yield Figures.STREAM_RATE.of(self.rate_Hz, name)
        yield Figures.MEAN_AGE.of(self.mean_age_s * 1e3, name)
        yield Figures.MAX_AGE.of(self.max_age_s * 1e3, name)
        yield Figures.JITTER.of(self.jitter_s * 1e3, name)
        if self.total_dropped is not None:
            lost, overflowed = self.total_lost, self.total_overflowed
            on_the_way, not_sent = (
                Remarks.NOT_NUMBERED if lost is None else max(0, count)
                for count in ((lost or 0) - overflowed, self.total_dropped - (lost or 0))
            )
            yield Figures.DROPPED.of(self.total_dropped, name)
            yield Figures.DROPPED_IN_QUEUE.of(overflowed, name)
            yield Figures.DROPPED_ON_THE_WAY.of(on_the_way, name)
            yield Figures.NOT_SENT.of(not_sent, name)
        yield Figures.OUT_OF_ORDER.of(self.total_out_of_order, name)
        yield Figures.DUPLICATES.of(self.total_duplicates, name)
        yield Figures.INTERRUPTIONS.of(self.total_interruptions, name)

    def describe_missing(self) -> str:
        """Return what became of the samples that are missing in this window, as the end of a sentence."""
        if self.overflowed:
            return Remarks.MISSING_IN_QUEUE % self.overflowed
        if self.lost is None:
            return Remarks.MISSING_UNKNOWN
        return Remarks.MISSING_ON_THE_WAY % self.lost if self.lost else Remarks.MISSING_PAUSED


class Arrivals:
    """Counts the messages of one topic; `figures` are those of the last window.

    `stamped` is False if the messages have no stamps, so that `take` gets their arrival instead. `losses` are those of
    the topic.
    """

    def __init__(self, stamped: bool = True, losses: Losses | None = None) -> None:
        self._stamped = stamped
        self._losses = losses or Losses(MAX_DEPTH)
        self._s, self._k = [0.0] * counts.S_ARRIVALS_END, [0] * counts.K_ARRIVALS_END
        counts.arrivals_reset(self._s, self._k)
        self.figures = StreamFigures(dropped=0, total_dropped=0) if stamped else StreamFigures()

    def take(self, stamp_ns: int, now_ns: int) -> None:
        """Count a message stamped `stamp_ns` that arrived at `now_ns` of the node's clock."""
        counts.arrivals_take(self._s, self._k, self._losses.k, stamp_ns, now_ns)

    def roll(self, elapsed_s: float) -> StreamFigures:
        """Close a window of `elapsed_s` seconds and return its figures."""
        s, k, before, losses = self._s, self._k, self.figures, self._losses
        period_ns = s[counts.ARRIVAL_PERIOD]
        counts.arrivals_roll(s, k)
        total = k[counts.USUAL] + k[counts.RARE]
        samples = total - before.total_samples
        dropped = k[counts.DROPPED] if self._stamped else None
        self.figures = StreamFigures(
            samples=samples, total_samples=total, rate_Hz=samples / elapsed_s if elapsed_s > 0.0 else 0.0,
            period_s=(period_ns + s[counts.MEAN_DEVIATION]) * 1e-9, mean_age_s=s[counts.MEAN_AGE] * 1e-9,
            usual_age_s=k[counts.USUAL_AGE] * 1e-9, max_age_s=k[counts.WINDOW_MAX_AGE] * 1e-9,
            jitter_s=s[counts.JITTER] * 1e-9,
            dropped=None if dropped is None else dropped - (before.total_dropped or 0), total_dropped=dropped,
            lost=None if losses.lost is None else losses.lost - (before.total_lost or 0), total_lost=losses.lost,
            overflowed=losses.overflowed - before.total_overflowed, total_overflowed=losses.overflowed,
            total_out_of_order=k[counts.LATE], total_duplicates=k[counts.DUPLICATES] if self._stamped else 0,
            total_interruptions=k[counts.INTERRUPTIONS],
        )  # fmt: skip
        return self.figures

    def restart_ages(self) -> None:
        """Forget the ages of messages: the node's clock was set."""
        counts.arrivals_restart_ages(self._s, self._k)
