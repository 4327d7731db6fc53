"""Figures from runs: medians over rounds with their ranges, ratios round by round, verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from contestants import GeneratorRun

MAX_MEDIAN_RATIO = MAX_CPU_RATIO = 1.6  # times the empty C++ relay
MAX_P99_RATIO = 1.5  # times the empty relay of the same executor


@dataclass(frozen=True)
class MedianRange:
    """Median and range of a figure over the rounds."""

    middle: float
    low: float
    high: float

    @classmethod
    def from_values(cls, values: Iterable[float]) -> MedianRange:
        """Return median and range of at least one value."""
        all_values = sorted(values)
        return cls(median(all_values), all_values[0], all_values[-1])

    def text(self, digits: int = 0) -> str:
        return f"{self.middle:,.{digits}f} ({self.low:,.{digits}f} to {self.high:,.{digits}f})"


def median_range(runs: Sequence[GeneratorRun], name: str, scale: float = 1.0) -> MedianRange:
    """Return the spread of a run's figure."""
    return MedianRange.from_values(scale * getattr(run, name) for run in runs)


def ratio(runs: Sequence[GeneratorRun], others: Sequence[GeneratorRun], name: str) -> MedianRange:
    """Return the spread of the ratios of two contestants in the same round, equally disturbed by the machine."""
    return MedianRange.from_values(getattr(a, name) / getattr(b, name) for a, b in zip(runs, others, strict=True))


def row(
    name: str,
    rate_Hz: float,
    runs: Sequence[GeneratorRun],
    cpp: Sequence[GeneratorRun] | None,
    same: Sequence[GeneratorRun] | None,
) -> list[str]:
    """Return a row of the table: figures and, where a baseline exists, ratios."""
    sent, lost, after_pause = (sum(getattr(run, what) for run in runs) for what in ("sent", "lost", "after_pause"))
    cells = [f"{rate_Hz:g}", name, median_range(runs, "p50_us").text(), median_range(runs, "p99_us").text()]
    cells += [f"{max(run.max_us for run in runs) * 1e-3:,.1f}", median_range(runs, "cpu_share", 100.0).text(1)]
    cells += [f"{lost:,} of {sent:,}" + (f" (+ {after_pause:,})" if after_pause else "")]
    cells += [ratio(runs, cpp, figure).text(2) if cpp else "" for figure in ("p50_us", "cpu_share")]
    return [*cells, ratio(runs, same, "p99_us").text(2) if same else ""]


def targets(runs: Sequence[GeneratorRun], cpp: Sequence[GeneratorRun], same: Sequence[GeneratorRun]) -> list[str]:
    """Return a line for each target at 1 kHz."""
    return [
        _target("median beside the C++ relay", ratio(runs, cpp, "p50_us"), MAX_MEDIAN_RATIO),
        _target("CPU beside the C++ relay", ratio(runs, cpp, "cpu_share"), MAX_CPU_RATIO),
        _target("p99 beside the same executor's empty relay", ratio(runs, same, "p99_us"), MAX_P99_RATIO),
    ]


def _target(what: str, spread: MedianRange, limit: float) -> str:
    over = 100.0 * (spread.middle / limit - 1.0)
    verdict = "met" if over <= 0.0 else f"**missed by {over:.0f} %**"
    return f"* {what}: {spread.text(2)} times; target at most {limit:g}: {verdict}"
