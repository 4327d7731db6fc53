"""The gap before and after as bars on one scale: what references and effects took, noise, controls."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ces_gap.diagnosis import UNKNOWN, Diagnosis, Explanation, Interval
from ces_gap.report.formatting import effect_name, join_effect_names, newtons

ROOM = 1.04  # of the longest bar or interval
SAME = 1e-9  # relative difference below which nothing was learnt from references


@dataclass(frozen=True)
class Bar:
    """A bar: what it is, a remark, its length and whisker (start, length) in percent, and its figures as text."""

    css: str
    label: str
    remark: str
    value: str
    interval: str
    length: float
    whisker: tuple[float, float] | None


@dataclass(frozen=True)
class GapSteps:
    """The steps from the simulation as given to the best found, the controls, and the noise [%] on their scale."""

    steps: tuple[Bar, ...]
    controls: tuple[Bar, ...]
    noise: float


def build_gap_steps(d: Diagnosis) -> GapSteps:
    """Return the bars of a diagnosis; RMS [N] on held-out recordings, noise taken out of all but its own."""
    ends = [d.gap.rms_N, d.gap.ci95_N[1], d.gap.corrected_N, d.gap.corrected_ci95_N[1], d.gap.noise_floor_N]
    scale = ROOM * max([v for v in ends if math.isfinite(v)] + [1e-9])
    steps = [_bar(scale, "before", "Simulation as given", "", d.gap.rms_N, d.gap.ci95_N)]
    if has_correction(d):
        remark = "learnt from the reference recordings"
        steps.append(
            _bar(scale, "corrected", "Its own error removed", remark, d.gap.corrected_N, d.gap.corrected_ci95_N)
        )
    if d.composition.effects:
        steps.append(
            _after(scale, "after", f"With {join_effect_names(d.composition.effects)}", _best(d), d.composition)
        )
    noise = _bar(scale, "noise", "Measurement noise", "taken out of all the others", d.gap.noise_floor_N, None)
    return GapSteps((*steps, noise), tuple(_controls(d, scale)), noise.length)


def has_correction(d: Diagnosis) -> bool:
    """Return whether references taught the simulation's own error."""
    return abs(d.gap.corrected_N - d.gap.rms_N) > SAME * d.gap.rms_N


def after_ci95_N(explained: Explanation) -> Interval | None:
    """Return the interval [N] of the gap after, from that of the shrink; None if it is not known."""
    left = 1.0 - explained.shrink
    if not all(map(math.isfinite, (explained.shrink, *explained.shrink_ci95))) or left <= 0.0:
        return None
    before = explained.gap_after_N / left
    low, high = (before * max(1.0 - s, 0.0) for s in explained.shrink_ci95[::-1])
    return low, high


def _best(d: Diagnosis) -> str:
    return "the best of the known effects" if d.verdict == UNKNOWN else ""


def _controls(d: Diagnosis, scale: float) -> list[Bar]:
    out = []
    if d.wrong is not None:
        remark = "any flexible effect closes some of any gap"
        out.append(_after(scale, "wrong", f"Best other effect: {effect_name(d.wrong.effects[0])}", remark, d.wrong))
    if math.isfinite(d.ceiling_after_N):
        remark = "a learner without physics"
        out.append(_bar(scale, "ceiling", "The most that can be explained", remark, d.ceiling_after_N, None))
    return out


def _after(scale: float, css: str, label: str, remark: str, explained: Explanation) -> Bar:
    return _bar(scale, css, label, remark, explained.gap_after_N, after_ci95_N(explained))


def _bar(scale: float, css: str, label: str, remark: str, value: float, ci95: Interval | None) -> Bar:
    if ci95 is None or not all(map(math.isfinite, ci95)):
        return Bar(css, label, remark, newtons(value), "", _percent(value, scale), None)
    low, high = (_percent(v, scale) for v in ci95)
    interval = f"{newtons(ci95[0])} to {newtons(ci95[1])}"
    return Bar(css, label, remark, newtons(value), interval, _percent(value, scale), (low, high - low))


def _percent(value: float, scale: float) -> float:
    return min(100.0 * value / scale, 100.0) if math.isfinite(value) else 0.0
