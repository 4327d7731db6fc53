"""Charts of the share of the gap's energy and of the samples in each region of an axis."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from ces_gap.diagnosis import GapRegion
from ces_gap.report.formatting import AXES, SIDES, axis_figure, axis_title, percent, region_name
from ces_identify.report.drawing import F, Panel, PlotAxis, label, svg, with_value
from ces_identify.report.plot_table import value_table
from ces_identify.typesetting import three_figures

SIZE = (300.0, 186.0)
BOX = (34.0, 30.0, 258.0, 122.0)  # left, top, width, height [px]
LETTER = 8.4  # [px] of a tick's label in print
FALSE_DISCOVERIES = 0.05  # rate below which a region exceeds the rest of its axis
ROOM = 1.08


def draw_share_charts(ident: str, regions: Sequence[GapRegion]) -> list[Markup]:
    """Return a figure for each axis with more than one region, in the order of the axes' names."""
    by_axis = {a: sorted((r for r in regions if r.axis == a), key=lambda r: r.low) for a in AXES}
    return [draw_share_chart(f"{ident}-{axis}", part) for axis, part in by_axis.items() if len(part) > 1]


def draw_share_chart(ident: str, regions: Sequence[GapRegion]) -> Markup:
    """Return the figure of one axis, with regions of equal width."""
    axis, (left, top, width, height) = regions[0].axis, BOX
    ends = shares_ci95(regions)
    highest = max(max(r.share_of_energy, r.share_of_samples) for r in regions)
    highest = max(highest, min(float(ends.max(initial=0.0)), 1.3 * highest), 1e-3)
    p = Panel(PlotAxis(0.0, len(regions), left, left + width), PlotAxis(0.0, 100.0 * ROOM * highest, top + height, top))
    parts = [_grid(p), *(_region(p, k, r, ends[k]) for k, r in enumerate(regions)), _samples(p, regions)]
    parts += [_ticks(p, regions), label(4.0, 14.0, axis_title(axis), "name")]
    most = max(regions, key=lambda r: r.share_of_energy)
    text = f"Most of the energy, {percent(most.share_of_energy)} %, at {region_name(most)}."
    figure = svg(ident, SIZE, f"Share of the gap's energy over {AXES[axis][0]}", text, parts, values=True)
    samples = "Force's energy [%]" if axis == "frequency_hz" else "Time [%]"
    return figure + value_table(text, ("Region", "Gap's energy [%]", samples, "RMS [N]"), [_row(r) for r in regions])


def _row(region: GapRegion) -> tuple[str, ...]:
    shares = percent(region.share_of_energy), percent(region.share_of_samples)
    return region_name(region), *shares, three_figures(region.rms_N)


def shares_ci95(regions: Sequence[GapRegion]) -> F:
    """Return intervals (r, 2) of the shares of energy on one axis, from those of the RMS with the total fixed."""
    fullest = max(regions, key=lambda r: r.share_of_energy)
    whole = _energy(fullest, fullest.rms_N) / max(fullest.share_of_energy, 1e-12)
    ends = [[_energy(r, end) for end in r.ci95_N] for r in regions]
    return np.asarray(np.nan_to_num(ends) / max(whole, 1e-12))


def _energy(region: GapRegion, rms_N: float) -> float:
    """Return the energy per sample of the whole: a frequency band contains all samples, other regions a part."""
    return rms_N**2 * (1.0 if region.axis == "frequency_hz" else region.share_of_samples)


def _grid(p: Panel) -> str:
    out = []
    for value, text in p.y.ticks(3):
        y = float(p.y.px(value))
        out.append(f'<path class="{"grid" if value else "zero"}" d="M{p.x.start:.1f},{y:.1f}H{p.x.stop:.1f}"/>')
        out.append(label(p.x.start - 5, y + 4, text, "tick end"))
    return "\n".join(out)


def _region(p: Panel, k: int, region: GapRegion, ends: F) -> str:
    """Return the bar of a region with its whisker and its values, in full colour if it exceeds the rest."""
    css = "energy beyond" if region.q_value <= FALSE_DISCOVERIES else "energy"
    bar = p.rect(k + 0.06, k + 0.94, css, 0.0, 100.0 * region.share_of_energy)
    low, high = (float(v) for v in p.y.px(np.clip(100.0 * ends, 0.0, p.y.high)))
    middle = float(p.x.px(k + 0.5))
    whisker = f'<path class="span" d="M{middle:.1f},{low:.1f}V{high:.1f}"/>'
    samples = "of the measured force's" if region.axis == "frequency_hz" else "of the time"
    text = (
        f"{region_name(region)}: {percent(region.share_of_energy)} % of the energy, "
        f"{percent(region.share_of_samples)} % {samples}; RMS {three_figures(region.rms_N)} N{_interval(region)}"
    )
    return with_value(p.rect(k, k + 1.0, "hit") + bar + whisker, text)


def _interval(region: GapRegion) -> str:
    """Return the 95 % interval of a region's RMS gap in brackets, nothing if it is unknown."""
    low, high = region.ci95_N
    return f" ({three_figures(low)} to {three_figures(high)})" if math.isfinite(low + high) else ""


def _samples(p: Panel, regions: Sequence[GapRegion]) -> str:
    """Return a stepped line over the shares of samples."""
    x = np.repeat(p.x.px(np.arange(len(regions) + 1.0)), 2)[1:-1]
    y = np.repeat(p.y.px(np.array([100.0 * r.share_of_samples for r in regions])), 2)
    d = "L".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))
    return f'<path class="outline" d="M{d}"/>'


def _ticks(p: Panel, regions: Sequence[GapRegion]) -> str:
    """Return labels of as many edges as fit; the sides of a direction by name."""
    axis, y = regions[0].axis, p.y.start + 19
    if axis == "direction" and len(regions) == 2:
        return "\n".join(label(float(p.x.px(k + 0.5)), y, SIDES[k], "tick mid") for k in (0, 1))
    edges = [*(r.low for r in regions), regions[-1].high]
    texts = [axis_figure(axis, e) for e in edges]
    room = (p.x.stop - p.x.start) / len(regions)
    stride = max(1, math.ceil((LETTER * max(map(len, texts)) + 4) / room))
    middle = edges.index(0.0) if 0.0 in edges else 0
    shown = range(middle % stride, len(edges), stride)
    return "\n".join(label(float(p.x.px(k)), y, texts[k], "tick mid") for k in shown)
