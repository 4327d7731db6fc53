"""From runs to what is told: medians over rounds with their ranges, ratios round by round, verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from contestants import Run

MOST_MEDIAN = MOST_CPU = 1.6  # times the empty C++ relay
MOST_P99 = 1.5  # times the empty relay of the same executor


@dataclass(frozen=True)
class Spread:
    """Median and range of some figure over the rounds."""

    middle: float
    least: float
    most: float

    @classmethod
    def of(cls, values: Iterable[float]) -> Spread:
        """Return that of at least one value."""
        all_values = sorted(values)
        return cls(median(all_values), all_values[0], all_values[-1])

    def text(self, digits: int = 0) -> str:
        return f"{self.middle:,.{digits}f} ({self.least:,.{digits}f} to {self.most:,.{digits}f})"


def spread(runs: Sequence[Run], name: str, scale: float = 1.0) -> Spread:
    """Return the spread of a run's figure."""
    return Spread.of(scale * getattr(run, name) for run in runs)


def ratio(runs: Sequence[Run], others: Sequence[Run], name: str) -> Spread:
    """Return the spread of the ratios of two contestants in the same round, as noise of the machine hits both."""
    return Spread.of(getattr(a, name) / getattr(b, name) for a, b in zip(runs, others, strict=True))


def row(
    name: str, rate_Hz: float, runs: Sequence[Run], cpp: Sequence[Run] | None, same: Sequence[Run] | None
) -> list[str]:
    """Return a row of the table: figures and, where there is something to compare with, ratios."""
    sent, lost, after_pause = (sum(getattr(run, what) for run in runs) for what in ("sent", "lost", "after_pause"))
    cells = [f"{rate_Hz:g}", name, spread(runs, "p50_us").text(), spread(runs, "p99_us").text()]
    cells += [f"{max(run.max_us for run in runs) * 1e-3:,.1f}", spread(runs, "cpu_share", 100.0).text(1)]
    cells += [f"{lost:,} of {sent:,}" + (f" (+ {after_pause:,})" if after_pause else "")]
    cells += [ratio(runs, cpp, figure).text(2) if cpp else "" for figure in ("p50_us", "cpu_share")]
    return [*cells, ratio(runs, same, "p99_us").text(2) if same else ""]


def targets(runs: Sequence[Run], cpp: Sequence[Run], same: Sequence[Run]) -> list[str]:
    """Return a line for each target at 1 kHz."""
    return [
        _target("median beside the C++ relay", ratio(runs, cpp, "p50_us"), MOST_MEDIAN),
        _target("CPU beside the C++ relay", ratio(runs, cpp, "cpu_share"), MOST_CPU),
        _target("p99 beside the same executor's empty relay", ratio(runs, same, "p99_us"), MOST_P99),
    ]


def _target(what: str, found: Spread, most: float) -> str:
    over = 100.0 * (found.middle / most - 1.0)
    verdict = "met" if over <= 0.0 else f"**missed by {over:.0f} %**"
    return f"* {what}: {found.text(2)} times; target at most {most:g}: {verdict}"
