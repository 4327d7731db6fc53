"""The charts of a report: shares by region, maps over two axes, forces before and after, and the next experiment."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_gap.diagnosis import GapMap, GapRegion, HeldOutSeries, NextExperiment
from ces_gap.report.formatting import AXES, SIDES, axis_figure, axis_title, percent, region_name
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
from ces_report.typesetting import minus, three_figures

SHARE_SIZE = (300.0, 186.0)
SHARE_BOX = (34.0, 30.0, 258.0, 122.0)  # left, top, width, height [px]
LETTER = 8.4  # [px] of a tick's label in print
FALSE_DISCOVERIES = 0.05  # rate below which a region exceeds the rest of its axis
SHARE_ROOM = 1.08


def draw_share_charts(ident: str, regions: Sequence[GapRegion]) -> list[Markup]:
    """Return a figure for each axis with more than one region, in the order of the axes' names."""
    by_axis = {a: sorted((r for r in regions if r.axis == a), key=lambda r: r.low) for a in AXES}
    return [draw_share_chart(f"{ident}-{axis}", part) for axis, part in by_axis.items() if len(part) > 1]


def draw_share_chart(ident: str, regions: Sequence[GapRegion]) -> Markup:
    """Return the figure of one axis, with regions of equal width."""
    axis, (left, top, width, height) = regions[0].axis, SHARE_BOX
    ends = shares_ci95(regions)
    highest = max(max(r.share_of_energy, r.share_of_samples) for r in regions)
    highest = max(highest, min(float(ends.max(initial=0.0)), 1.3 * highest), 1e-3)
    p = Panel(
        PlotAxis(0.0, len(regions), left, left + width), PlotAxis(0.0, 100.0 * SHARE_ROOM * highest, top + height, top)
    )
    parts = [_grid(p), *(_region(p, k, r, ends[k]) for k, r in enumerate(regions)), _samples(p, regions)]
    parts += [_ticks(p, regions), label(4.0, 14.0, axis_title(axis), "name")]
    most = max(regions, key=lambda r: r.share_of_energy)
    text = f"Most of the energy, {percent(most.share_of_energy)} %, at {region_name(most)}."
    figure = svg(ident, SHARE_SIZE, f"Share of the gap's energy over {AXES[axis][0]}", text, parts, values=True)
    samples = "Force's energy [%]" if axis == "frequency_hz" else "Time [%]"
    rows = [
        (region_name(r), percent(r.share_of_energy), percent(r.share_of_samples), three_figures(r.rms_N))
        for r in regions
    ]
    return figure + value_table(text, ("Region", "Gap's energy [%]", samples, "RMS [N]"), rows)


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
    first, last = region.ci95_N
    interval = f" ({three_figures(first)} to {three_figures(last)})" if math.isfinite(first + last) else ""
    text = (
        f"{region_name(region)}: {percent(region.share_of_energy)} % of the energy, "
        f"{percent(region.share_of_samples)} % {samples}; RMS {three_figures(region.rms_N)} N{interval}"
    )
    return with_value(p.rect(k, k + 1.0, "hit") + bar + whisker, text)


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


MAP_SIZE = (360.0, 326.0)
MAP_BOX = (48.0, 30.0, 304.0, 206.0)  # left, top, width, height [px]
RAMP = (48.0, 290.0, 200.0)  # left, top, width [px]
TABLE_CELLS = 12
SCALE = (0.0, 0.5, 1.0)
EQUAL_WIDTH = "since_reversal_s"  # an axis whose regions are drawn with equal width
MAP_ROOM = 34.0  # [px] for the label of an edge of it


def draw_gap_maps(ident: str, maps: Sequence[GapMap]) -> list[Markup]:
    """Return a figure for each map that has more than one row or column; all share one scale of force."""
    shown = [m for m in maps if min(m.rms_N.shape) > 1]
    worst = max([float(np.nanmax(m.rms_N, initial=0.0)) for m in shown if np.isfinite(m.rms_N).any()] + [1e-9])
    return [_figure(f"{ident}-{i}", m, worst) for i, m in enumerate(shown)]


def _figure(ident: str, m: GapMap, worst: float) -> Markup:
    edges = _displayed_edges(m, 0), _displayed_edges(m, 1)
    p = panel((edges[0][0], edges[0][-1]), (edges[1][0], edges[1][-1]), MAP_BOX)
    rms = m.rms_N.T

    def describe(a: int, b: int) -> str:
        return f"{_span(m, 0, a)}, {_span(m, 1, b)}: {rms[a, b]:.3g} N"

    parts = [_axes(p, m), cells(p, edges, rms, rms / worst, "wrong", describe)]
    parts.append(ramp(*RAMP[:2], [f * worst for f in SCALE], "wrong", "N, RMS gap", RAMP[2]))
    if not np.isfinite(rms).any():
        parts.append(note(p, "too few samples"))
    title = f"RMS gap over {AXES[m.axes[0]][0]} and {AXES[m.axes[1]][0]}"
    text = f"The scale ends at {worst:.3g} N."
    return svg(ident, MAP_SIZE, title, text, parts, values=True) + value_table(
        text, ("Cell", "RMS gap [N]"), _highest(m)
    )


def _highest(m: GapMap) -> list[tuple[str, str]]:
    """Return the cells with the largest gap, with their values."""
    rms = m.rms_N.T
    order = np.argsort(-np.nan_to_num(rms), axis=None)[:TABLE_CELLS]
    cells_of = [(a, b) for a, b in zip(*np.unravel_index(order, rms.shape), strict=True) if rms[a, b] > 0.0]
    return [(f"{_span(m, 0, a)}, {_span(m, 1, b)}", f"{rms[a, b]:.3g}") for a, b in cells_of]


def _displayed_edges(m: GapMap, k: int) -> F:
    """Return the edges as drawn: in the displayed unit, or as numbers 0, 1, 2 and so on."""
    if m.axes[k] == EQUAL_WIDTH:
        return np.arange(len(m.edges[k]), dtype=np.float64)
    return np.asarray(AXES[m.axes[k]][2] * m.edges[k])


def _axes(p: Panel, m: GapMap) -> str:
    """Return grid and labels; an axis with equal widths, always the vertical one, is labelled at its edges."""
    if m.axes[1] != EQUAL_WIDTH:
        return axes(p, axis_title(m.axes[0]), axis_title(m.axes[1]), 6, 5)
    out = [axes(p, axis_title(m.axes[0]), axis_title(m.axes[1]), 6, 0)]
    stride = max(1, round(MAP_ROOM / 2 / float(p.y.px(0.0) - p.y.px(1.0))))
    texts = [axis_figure(EQUAL_WIDTH, e) for e in m.edges[1]]
    shown = range(0, len(texts), stride)
    out += [label(p.x.start - 7, float(p.y.px(float(k))) + 4, texts[k], "tick end") for k in shown]
    return "\n".join(out)


def _span(m: GapMap, k: int, cell: int) -> str:
    name, unit, _ = AXES[m.axes[k]]
    low, high = (axis_figure(m.axes[k], e) for e in m.edges[k][cell : cell + 2])
    return minus(f"{name} {low} to {high} {unit}")


MAX_DOTS = 2400  # of each force
WINDOW_S = 1.0  # [s]
LEFT_OVER = "Gap, measured \N{MINUS SIGN} simulated [N]"
LINES = {"simulated": "simulation", "augmented": "with effects"}


@dataclass(frozen=True)
class LargestErrors:
    """The ticks [start, stop) of one recording with the most energy of the gap."""

    series: HeldOutSeries
    start: int
    stop: int


def speed_force(ident: str, held_out: Sequence[HeldOutSeries], effects: str) -> list[Markup]:
    """Return force and gap over speed for the original simulation and, if there are `effects`, the augmented one."""
    ticks = _sample_ticks(held_out)
    before = _speed_force(f"{ident}-before", ticks, "simulated", "simulation")
    return [before, _speed_force(f"{ident}-after", ticks, "augmented", f"with {effects}")] if effects else [before]


def find_largest_errors(held_out: Sequence[HeldOutSeries]) -> LargestErrors | None:
    """Return the second in which measured minus simulated force has the most energy; None if no tick is usable."""
    candidates = [w for s in held_out if (w := _largest_errors_in(s)) is not None]
    return max(candidates, key=lambda pair: pair[0])[1] if candidates else None


def time_plot(ident: str, worst: LargestErrors, effects: str) -> Markup:
    """Return forces and gap of the recording with the worst second, at first over that second.

    If there are `effects`, the augmented simulation is shown as well.
    """
    trace, time = worst.series.trace, worst.series.trace.time_s
    forces = {"simulated": trace.simulated, "augmented": worst.series.augmented}
    shown = {css: force for css, force in forces.items() if effects or css == "simulated"}
    gaps = [
        PlotLine(LINES[css], time, np.where(trace.usable, trace.force - force, np.nan), css)
        for css, force in shown.items()
    ]
    lines = [PlotLine("measured", time, trace.force), *(PlotLine(LINES[c], time, f, c) for c, f in shown.items())]
    areas = [
        PlotArea("Force [N]", lines, height=196.0),
        PlotArea(LEFT_OVER, gaps, height=110.0, around_zero=True),
        PlotArea("Gap over the whole recording [N]", gaps, height=50.0, around_zero=True, whole=True),
    ]
    view = float(time[worst.start]), float(time[worst.stop - 1])
    text = f"{trace.name}, at first {view[0]:.2f} to {view[1]:.2f} s."
    plot = Plot(ident, "The worst second", text, "Time [s]", areas, width=660.0, x_view=view)
    return draw_plot(plot)


def experiment_plot(ident: str, experiment: NextExperiment) -> Markup:
    """Return stroke [mm] and current [A] of an experiment over time."""
    time, stroke = experiment.time_s, 1e3 * experiment.position_m
    current = experiment.current_A
    areas = [
        PlotArea("Stroke [mm]", [PlotLine("stroke", time, stroke, "stroke")], height=124.0, y_ticks=4),
        PlotArea(
            "Current [A]",
            [PlotLine("current", time, current, "feed")],
            height=64.0,
            y_range=span_of(current, np.zeros(1)),
            y_ticks=2,
        ),
    ]
    length = f"{float(time[-1]):.3g} s" if len(time) else "no signals"
    text = f"{experiment.name}, {length}."
    return draw_plot(Plot(ident, "The next experiment", text, "Time [s]", areas, width=530.0, legend=False))


def _sample_ticks(held_out: Sequence[HeldOutSeries]) -> dict[str, F]:
    """Return speed, measured, simulated and augmented force at random ticks of all recordings."""

    def usable(values: Callable[[HeldOutSeries], F]) -> F:
        return usable_values([s.trace for s in held_out], [values(s) for s in held_out])

    speed = usable(lambda s: s.trace.inputs.speed)
    chosen = np.random.default_rng(0).permutation(len(speed))[
        :MAX_DOTS
    ]  # random, because a stride would alias with a sine
    return {
        "speed": speed[chosen],
        "measured": usable(lambda s: s.trace.force)[chosen],
        "simulated": usable(lambda s: s.trace.simulated)[chosen],
        "augmented": usable(lambda s: s.augmented)[chosen],
    }


def _speed_force(ident: str, of: dict[str, F], css: str, name: str) -> Markup:
    """Return measured force and the force of style `css`, labelled `name`, over speed, and their difference."""
    speed, measured = of["speed"], of["measured"]
    rest = np.concatenate([measured - of["simulated"], measured - of["augmented"]])
    forces = [PlotDots("measured", speed, measured), PlotDots(name, speed, of[css], f"{css} dots")]
    areas = [
        PlotArea(
            "Force [N]", forces, height=226.0, y_range=span_of(measured, of["simulated"], of["augmented"]), y_ticks=6
        ),
        PlotArea(
            LEFT_OVER,
            [PlotDots(name, speed, measured - of[css], f"{css} dots")],
            height=104.0,
            y_range=around_zero(rest),
            around_zero=True,
        ),
    ]
    title = f"Force over speed, measured and {name}"
    plot = Plot(
        ident,
        title,
        f"{len(speed)} ticks.",
        "Speed [m/s], positive in compression",
        areas,
        width=530.0,
        group="speed-force",
        free=True,
        x_ticks=6,
    )
    return draw_plot(plot)


def _largest_errors_in(series: HeldOutSeries) -> tuple[float, LargestErrors] | None:
    trace = series.trace
    length = min(max(2, round(WINDOW_S * trace.rate_Hz)), len(trace))
    square = np.where(trace.usable, (trace.force - trace.simulated) ** 2, 0.0)
    total = np.concatenate([[0.0], np.cumsum(square)])
    energy = total[length:] - total[:-length]
    start = int(np.argmax(energy))
    return (float(energy[start]), LargestErrors(series, start, start + length)) if energy[start] > 0.0 else None
