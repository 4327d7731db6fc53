"""The charts of a report: shares by region, maps over two axes, forces before and after, and the next experiment."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_gap.diagnosis import GapMap, GapRegion, HeldOutSeries, NextExperiment
from ces_gap.limits import RegionLimits
from ces_gap.report.formatting import AXES, SIDES, axis_figure, axis_range, axis_title, percent, region_name
from ces_gap.trace import usable_values
from ces_report.drawing import (
    F,
    Panel,
    PlotAxis,
    around_zero,
    axes,
    cells,
    label,
    note,
    panel,
    ramp,
    span_of,
    svg,
    with_value,
)
from ces_report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot, value_table
from ces_report.typesetting import MAX_FIGURES, format_number, format_range, three_figures

SHARE_SIZE = (300.0, 186.0)
SHARE_BOX = (34.0, 30.0, 258.0, 122.0)  # left, top, width, height [px]
LETTER = 8.4  # [px] of a tick's label in print
SHARE_ROOM = 1.08
MAP_SIZE = (360.0, 326.0)
MAP_BOX = (48.0, 30.0, 304.0, 206.0)  # left, top, width, height [px]
RAMP = (48.0, 290.0, 200.0)  # left, top, width [px]
TABLE_CELLS = 12
SCALE = (0.0, 0.5, 1.0)
EQUAL_WIDTH = "since_reversal_s"  # an axis whose regions are drawn with equal width, always the vertical one
MAP_ROOM = 34.0  # [px] for the label of an edge of it
MAX_DOTS = 2400  # of each force
WINDOW_S = 1.0  # [s]
LEFT_OVER = "Gap, measured \N{MINUS SIGN} simulated [N]"


@dataclass(frozen=True)
class LargestErrors:
    """The ticks [start, stop) of one recording with the most energy of the gap."""

    series: HeldOutSeries
    start: int
    stop: int


def draw_share_charts(ident: str, regions: Sequence[GapRegion]) -> list[Markup]:
    """Return a figure for each axis with more than one region, in the order of the axes' names."""
    by_axis = {a: sorted((r for r in regions if r.axis == a), key=lambda r: r.low) for a in AXES}
    return [_draw_shares(f"{ident}-{axis}", part) for axis, part in by_axis.items() if len(part) > 1]


def _draw_shares(ident: str, regions: Sequence[GapRegion]) -> Markup:
    """Return the figure of one axis, with regions of equal width."""
    axis, (left, top, width, height), ends = regions[0].axis, SHARE_BOX, shares_ci95(regions)
    highest = max(max(r.share_of_energy, r.share_of_samples) for r in regions)
    highest = 100.0 * SHARE_ROOM * max(highest, min(float(ends.max(initial=0.0)), 1.3 * highest), 1e-3)
    p = Panel(PlotAxis(0.0, len(regions), left, left + width), PlotAxis(0.0, highest, top + height, top))
    parts = []
    for value, tick in p.y.ticks(3):
        y = float(p.y.px(value))
        parts.append(f'<path class="{"grid" if value else "zero"}" d="M{p.x.start:.1f},{y:.1f}H{p.x.stop:.1f}"/>')
        parts.append(label(p.x.start - 5, y + 4, tick, "tick end"))
    parts += [_draw_region(p, k, r, ends[k]) for k, r in enumerate(regions)]
    x = np.repeat(p.x.px(np.arange(len(regions) + 1.0)), 2)[1:-1]
    samples = np.repeat(p.y.px(np.array([100.0 * r.share_of_samples for r in regions])), 2)
    line = "L".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, samples, strict=True))
    parts.append(f'<path class="outline" d="M{line}"/>')
    parts += [*_share_ticks(p, regions), label(4.0, 14.0, axis_title(axis), "name")]
    most = max(regions, key=lambda r: r.share_of_energy)
    text = f"Most of the energy, {percent(most.share_of_energy)} %, at {region_name(most)}."
    heads = ("Region", "Gap's energy [%]", "Force's energy [%]" if axis == "frequency_hz" else "Time [%]", "RMS [N]")
    shares = [(r, percent(r.share_of_energy), percent(r.share_of_samples)) for r in regions]
    rows = [(region_name(r), energy, time, three_figures(r.rms_N)) for r, energy, time in shares]
    figure = svg(ident, SHARE_SIZE, f"Share of the gap's energy over {AXES[axis][0]}", text, parts, values=True)
    return figure + value_table(text, heads, rows)


def shares_ci95(regions: Sequence[GapRegion]) -> F:
    """Return intervals (r, 2) of the shares of energy on one axis, from those of the RMS with the total fixed."""
    part = np.array([1.0 if r.axis == "frequency_hz" else r.share_of_samples for r in regions])  # bands: all samples
    fullest = max(range(len(regions)), key=lambda k: regions[k].share_of_energy)
    whole = regions[fullest].rms_N ** 2 * part[fullest] / max(regions[fullest].share_of_energy, 1e-12)
    ends = np.array([r.ci95_N for r in regions]) ** 2 * part[:, None]
    return np.asarray(np.nan_to_num(ends) / max(whole, 1e-12))


def _draw_region(p: Panel, k: int, region: GapRegion, ends: F) -> str:
    """Return the bar of a region with its whisker and its values, in full colour if it exceeds the rest."""
    css = "energy beyond" if region.q_value <= RegionLimits.SIGNIFICANT else "energy"
    bar = p.rect(k + 0.06, k + 0.94, css, 0.0, 100.0 * region.share_of_energy)
    low, high = (float(v) for v in p.y.px(np.clip(100.0 * ends, 0.0, p.y.high)))
    whisker = f'<path class="span" d="M{float(p.x.px(k + 0.5)):.1f},{low:.1f}V{high:.1f}"/>'
    samples = "of the measured force's" if region.axis == "frequency_hz" else "of the time"
    first, last = region.ci95_N
    interval = f" ({format_range(first, last)})" if math.isfinite(first + last) else ""
    text = (
        f"{region_name(region)}: {percent(region.share_of_energy)} % of the energy, "
        f"{percent(region.share_of_samples)} % {samples}; RMS {three_figures(region.rms_N)} N{interval}"
    )
    return with_value(p.rect(k, k + 1.0, "hit") + bar + whisker, text)


def _share_ticks(p: Panel, regions: Sequence[GapRegion]) -> list[str]:
    """Return labels of as many edges as fit; the sides of a direction by name."""
    axis, y = regions[0].axis, p.y.start + 19
    if axis == "direction" and len(regions) == 2:
        return [label(float(p.x.px(k + 0.5)), y, SIDES[k], "tick mid") for k in (0, 1)]
    edges = [*(r.low for r in regions), regions[-1].high]
    several = ([axis_figure(axis, e, figures) for e in edges] for figures in range(3, MAX_FIGURES + 1))
    texts = next(t for t in several if len({*t}) == len(edges))
    stride = max(1, math.ceil((LETTER * max(map(len, texts)) + 4) / ((p.x.stop - p.x.start) / len(regions))))
    first = (edges.index(0.0) if 0.0 in edges else 0) % stride
    return [label(float(p.x.px(k)), y, texts[k], "tick mid") for k in range(first, len(edges), stride)]


def draw_gap_maps(ident: str, maps: Sequence[GapMap]) -> list[Markup]:
    """Return a figure for each map that has more than one row or column; all share one scale of force."""
    shown = [m for m in maps if min(m.rms_N.shape) > 1]
    worst = max([float(np.nanmax(m.rms_N, initial=0.0)) for m in shown if np.isfinite(m.rms_N).any()] + [1e-9])
    return [_draw_map(f"{ident}-{i}", m, worst) for i, m in enumerate(shown)]


def _draw_map(ident: str, m: GapMap, worst: float) -> Markup:
    rms, (across, up) = m.rms_N.T, m.axes
    texts = {at: format_number(value) for at, value in np.ndenumerate(rms)}
    x = np.asarray(AXES[across][2] * m.edges[0])
    y = np.arange(len(m.edges[1]), dtype=np.float64) if up == EQUAL_WIDTH else np.asarray(AXES[up][2] * m.edges[1])
    p = panel((x[0], x[-1]), (y[0], y[-1]), MAP_BOX)
    parts = [axes(p, axis_title(across), axis_title(up), 6, 0 if up == EQUAL_WIDTH else 5)]
    if up == EQUAL_WIDTH:
        stride = max(1, round(MAP_ROOM / 2 / float(p.y.px(0.0) - p.y.px(1.0))))
        rows = [(k, axis_figure(up, m.edges[1][k])) for k in range(0, len(y), stride)]
        parts += [label(p.x.start - 7, float(p.y.px(float(k))) + 4, text, "tick end") for k, text in rows]

    def name(a: int, b: int) -> str:
        spans = [(axis, *edges[cell : cell + 2]) for axis, edges, cell in zip(m.axes, m.edges, (a, b), strict=True)]
        return ", ".join(f"{AXES[axis][0]} {axis_range(axis, low, high)}" for axis, low, high in spans)

    parts.append(cells(p, (x, y), rms, rms / worst, "wrong", lambda a, b: f"{name(a, b)}: {texts[a, b]} N"))
    parts.append(ramp(*RAMP[:2], [f * worst for f in SCALE], "wrong", "N, RMS gap", RAMP[2]))
    if not np.isfinite(rms).any():
        parts.append(note(p, "too few samples"))
    text = f"The scale ends at {format_number(worst)} N."
    figure = svg(ident, MAP_SIZE, f"RMS gap over {AXES[across][0]} and {AXES[up][0]}", text, parts, values=True)
    order = np.argsort(-np.nan_to_num(rms), axis=None)[:TABLE_CELLS]
    largest = [(a, b) for a, b in zip(*np.unravel_index(order, rms.shape), strict=True) if rms[a, b] > 0.0]
    return figure + value_table(text, ("Cell", "RMS gap [N]"), [(name(a, b), texts[a, b]) for a, b in largest])


def speed_force(ident: str, held_out: Sequence[HeldOutSeries], effects: str) -> list[Markup]:
    """Return force and gap over speed for the original simulation and, if there are `effects`, the augmented one."""
    traces = [s.trace for s in held_out]
    rows = [(s.trace.inputs.speed, s.trace.force, s.trace.simulated_as_logged, s.augmented) for s in held_out]
    every = [usable_values(traces, values) for values in zip(*rows, strict=True)]
    chosen = np.random.default_rng(0).permutation(len(every[0]))[:MAX_DOTS]  # a stride would alias with a sine
    speed, measured, before, after = (values[chosen] for values in every)
    forces, gaps = span_of(measured, before, after), around_zero(np.concatenate([measured - before, measured - after]))
    figures = []
    for when, css, name, force in (
        ("before", "simulated", "simulation", before),
        ("after", "augmented", f"with {effects}", after),
    )[: 2 if effects else 1]:
        dots = [PlotDots("measured", speed, measured), PlotDots(name, speed, force, f"{css} dots")]
        gap = PlotDots(name, speed, measured - force, f"{css} dots")
        areas = [
            PlotArea("Force [N]", dots, height=226.0, y_range=forces, y_ticks=6),
            PlotArea(LEFT_OVER, [gap], height=104.0, y_range=gaps, around_zero=True),
        ]
        title, text = f"Force over speed, measured and {name}", f"{len(speed)} ticks."
        x_label = "Speed [m/s], positive in compression"
        plot = Plot(f"{ident}-{when}", title, text, x_label, areas, 530.0, group="speed-force", free=True, x_ticks=6)
        figures.append(draw_plot(plot))
    return figures


def find_largest_errors(held_out: Sequence[HeldOutSeries]) -> LargestErrors | None:
    """Return the second in which measured minus simulated force has the most energy; None if no tick is usable."""
    largest, most = None, 0.0
    for series in held_out:
        trace = series.trace
        length = min(max(2, round(WINDOW_S * trace.rate_Hz)), len(trace))
        square = np.where(trace.usable, (trace.force - trace.simulated_as_logged) ** 2, 0.0)
        total = np.concatenate([[0.0], np.cumsum(square)])
        energy = total[length:] - total[:-length]
        start = int(np.argmax(energy))
        if energy[start] > most:
            largest, most = LargestErrors(series, start, start + length), float(energy[start])
    return largest


def time_plot(ident: str, worst: LargestErrors, effects: str) -> Markup:
    """Return forces and gap of the recording with the worst second, at first over that second.

    If there are `effects`, the augmented simulation is shown as well.
    """
    trace, time = worst.series.trace, worst.series.trace.time_s
    shown = [
        ("simulation", trace.simulated_as_logged, "simulated"),
        (f"with {effects}", worst.series.augmented, "augmented"),
    ]
    lines, gaps = [PlotLine("measured", time, trace.force)], []
    for name, force, css in shown[: 2 if effects else 1]:
        lines.append(PlotLine(name, time, force, css))
        gaps.append(PlotLine(name, time, np.where(trace.usable, trace.force - force, np.nan), css))
    areas = [
        PlotArea("Force [N]", lines, height=196.0),
        PlotArea(LEFT_OVER, gaps, height=110.0, around_zero=True),
        PlotArea("Gap over the whole recording [N]", gaps, height=50.0, around_zero=True, whole=True),
    ]
    view = float(time[worst.start]), float(time[worst.stop - 1])
    text = f"{trace.name}, at first {view[0]:.2f} to {view[1]:.2f} s."
    return draw_plot(Plot(ident, "The worst second", text, "Time [s]", areas, width=660.0, x_view=view))


def experiment_plot(ident: str, experiment: NextExperiment) -> Markup:
    """Return stroke [mm] and current [A] of an experiment over time."""
    time, current = experiment.time_s, experiment.current_A
    stroke = PlotLine("stroke", time, 1e3 * experiment.position_m, "stroke")
    feed = PlotLine("current", time, current, "feed")
    areas = [
        PlotArea("Stroke [mm]", [stroke], height=124.0, y_ticks=4),
        PlotArea("Current [A]", [feed], height=64.0, y_range=span_of(current, np.zeros(1)), y_ticks=2),
    ]
    text = f"{experiment.name}, {format_number(float(time[-1]))} s." if len(time) else f"{experiment.name}, no signals."
    return draw_plot(Plot(ident, "The next experiment", text, "Time [s]", areas, width=530.0, legend=False))
