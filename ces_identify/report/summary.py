"""The first screen of a model's report: whether it fits, where not, whether a vehicle can trust it, what to do next."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import PurePath
from typing import NamedTuple

import numpy as np
from markupsafe import Markup

from ces_identify.limits import MisfitLimits
from ces_identify.report.figures import SpeedCurrentGrid, Window
from ces_identify.structures.auto import AUTO, advise
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, pooled_cost
from ces_observer.model import Envelope, Model
from ces_observer.proof.certificate import summarize
from ces_report.plot import Plot, PlotArea, PlotLine, draw_plot
from ces_report.typesetting import three_figures

SPEEDS, CURRENTS = 5, 3  # regions in which the error is looked for
PICTURE_POINTS = 1500
NEGATIVE = re.compile(r"(?<=\s)-(?=\d)")
Answers = list[tuple[str, str, str]]
"""Questions with their answers, and a command for those that have one."""


def summarize_model(model: Model, evaluations: Sequence[Evaluation], headline: str, command: str) -> Answers:
    """Return what a colleague asks first; `command` is the one that identified the model, '' if it is not known."""
    held_out = [e for e in evaluations if e.role == VALIDATION]
    finite = [e for e in evaluations if math.isfinite(e.cost)]
    own = [e for e in finite if e.role == IDENTIFICATION]
    shown = [e for e in finite if e.role == VALIDATION] if held_out else own
    answers: Answers = [("Does it fit?", f"{_judge_fit(held_out, shown, own)} {headline}".strip(), "")]
    region = _find_worst_region(shown, own) if shown else None
    if region:
        answers.append(("Where not?", f"At {region.where}: {region.error}.", ""))
    answers.append(("On the vehicle?", _describe_trust(model, held_out), ""))
    answers.append(("Record next?", _propose_recording(model, held_out, region), ""))
    answers += _describe_alternative(model, command if command.startswith("ces identify ") else "")
    return [(question, NEGATIVE.sub("\N{MINUS SIGN}", text), taken) for question, text, taken in answers]


def draw_picture(evaluation: Evaluation, window: Window) -> Markup:
    """Return measured and simulated force in a window, small."""
    part = slice(window.start, window.stop)
    time, breaks = evaluation.series.time_s[part], np.zeros(window.stop - window.start, bool)
    lines = [
        PlotLine("measured", time, evaluation.series.force[part], "measured", breaks),
        PlotLine("simulated", time, evaluation.run.force[part], "simulated", breaks),
    ]
    title, text = f"Force on {evaluation.name}", "A window of the force over time, as below."
    areas = [PlotArea("Force [N]", lines, height=210.0)]
    return draw_plot(Plot("first", title, text, "Time [s]", areas, width=500.0, x_ticks=5), PICTURE_POINTS)


def _judge_fit(held_out: Sequence[Evaluation], shown: Sequence[Evaluation], own: Sequence[Evaluation]) -> str:
    if not held_out or not shown:
        return "No." if held_out else ""
    word, worst = _fit_word(pooled_cost(shown)), max(shown, key=lambda e: e.cost)
    same = {e.name for e in held_out} <= {e.name for e in own}
    text = f"{word}, on the rest of its own recording" if same else word
    if (other := _fit_word(worst.cost)) != word:
        text += f"; {'not' if other == 'No' else other.lower()} on {worst.name} (J {three_figures(worst.cost)} %)"
    return f"{text}."


def _fit_word(cost: float) -> str:
    return next(word for limit, word in MisfitLimits.FITS if cost < limit or limit == math.inf)


class _Region(NamedTuple):
    """A cell of speed and current, its error in words, and whether it is as large on the model's own data."""

    where: str
    error: str
    is_misfit: bool


def _find_worst_region(evaluations: Sequence[Evaluation], own: Sequence[Evaluation]) -> _Region | None:
    """Return the cell with most of the error's energy."""
    scored = [(e.series.speed[e.series.scored], e.series.current[e.series.scored]) for e in evaluations]
    speed, current = map(np.concatenate, zip(*scored, strict=True))
    constant = np.ptp(current) < MisfitLimits.MIN_CURRENT_SPAN_A
    grid = SpeedCurrentGrid(
        np.linspace(speed.min(), max(speed.max(), speed.min() + 1e-3), SPEEDS + 1),
        np.linspace(current.min(), max(current.max(), current.min() + 1e-3), 2 if constant else CURRENTS + 1),
    )
    time, rms = grid.share(evaluations), np.nan_to_num(grid.rms(evaluations))
    energy = time * rms**2
    if not energy.sum() > 0.0:
        return None
    v, c = np.unravel_index(int(np.argmax(energy)), energy.shape)
    where = f"{grid.speed[v]:.2f} to {grid.speed[v + 1]:.2f} m/s"
    where += "" if constant else f" and {grid.current[c]:.2f} to {grid.current[c + 1]:.2f} A"
    share = f"{100.0 * energy[v, c] / energy.sum():.0f} % of the error's energy in {time[v, c]:.0f} % of the time"
    is_misfit = bool(own) and grid.rms(own)[v, c] > MisfitLimits.MISFIT_SHARE * rms[v, c]
    return _Region(where, f"{share}, RMS {rms[v, c]:.0f} N", is_misfit)


def _describe_trust(model: Model, held_out: Sequence[Evaluation]) -> str:
    """Return the proof, the ranges that the model knows, and how much of a usual road and of validation is in them."""
    proof = "Not proved stable" if model.certificate is None else f"Proved stable; {summarize(model.certificate)}"
    bound = (model.certificate or {}).get("force_bound_N")
    if bound is not None and "|force|" not in proof:
        loose = " (a loose bound)" if bound > MisfitLimits.LOOSE * max(map(abs, model.force_envelope_N)) else ""
        proof += f"; |force| at most {three_figures(bound / 1000.0)} kN{loose}"
    ranges = "{:.2f} to {:.2f} m/s".format(*model.envelope.speed_m_s)
    ends = dict.fromkeys(f"{end:.3g}" for end in model.envelope.current_A)
    ranges += f" and {' to '.join(ends)} A{model.envelope.gap_text}"
    road = 100.0 * _share_of_road(model.envelope)
    text = f"{proof}. It knows {ranges}; its speeds hold {road:.1f} % of the time on a class C road at 60 km/h"
    outside = max((e.outside_share for e in held_out), default=0.0)
    text += f"; up to {100.0 * outside:.1f} % of a validation recording is outside." if outside else "."
    coverage = [e.coverage for e in held_out if e.coverage is not None]
    if model.band is not None and coverage:
        held = f"{'at least ' * (len(coverage) > 1)}{100.0 * min(coverage):.0f} % of the validation forces"
        text += f" Its band, meant for {100.0 * model.band.level:.0f} %, holds {held}."
    return text


def _share_of_road(envelope: Envelope) -> float:
    """Return the share of the time that a normally distributed speed is within the envelope's speeds."""
    low, high = (math.erf(end / (MisfitLimits.ROAD_SPEED_M_S * math.sqrt(2.0))) for end in envelope.speed_m_s)
    return 0.5 * (high - low)


def _propose_recording(model: Model, held_out: Sequence[Evaluation], region: _Region | None) -> str:
    low, high = model.envelope.current_A
    if not held_out:
        return "One that it never sees, as --validate BAG: the costs here show the fit, not the prediction."
    outside = [e for e in held_out if e.outside and e.outside_share > MisfitLimits.MAX_OUTSIDE]
    if outside:
        worst = max(outside, key=lambda e: e.outside_share)
        return f"What {worst.name} has and the model does not know: {', '.join(map(str, worst.outside))}."
    fast = f"Faster strokes, up to {3.0 * MisfitLimits.ROAD_SPEED_M_S:.1f} m/s."
    if (gap := model.used_gap_A) is not None:
        return "Currents between {:.3g} and {:.3g} A: none was recorded, and the model interpolates there.".format(*gap)
    one_current = high - low < MisfitLimits.MIN_CURRENT_SPAN_A
    if one_current or _share_of_road(model.envelope) < 1.0 - MisfitLimits.MAX_OUTSIDE:
        return f"Other currents: it knows {high:.3g} A only." if one_current else fast
    if region is not None and region.is_misfit:
        return f"More will hardly help: at {region.where} the error is as large on the model's own recordings."
    return f"More at {region.where}, where most of the error is." if region else "Nothing that these show."


def _describe_alternative(model: Model, command: str) -> Answers:
    """Return what another structure reached or that none was tried, with the command that takes it."""
    selection = model.provenance.get("selection", {})
    costs, chosen = selection.get("structures") or {}, selection.get("structure", "")
    if not costs:
        untried = "Not tried; this compares them all, then fits the best:"
        return [("Another structure?", untried, _with(command, AUTO))] if command else []
    if not advise(costs, chosen):
        return []
    best = min(costs, key=lambda name: costs[name])
    comparison = f"{best}: J {three_figures(costs[best])} % on data left out, {chosen} {three_figures(costs[chosen])} %"
    command = _with(command or "ces identify BAG...", best)
    return [("Another structure?", f"{comparison} (a short fit). This takes it:", command)]


def _with(command: str, structure: str) -> str:
    """Return the command with another structure and other names of its outputs."""
    words, kept, outputs = iter(shlex.split(command)), [], {"--out": "model.json"}
    for word in words:
        option, mark, value = word.partition("=")
        if option == "--structure":
            value = value if mark else next(words, "")
        elif option in ("--out", "--report"):
            outputs[option] = value if mark else next(words, "")
        else:
            kept.append(word)
    for option, value in outputs.items():
        path = PurePath(value)
        kept += [option, str(path.with_name(f"{path.stem}_{structure}{path.suffix}") if path.suffix else path)]
    return shlex.join([*kept, "--structure", structure])
