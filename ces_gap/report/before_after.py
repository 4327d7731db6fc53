"""Plots before and after: force over speed, the worst second over time, and the next experiment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from ces_gap.diagnosis import HeldOutSeries, NextExperiment
from ces_identify.report.drawing import F, around_zero, axes, legend, note, panel, span_of, svg
from ces_identify.report.marks import dots, line

MAX_DOTS = 2400  # of each force
LAYERS = 12  # measured and simulated dots are drawn in alternate layers, so that neither hides the other
SPEED_FORCE = (530.0, 446.0)
TIME = (660.0, 430.0)
EXPERIMENT = (530.0, 300.0)
WORST_S = 1.0  # [s]
MAX_LEGEND_LETTERS = 13  # per entry
LEFT_OVER = "Gap, measured \N{MINUS SIGN} simulated [N]"


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
    """Return forces and gap over the worst second; if there are `effects`, with the augmented simulation as well."""
    series, ticks = worst.series, slice(worst.start, worst.stop)
    time, measured = series.trace.time_s[ticks], series.trace.force[ticks]
    forces = {"simulated": series.trace.simulated[ticks], "augmented": series.augmented[ticks]}
    shown = {css: f for css, f in forces.items() if effects or css == "simulated"}
    span = float(time[0]), float(time[-1])
    top = panel(span, span_of(measured, *shown.values()), (58, 34, 590, 196))
    rests = {css: measured - f for css, f in shown.items()}
    low = panel(span, around_zero(np.concatenate(list(rests.values()))), (58, 272, 590, 110))
    parts = [axes(top, "", "Force [N]", 8, 5), line(top, time, measured, "measured")]
    parts += [line(top, time, f, css) for css, f in shown.items()]
    parts.append(axes(low, "Time [s]", LEFT_OVER, 8, None))
    parts += [line(low, time, f, css) for css, f in rests.items()]
    words = {"measured": "measured", "simulated": "simulation", "augmented": "with effect"}
    parts.append(legend(top.x.stop, 23, [(css, words[css]) for css in ("measured", *shown)]))
    return svg(ident, TIME, "The worst second", f"{series.trace.name}, {span[0]:.2f} to {span[1]:.2f} s.", parts)


def experiment_plot(ident: str, experiment: NextExperiment) -> Markup:
    """Return stroke [mm] and current [A] of an experiment over time."""
    time, stroke = experiment.time_s, 1e3 * experiment.position_m
    if len(time) < 2:
        p = panel((0.0, 1.0), (0.0, 1.0), (48, 34, 470, 220))
        return svg(ident, EXPERIMENT, "The next experiment", "No signals.", [note(p, "no signals")])
    span = float(time[0]), float(time[-1])
    top = panel(span, span_of(stroke), (48, 30, 470, 124))
    low = panel(span, span_of(experiment.current_A, np.zeros(1)), (48, 194, 470, 64))
    parts = [
        axes(top, "", "Stroke [mm]", 8, 4),
        line(top, time, stroke, "stroke"),
        axes(low, "Time [s]", "Current [A]", 8, 2),
        line(low, *_find_kinks(time, experiment.current_A), "feed"),
    ]
    return svg(ident, EXPERIMENT, "The next experiment", f"{experiment.name}, {span[1]:.3g} s.", parts)


def _find_kinks(time: F, values: F) -> tuple[F, F]:
    """Return the points that a polyline needs: its ends and the points where its slope changes."""
    bent = np.abs(np.diff(values, 2)) > 1e-9 * max(float(np.ptp(values)), 1e-9)
    mask = np.concatenate([[True], bent, [True]])
    return time[mask], values[mask]


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
    top = panel(span_of(speed), span_of(measured, of["simulated"], of["augmented"]), (58, 34, 460, 226))
    rest = around_zero(np.concatenate([measured - of["simulated"], measured - of["augmented"]]))
    low = panel(span_of(speed), rest, (58, 302, 460, 104))
    parts = [axes(top, "", "Force [N]", 6, 6)]
    for layer in np.array_split(np.arange(len(speed)), LAYERS):
        parts += [dots(top, speed[layer], of[c][layer], f"{c} dots") for c in ("measured", css)]
    parts.append(axes(low, "Speed [m/s], positive in compression", LEFT_OVER, 6, None))
    parts.append(dots(low, speed, measured - of[css], f"{css} dots"))
    entry = name if len(name) <= MAX_LEGEND_LETTERS else "with effects"
    parts.append(legend(top.x.stop, 23, (("measured", "measured"), (css, entry))))
    return svg(ident, SPEED_FORCE, f"Force over speed, measured and {name}", f"{len(speed)} ticks.", parts)


def _find_worst(series: HeldOutSeries) -> tuple[float, Worst] | None:
    trace = series.trace
    length = min(max(2, round(WORST_S * trace.rate_Hz)), len(trace))
    square = np.where(trace.usable, (trace.force - trace.simulated) ** 2, 0.0)
    total = np.concatenate([[0.0], np.cumsum(square)])
    energy = total[length:] - total[:-length]
    start = int(np.argmax(energy))
    return (float(energy[start]), Worst(series, start, start + length)) if energy[start] > 0.0 else None
