"""The figures of a learned stroke: errors over the runs, tracking before and after, robustness, actuator's response."""

from __future__ import annotations

import math

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

from ces_identify.report.drawing import Panel, around_zero, axes, label, legend, panel, span_of, svg
from ces_identify.report.marks import dots, line
from ces_iterate.stroke.goal import FIRST, LEARNED, REPEATED, LearnedStroke, LearningRun
from ces_iterate.stroke.learning_filter import MAX_CONTRACTION

Array = NDArray[np.float64]

RUNS_SIZE, TRACKING_SIZE, HALF_SIZE = (440, 446), (660, 446), (550, 330)
WINDOW_S = 1.0
BEST_BAND = 1.5  # of the repeatability: the band in the figure of the runs
MANTISSAS = (1, 2, 5)


def draw_runs(learned: LearnedStroke) -> Markup:
    """Return the RMS error [µm] of every run of the stroke, on a logarithmic axis, with the repeatability."""
    error = 1e6 * np.array([run.error_m for run in learned.runs])
    floor = 1e6 * learned.repeatability_m
    number = np.arange(1, len(error) + 1, dtype=np.float64)
    low, high = math.log10(min(floor, error.min()) / 1.6), math.log10(error.max() * 1.6)
    p = panel((0.5, len(error) + 0.5), (low, high), (52, 46, 376, 350))
    first = sum(run.kind == FIRST for run in learned.runs)
    learning = slice(max(first - 1, 0), len(error) - 1)
    parts = [
        p.rect(p.x.low, p.x.high, "repeats", low, math.log10(BEST_BAND * floor)),
        _log_axis(p, "RMS error [µm]"),
        *(
            label(float(p.x.px(n)), p.y.start + 17, f"{n:.0f}", "tick mid")
            for n in number[:: max(1, len(number) // 12)]
        ),
        label(p.x.stop, p.y.start + 38, "Run of the stroke", "name end"),
        line(p, np.array([p.x.low, p.x.high]), np.full(2, math.log10(floor)), "floor"),
        line(p, number[learning], np.log10(error[learning]), "after"),
        dots(p, number[:first], np.log10(error[:first]), "before spot"),
        dots(p, number[first:-1], np.log10(error[first:-1]), "after spot"),
        dots(p, number[-1:], np.log10(error[-1:]), "again spot"),
        legend(p.x.stop + 8, 16, (("before", "first runs"), ("after", "learned"), ("again", "repeated"))),
        label(p.x.start + 6, float(p.y.px(math.log10(floor))) - 5, f"repeatability {floor:.0f} µm", "tick"),
    ]
    text = f"RMS tracking error of {len(error)} runs; line: repeatability, band: up to {BEST_BAND} times that."
    return svg("runs", RUNS_SIZE, "Error over the runs", text, parts)


def draw_tracking(learned: LearnedStroke) -> Markup:
    """Return wanted and measured positions before and after learning in a window, and both errors."""
    goal, first, last = learned.goal, learned.first, learned.confirmation
    some = _worst_window(goal.wanted_m - first.position_m, goal.interval_s)
    time = np.arange(len(goal.wanted_m), dtype=np.float64)[some] * goal.interval_s
    wanted, before, after = (1e3 * values[some] for values in (goal.wanted_m, first.position_m, last.position_m))
    span = float(time[0]), float(time[-1])
    top = panel(span, span_of(wanted, before), (58, 46, 586, 150))
    middle = panel(span, around_zero(wanted - before), (58, 244, 586, 56))
    bottom = panel(span, around_zero(1e3 * (wanted - after)), (58, 348, 586, 48))
    parts = [
        axes(top, "", "Position [mm]", 8, 5),
        line(top, time, wanted, "wanted"),
        line(top, time, before, "before"),
        line(top, time, after, "after"),
        axes(middle, "", "Error before [mm]", 8, None),
        line(middle, time, wanted - before, "before thin"),
        axes(bottom, "Time [s]", "Error after [µm]", 8, None),
        line(bottom, time, 1e3 * (wanted - after), "after thin"),
        legend(top.x.stop + 8, 16, (("wanted", "wanted"), ("before", "before"), ("after", "after"))),
    ]
    text = "The second with the largest first error. The wanted stroke lies below the curve after learning."
    return svg("tracking", TRACKING_SIZE, "Tracking before and after learning", text, parts)


def draw_robustness(learned: LearnedStroke) -> Markup:
    """Return the bounds on |Q (1 - L G)|, its value for an exact model, and Q, over the frequency."""
    f = learned.learning_filter
    p = panel((0.0, float(f.frequency_Hz[-1])), (0.0, 1.25), (52, 46, 480, 226))
    measured = (("again", "measured"),) if learned.measured is not None else ()
    parts = [
        axes(p, "Frequency [Hz]", "Factor of the error from run to run", 8, 6),
        line(p, np.array([p.x.low, p.x.high]), np.ones(2), "limit"),
        line(p, f.frequency_Hz, f.share, "filter"),
        line(p, f.frequency_Hz, f.nominal, "before"),
        line(p, f.frequency_Hz, f.share * f.bound_measured, "again"),
        line(p, f.frequency_Hz, f.share * f.bound_in_tolerance, "after"),
        legend(
            p.x.stop + 8,
            16,
            (("after", f"{100.0 * f.tolerance:.0f} % wrong"), *measured, ("before", "exact"), ("filter", "Q")),
        ),
    ]
    text = (
        f"|Q(1 - LG)| for all plants considered; it stays below 1, at most {f.contraction.max():.2f} "
        f"(allowed {MAX_CONTRACTION})."
    )
    return svg("robustness", HALF_SIZE, "Condition of convergence", text, parts)


def draw_response(learned: LearnedStroke) -> Markup:
    """Return gain and phase of the actuator, measured in bands and modelled, over the frequency."""
    f, measured = learned.learning_filter, learned.measured
    frequency = f.frequency_Hz[1:]
    model = f.model.response(frequency)
    at = frequency[:0] if measured is None else measured.frequency_Hz
    found = model[:0] if measured is None else measured.response
    phase = np.degrees(np.unwrap(np.angle(model)))
    found_phase = np.degrees(np.angle(found / f.model.response(at))) + np.interp(at, frequency, phase)
    span = (0.0, float(frequency[-1]))
    top = panel(span, (0.0, 1.1 * float(max(np.abs(model).max(), np.abs(found).max(initial=0.0)))), (52, 46, 480, 96))
    bottom = panel(span, span_of(phase, found_phase), (52, 186, 480, 86))
    parts = [
        axes(top, "", "Gain", 8, 4),
        line(top, frequency, np.abs(model), "before"),
        dots(top, at, np.abs(found), "after spot small"),
        axes(bottom, "Frequency [Hz]", "Phase [°]", 8, 4),
        line(bottom, frequency, phase, "before"),
        dots(bottom, at, found_phase, "after spot small"),
        legend(top.x.stop + 8, 16, (("before", "model"), *((("after", "measured"),) if measured else ()))),
    ]
    return svg("response", HALF_SIZE, "Response of the actuator", "Position over command: gain and phase.", parts)


def _worst_window(error: Array, interval_s: float) -> slice:
    """Return the WINDOW_S in which the error's power is largest."""
    length = min(len(error), round(WINDOW_S / interval_s))
    total = np.concatenate([[0.0], np.cumsum(error**2)])
    start = int(np.argmax(total[length:] - total[:-length]))
    return slice(start, start + length)


def _log_axis(p: Panel, name: str) -> str:
    """Return grid lines and labels at 1, 2 and 5 of each decade of an axis of decimal logarithms."""
    out = [label(4, p.y.stop - 11, name, "name")]
    for decade in range(math.floor(p.y.low), math.ceil(p.y.high) + 1):
        for mantissa in MANTISSAS:
            value = decade + math.log10(mantissa)
            if p.y.low <= value <= p.y.high:
                y = float(p.y.px(value))
                out.append(f'<path class="grid" d="M{p.x.start:.1f},{y:.1f}H{p.x.stop:.1f}"/>')
                out.append(label(p.x.start - 7, y + 4, f"{mantissa * 10.0**decade:g}", "tick end"))
    return "\n".join(out)


def describe_kind(run: LearningRun) -> str:
    """Return what a run was, for tables."""
    return {FIRST: "wanted stroke", LEARNED: "learned command", REPEATED: "learned command, repeated"}[run.kind]
