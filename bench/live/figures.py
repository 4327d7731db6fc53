"""Figures from runs: medians over rounds with their ranges, ratios round by round, verdicts."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median

from contestants import OBSERVER, TWIN, GeneratorRun

TARGETS = {OBSERVER: (1.5, 1.6), TWIN: (1.15, 1.15)}  # median and CPU, times those of the empty C++ relay
HEADER = ("load", "rate Hz", "node", "median µs", "p99 µs", "worst ms", "CPU % of a core", "lost", "withheld")
RATIOS = ("median ÷ C++ relay", "CPU ÷ C++ relay")


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


def row(load: str, rate_Hz: float, name: str, runs: Sequence[GeneratorRun], relay: Sequence[GeneratorRun]) -> list[str]:
    """Return a row of the table; `relay` are the runs of the empty C++ relay in the same rounds."""
    cells = [load, f"{rate_Hz:g}", name, median_range(runs, "p50_us").text(), median_range(runs, "p99_us").text()]
    cells += [f"{max(run.max_us for run in runs) * 1e-3:,.1f}", median_range(runs, "cpu_share", 100.0).text(1)]
    cells += [f"{sum(run.lost for run in runs):,} of {sum(run.all_sent for run in runs):,}"]
    cells += [f"{max(0, sum(run.without_estimate - run.lost for run in runs)):,}"]
    return cells + [ratio(runs, relay, figure).text(2) for figure in ("p50_us", "cpu_share")]


def verdicts(name: str, runs: Sequence[GeneratorRun], relay: Sequence[GeneratorRun]) -> list[str]:
    """Return a line for each target of a node at 1 kHz on the quiet machine."""
    figures = (("median", "p50_us"), ("CPU", "cpu_share"))
    return [
        _verdict(f"{name}, {what} beside the empty C++ relay", ratio(runs, relay, figure), limit)
        for (what, figure), limit in zip(figures, TARGETS[name], strict=True)
    ]


def _verdict(what: str, spread: MedianRange, limit: float) -> str:
    over = 100.0 * (spread.middle / limit - 1.0)
    verdict = "met" if over <= 0.0 else f"**missed by {over:.0f} %**"
    return f"* {what}: {spread.text(2)} times; target at most {limit:g}: {verdict}"
