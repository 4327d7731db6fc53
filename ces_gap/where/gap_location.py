"""The locating stage: the regions of the gap, what is left in each of them, and the regions of an unexplained rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.baseline.noise import NoiseModel
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.held_out import HeldOutSeries
from ces_gap.trace import F, Trace
from ces_gap.where.locate import locate, rms_within_regions
from ces_gap.where.regions import GapRegion, Where


@dataclass(frozen=True)
class GapLocation:
    """Where the gap lies, the gap after [N] in each of its regions, and where the rest lies if requested."""

    where: Where
    by_region: tuple[tuple[GapRegion, float], ...]
    rest: Where | None


NOWHERE = GapLocation(Where((), None, 1.0, ()), (), None)


def locate_gap(evidence: Evidence, held_out: Sequence[HeldOutSeries], seed: int, with_rest: bool) -> GapLocation:
    """Return where the gap of all recordings lies, and what the effects leave of it on held-out recordings."""
    held_out_traces = [s.trace for s in held_out]
    traces, corrected = [*evidence.traces, *held_out_traces], [*evidence.alone, *(s.corrected for s in held_out)]
    where = locate(traces, _gaps(traces, corrected), _noise(evidence, traces), seed)
    after, noise = _gaps(held_out_traces, [s.augmented for s in held_out]), _noise(evidence, held_out_traces)
    within = rms_within_regions(where.regions, held_out_traces, after, noise)
    rest = locate(held_out_traces, after, noise, seed) if with_rest else None
    return GapLocation(where, tuple(zip(where.regions, within, strict=True)), rest)


def _gaps(traces: Sequence[Trace], forces: Sequence[F]) -> list[F]:
    """Return measured minus modelled force [N] (n,) on each trace."""
    return [t.force - f for t, f in zip(traces, forces, strict=True)]


def _noise(evidence: Evidence, traces: Sequence[Trace]) -> NoiseModel | list[float]:
    return evidence.noise
