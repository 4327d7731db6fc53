"""The page about a learned stroke: an outcome goes in, HTML comes out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ces_identify.report.shell import page_template, replace_unencodable
from ces_identify.typesetting import three_figures
from ces_iterate.stroke.figures import describe_kind, draw_response, draw_robustness, draw_runs, draw_tracking
from ces_iterate.stroke.goal import CONVERGED, DIVERGED, LEARNED, LearnedStroke, command_peaks
from ces_iterate.stroke.learning_filter import MAX_CONTRACTION

MATERIAL_SHARE = 0.25  # of the squared error: what lies above the learning bandwidth is then worth a warning


def stroke_page(learned: LearnedStroke, title: str, facts: Mapping[str, str]) -> str:
    """Return the page as text that is both HTML and well-formed XML; `facts` (date, command) follow the headline."""
    page = page_template("stroke.html.j2", __package__, ("stroke.css",)).render(
        title=title,
        headline=summary_sentence(learned),
        warnings=list(find_warnings(learned)),
        facts={**facts, **_facts(learned)},
        runs_figure=draw_runs(learned),
        tracking_figure=draw_tracking(learned),
        robustness_figure=draw_robustness(learned),
        response_figure=draw_response(learned),
        condition=describe_condition(learned),
        response_note=_response_note(learned),
        limits=[(name, *map(_four, row)) for name, *row in command_peaks(learned)],
        runs=[_run_row(learned, n) for n in range(len(learned.runs))],
    )
    return replace_unencodable(page)


def summary_sentence(learned: LearnedStroke) -> str:
    """Return what was reached, in one sentence."""
    first, last, floor = (
        1e6 * e for e in (learned.first.error_m, learned.confirmation.error_m, learned.repeatability_m)
    )
    return (
        f"The tracking error fell from {first:.0f} to {last:.0f} µm RMS in {learned.iterations} iterations: "
        f"{100.0 * last / first:.1f} % of the first error, {last / floor:.2f} times the repeatability ({floor:.0f} µm)."
    )


def describe_condition(learned: LearnedStroke) -> str:
    """Return the condition of convergence, and for which plants it holds."""
    f = learned.learning_filter
    wrong = f"{100.0 * f.tolerance:.0f} % in gain, bandwidth and delay at once"
    plants = f"for an actuator of which the model is wrong by {wrong}"
    measured = "" if learned.measured is None else ", and within the uncertainty of the measured response"
    return (
        f"|Q(1 − LG)| < 1 holds at all frequencies {plants}{measured}: at most {f.contraction.max():.2f} "
        f"(designed for {MAX_CONTRACTION}). Learning ends at {f.bandwidth_Hz:.0f} Hz."
    )


def find_warnings(learned: LearnedStroke) -> Iterator[str]:
    """Yield what the reader must know before using the command."""
    if learned.stopped == DIVERGED:
        yield "The error grew even with a small gain; the best command so far was kept. Check model and recordings."
    above = error_above_bandwidth(learned)
    if learned.stopped != CONVERGED and above**2 > MATERIAL_SHARE * learned.confirmation.error_m**2:
        yield (
            f"{1e6 * above:.0f} µm of the error lie above the learning bandwidth of "
            f"{learned.learning_filter.bandwidth_Hz:.0f} Hz, where convergence is not guaranteed. Measure the actuator "
            "(probe), raise probe.to_Hz, or lower model_tolerance."
        )
    if learned.runs[learned.best].limited > 0.0:
        yield "The limits changed the learned command; where they bind, the piston cannot follow."


def error_above_bandwidth(learned: LearnedStroke) -> float:
    """Return the RMS [m] of what repeats of the error above the learning bandwidth."""
    goal, bandwidth = learned.goal, learned.learning_filter.bandwidth_Hz
    frequency = np.fft.rfftfreq(len(goal.wanted_m), goal.interval_s)
    error, again = (
        np.fft.rfft(goal.wanted_m - run.position_m)[frequency > bandwidth]
        for run in (learned.learned, learned.confirmation)
    )
    repeating = float(np.sum((error * again.conj()).real))  # noise of the two runs is uncorrelated
    return float(np.sqrt(2.0 * max(repeating, 0.0))) / len(goal.wanted_m)


def _facts(learned: LearnedStroke) -> dict[str, str]:
    model, f = learned.learning_filter.model, learned.learning_filter
    return {
        "Stopped": learned.stopped,
        "Runs": f"{len(learned.runs) + (learned.probe is not None)}, {_seconds(learned):.0f} s on the rig",
        "Actuator": (
            f"gain {model.gain:.3f}, delay {1e3 * model.delay_s:.1f} ms, {model.bandwidth_Hz:.0f} Hz, "
            f"damping {model.damping:.2f}" + (f", {1e3 * model.valve_s:.1f} ms" if model.valve_s else "")
        ),
        "Learning bandwidth": f"{f.bandwidth_Hz:.0f} Hz",
    }


def _seconds(learned: LearnedStroke) -> float:
    stroke = len(learned.runs) * len(learned.goal.wanted_m)
    return learned.goal.interval_s * (stroke + (0 if learned.probe is None else len(learned.probe.command_m)))


def _response_note(learned: LearnedStroke) -> str:
    if learned.measured is None:
        return "The model as given in the plan; the runs did not correct it."
    source = "the probe and the first runs" if learned.probe is not None else "the first runs"
    return (
        f"Measured in bands of frequencies with {source}; where it was measured, learning uses it instead of the model."
    )


def _run_row(learned: LearnedStroke, number: int) -> tuple[str, ...]:
    run = learned.runs[number]
    ratio = three_figures(run.error_m / learned.repeatability_m)
    gain = f"{run.scale:g}" if run.kind == LEARNED else ""
    limited = f"{100.0 * run.limited:.1f}" if run.limited else ""
    return str(number + 1), describe_kind(run), three_figures(1e6 * run.error_m), ratio, gain, limited


def _four(value: float) -> str:
    return f"{value:.4g}"
