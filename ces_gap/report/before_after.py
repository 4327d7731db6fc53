"""Plots before and after: force over speed, the worst second over time, and the next experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_gap.diagnosis import HeldOutSeries, NextExperiment
from ces_identify.report.drawing import F, around_zero, span_of
from ces_identify.report.plot import Plot, PlotArea, PlotDots, PlotLine, draw_plot

MAX_DOTS = 2400  # of each force
WORST_S = 1.0  # [s]
LEFT_OVER = "Gap, measured \N{MINUS SIGN} simulated [N]"
LINES = {"simulated": "simulation", "augmented": "with effects"}


@dataclass(frozen=True)
class Worst:
    """The ticks [start, stop) of one recording with the most energy of the gap."""

    series: HeldOutSeries
    start: int
    stop: int


def speed_force(ident: str, held_out: Sequence[HeldOutSeries], effects: str) -> list[Markup]:
    """Return force and gap over speed for the original simulation and, if there are `effects`, the augmented one."""
    ticks = _sample_ticks(held_out)
    before = _speed_force(f"{ident}-before", ticks, "simulated", "simulation")
    return [before, _speed_force(f"{ident}-after", ticks, "augmented", f"with {effects}")] if effects else [before]


def worst_second(held_out: Sequence[HeldOutSeries]) -> Worst | None:
    """Return the second in which measured minus simulated force has the most energy; None if no tick is usable."""
    candidates = [w for s in held_out if (w := _find_worst(s)) is not None]
    return max(candidates, key=lambda pair: pair[0])[1] if candidates else None


def time_plot(ident: str, worst: Worst, effects: str) -> Markup:
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
        return np.concatenate([values(s)[s.trace.usable] for s in held_out])

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
            "Force [N]",
            forces,
            height=226.0,
            y_range=span_of(measured, of["simulated"], of["augmented"]),
            y_ticks=6,
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


def _find_worst(series: HeldOutSeries) -> tuple[float, Worst] | None:
    trace = series.trace
    length = min(max(2, round(WORST_S * trace.rate_Hz)), len(trace))
    square = np.where(trace.usable, (trace.force - trace.simulated) ** 2, 0.0)
    total = np.concatenate([[0.0], np.cumsum(square)])
    energy = total[length:] - total[:-length]
    start = int(np.argmax(energy))
    return (float(energy[start]), Worst(series, start, start + length)) if energy[start] > 0.0 else None
