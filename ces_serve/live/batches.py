"""Estimates and bands of one observer go in, as they arrive; batches of a few points for a chart come out."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

BINS = 4  # of each 50 ms: the lowest and highest force of each are kept
SPAN_NS = 50_000_000
MAX_BINS = 400  # of a batch, which is longer after a stall
MAX_WAITING = 2000  # bands or estimates without the other

Sample = tuple[float, float, float]  # position [m], speed [m/s], force [N]
Bounds = tuple[float, float]  # [N]


@dataclass
class EstimateBatches:
    """Pairs estimates with their bands by stamp [ns], and thins them out.

    A band comes after its estimate: where bands come, the estimates after the last one wait for the next batch, once.
    """

    samples: dict[int, Sample] = field(default_factory=dict)
    bounds: dict[int, Bounds] = field(default_factory=dict)
    _newest_ns: int | None = None  # stamp of the last band since the last batch
    _waited: frozenset[int] = frozenset()

    def add_estimate(self, stamp_ns: int, position_m: float, speed_m_s: float, force_N: float) -> None:
        """Receive an estimate."""
        self.samples[stamp_ns] = (position_m, speed_m_s, force_N)

    def add_band(self, stamp_ns: int, lower_N: float, upper_N: float) -> None:
        """Receive the bounds of an estimate, which may be still to come."""
        self.bounds[stamp_ns] = (lower_N, upper_N)
        self._newest_ns = stamp_ns
        while len(self.bounds) > MAX_WAITING:
            del self.bounds[next(iter(self.bounds))]

    def take(self) -> dict[str, Any] | None:
        """Return the points since the last call, None if there are none.

        `count` is the number of estimates behind them; lists `time_ns` (text: JSON's numbers lose nanoseconds),
        `force`, `lower`, `upper` (null without a band), `position` and `speed`.
        """
        samples = sorted(self._take_paired().items())
        if not samples:
            return None
        points = _thin_out(samples)
        bands = [self.bounds.get(stamp, (None, None)) for stamp, _ in points]
        for stamp, _ in samples:
            self.bounds.pop(stamp, None)
        return {
            "count": len(samples),
            "time_ns": [str(stamp) for stamp, _ in points],
            "position": [sample[0] for _, sample in points],
            "speed": [sample[1] for _, sample in points],
            "force": [sample[2] for _, sample in points],
            "lower": [band[0] for band in bands],
            "upper": [band[1] for band in bands],
        }

    def _take_paired(self) -> dict[int, Sample]:
        """Return the samples whose band is there, or is not to be waited for; the others stay."""
        newest_ns, self._newest_ns = self._newest_ns, None
        late = {stamp for stamp in self.samples.keys() - self._waited if newest_ns is not None and stamp > newest_ns}
        taken = {stamp: sample for stamp, sample in self.samples.items() if stamp not in late}
        self.samples = {stamp: self.samples[stamp] for stamp in late}
        self._waited = frozenset(late)
        return taken


def _thin_out(samples: list[tuple[int, Sample]]) -> list[tuple[int, Sample]]:
    """Return the samples with the lowest and the highest force of each part, in time order."""
    span_ns = samples[-1][0] - samples[0][0]
    parts = min(BINS * (1 + span_ns // SPAN_NS), MAX_BINS)
    if len(samples) <= 2 * parts:
        return samples
    kept = set()
    for part in range(parts):
        first, end = part * len(samples) // parts, (part + 1) * len(samples) // parts
        indices = range(first, end)
        kept |= {min(indices, key=lambda k: samples[k][1][2]), max(indices, key=lambda k: samples[k][1][2])}
    return [samples[k] for k in sorted(kept)]
