"""The gap before and after correction and effects, as bars on one scale with noise and controls."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ces_gap.diagnosis import UNKNOWN, Diagnosis, Explanation, Interval
from ces_gap.report.formatting import effect_name, join_effect_names
from ces_identify.typesetting import three_figures

ROOM = 1.04  # of the longest bar or interval
MAX_CONTROL = 2.0  # of the longest gap: a longer bar of a control is cut off and marked
SAME = 1e-9  # relative difference below which the references had no influence


@dataclass(frozen=True)
class Bar:
    """A bar: label, remark, figures as text, and its length and whisker (start, length) in percent."""

    css: str
    label: str
    remark: str
    value: str
    interval: str
    length: float
    whisker: tuple[float, float] | None


@dataclass(frozen=True)
class GapSteps:
    """The steps from the original to the augmented simulation, the controls, and the noise [%] on their scale."""

    steps: tuple[Bar, ...]
    controls: tuple[Bar, ...]
    noise: float

    @property
    def cut(self) -> bool:
        """Whether a bar is longer than shown."""
        return any(bar.css.endswith(" cut") for bar in (*self.steps, *self.controls))


def build_gap_steps(d: Diagnosis) -> GapSteps:
    """Return the bars of a diagnosis: RMS [N] on held-out recordings, without noise except in the noise's own bar."""
    ends = [d.gap.rms_N, d.gap.ci95_N[1], d.gap.corrected_N, d.gap.corrected_ci95_N[1], d.gap.noise_floor_N]
    longest = max([v for v in ends if math.isfinite(v)] + [1e-9])
    controls = [d.composition.gap_after_N, d.ceiling_after_N, *([d.wrong.gap_after_N] if d.wrong is not None else [])]
    scale = ROOM * min(max([longest, *filter(math.isfinite, controls)]), MAX_CONTROL * longest)
    steps = [_bar(scale, "before", "Original simulation", "", d.gap.rms_N, d.gap.ci95_N)]
    if has_correction(d):
        remark, gap = "learned from the reference recordings", d.gap
        steps.append(_bar(scale, "corrected", "Baseline error removed", remark, gap.corrected_N, gap.corrected_ci95_N))
    if d.composition.effects:
        remark = "the best of the known effects" if d.verdict == UNKNOWN else ""
        label = f"With {join_effect_names(d.composition.effects)}"
        steps.append(_after(scale, "after", label, remark, d.composition))
    remark = f"from {d.gap.noise_source}; subtracted from all other bars"
    noise = _bar(scale, "noise", "Measurement noise", remark, d.gap.noise_floor_N, None)
    return GapSteps((*steps, noise), tuple(_controls(d, scale)), noise.length)


def has_correction(d: Diagnosis) -> bool:
    """Return whether the references changed the gap."""
    return abs(d.gap.corrected_N - d.gap.rms_N) > SAME * d.gap.rms_N


def after_ci95_N(explanation: Explanation) -> Interval | None:
    """Return the interval [N] of the gap after, from that of the shrink; None if it is unknown."""
    left = 1.0 - explanation.shrink
    if not all(map(math.isfinite, (explanation.shrink, *explanation.shrink_ci95))) or left <= 0.0:
        return None
    before = explanation.gap_after_N / left
    low, high = (before * max(1.0 - s, 0.0) for s in explanation.shrink_ci95[::-1])
    return low, high


def _controls(d: Diagnosis, scale: float) -> list[Bar]:
    out = []
    if d.wrong is not None:
        remark = "any flexible effect reduces any gap a little"
        out.append(_after(scale, "wrong", f"Best other effect: {effect_name(d.wrong.effects[0])}", remark, d.wrong))
    if math.isfinite(d.ceiling_after_N):
        remark = "without physics: any smooth function with a memory"
        out.append(_bar(scale, "ceiling", "Generic learner", remark, d.ceiling_after_N, None))
    return out


def _after(scale: float, css: str, label: str, remark: str, explanation: Explanation) -> Bar:
    return _bar(scale, css, label, remark, explanation.gap_after_N, after_ci95_N(explanation))


def _bar(scale: float, css: str, label: str, remark: str, value: float, ci95: Interval | None) -> Bar:
    css = f"{css} cut" if value > scale else css
    if ci95 is None or not all(map(math.isfinite, ci95)):
        return Bar(css, label, remark, three_figures(value), "", _percent(value, scale), None)
    low, high = (_percent(v, scale) for v in ci95)
    interval = f"{three_figures(ci95[0])} to {three_figures(ci95[1])}"
    return Bar(css, label, remark, three_figures(value), interval, _percent(value, scale), (low, high - low))


def _percent(value: float, scale: float) -> float:
    return min(100.0 * value / scale, 100.0) if math.isfinite(value) else 0.0
