"""Episodes of withholding, and rests of the position."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from ces_observer.limits import HealthLimits

MAX_REASONS = 4  # of one episode listed by name


@dataclass(frozen=True)
class Episode:
    """An ended episode: its start [ns of the node's clock], length [s], reasons in order, and withheld samples."""

    start_ns: int
    length_s: float
    reasons: tuple[str, ...]
    withheld: int

    @property
    def reason(self) -> str:
        """All its reasons in one line."""
        return ", then ".join(self.reasons)

    def __str__(self) -> str:
        start = f"{self.start_ns // 10**9}.{self.start_ns // 10**6 % 1000:03d} s"
        return f"{start}, for {self.length_s:.3f} s: {self.reason} ({self.withheld} samples withheld)"


class Episodes:
    """Episodes of one damper: `total` counts the ended ones, `last` is the newest of them."""

    def __init__(self) -> None:
        self.total = 0
        self.last: Episode | None = None
        self._reasons: list[str] = []
        self._start_ns = self._withheld = 0

    def add_withheld(self, reason: str, now_ns: int, withheld_before: int) -> None:
        """Add a reason for withholding; `withheld_before` counts the samples withheld before this one."""
        if not self._reasons:
            self._start_ns, self._withheld = now_ns, withheld_before
        if reason not in self._reasons and len(self._reasons) < MAX_REASONS:
            self._reasons.append(reason)

    def end_episode(self, now_ns: int, withheld: int) -> None:
        """End the episode, if there is one; `withheld` counts the samples withheld so far.

        One that began at 0, before the first /clock of simulated time, is taken to begin now.
        """
        if not self._reasons:
            return
        start_ns = self._start_ns or now_ns
        length_s = max(0, now_ns - start_ns) * 1e-9
        self.last = Episode(start_ns, length_s, tuple(self._reasons), withheld - self._withheld)
        self._reasons.clear()
        self.total += 1


class Stillness:
    """Rests of at least `warn_s` [s] of the positions' stamps; with 0 there are none.

    `count` is the number of rests, `last_s` [s] the length of the last one, `resting` True during a rest.
    """

    def __init__(self, warn_s: float) -> None:
        self.warn_s = warn_s
        self._position_m: float | None = None
        self._since_ns = 0
        self.count = 0
        self.last_s = 0.0
        self.resting = False

    def take(self, stamp_ns: int, position_m: float) -> None:
        """Add a position sample [m]; NaN ends a rest."""
        if position_m != self._position_m or stamp_ns < self._since_ns:
            self._position_m, self._since_ns, self.resting = position_m, stamp_ns, False
        elif self.resting or 0.0 < self.warn_s * 1e9 <= stamp_ns - self._since_ns:
            self.count += not self.resting
            self.resting = True
            self.last_s = (stamp_ns - self._since_ns) * 1e-9


class ReasonLog:
    """The log's lines on one damper's reason: one as it changes; while it flickers none, and one when it is quiet."""

    def __init__(self) -> None:
        self._reason = ""
        self._changes = self._logged = self._withheld = 0  # the last two: at the last line
        self._changed_s = -inf
        self._is_due = False

    def find_line(self, now_s: float, reason: str, message: str, changes: int, withheld: int) -> str:
        """Return the line to log now, empty for none.

        `changes` of the reason and `withheld` samples are counted since the start.
        """
        quiet = now_s - self._changed_s >= HealthLimits.QUIET_S
        if (reason, changes) != (self._reason, self._changes):
            self._reason, self._changes, self._changed_s, self._is_due = reason, changes, now_s, True
        if not (self._is_due and quiet):
            return ""
        count, samples = changes - self._logged, withheld - self._withheld
        self._logged, self._withheld, self._is_due = changes, withheld, False
        if count > 1:
            message += f"; {count} changes since the last line"
        return message + (f"; {samples} samples withheld" if samples > 1 else "")
