"""`gap.json`: a diagnosis for programs, with schema "ces-gap/1" (`gap.schema.json` in this folder).

Numbers are finite and rounded to six significant digits; unknown or infinite values are null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ces_gap.diagnosis import (
    Diagnosis,
    Estimate,
    Explanation,
    GapRegion,
    HeldOutSeries,
    NextExperiment,
    calibration_cells,
)
from ces_gap.errors import GapError
from ces_observer.json_text import write_atomically

SCHEMA = "ces-gap/1"
DIGITS = 6  # significant digits of a number


def write_gap(path: Path, diagnosis: Diagnosis) -> None:
    """Write `gap.json` to `path` atomically; raises CesError if it cannot be written."""
    write_atomically(path, format_document(gap_document(diagnosis)))


def format_document(document: Mapping[str, Any]) -> str:
    """Return the text of `gap.json`."""
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def gap_document(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return the diagnosis as a JSON object of schema "ces-gap/1".

    Raises GapError if the recipe of the next experiment contains a value that JSON cannot represent.
    """
    whole: dict[str, Any] = to_plain_json({"schema": SCHEMA, **gap_content(diagnosis)}, "gap.json")
    return whole


def gap_content(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return what `gap.json` says, its numbers as computed."""
    d, strongest, wrong = diagnosis, diagnosis.where.strongest, diagnosis.wrong
    return {
        "verdict": d.verdict,
        "sentence": d.sentence,
        "simulation": d.simulation,
        "no_gap_reason": d.no_gap_reason,
        "gap": asdict(d.gap),
        "tolerance_N": d.tolerance_N,
        "visible_from_N": d.visible_from_N,
        "where": [_region(r) for r in d.where.regions],
        "max_region": None if strongest is None else {"region": _region(strongest), "p_value": d.where.max_p_value},
        "causes": [_cause(c) for c in d.causes],
        "composition": _composition(d),
        "calibration_map": [asdict(cell) for cell in calibration_cells(d)],
        "indistinguishable": d.indistinguishable,
        "not_separable": d.not_separable,
        "invisible": [{"effect": effect, "reason": reason} for effect, reason in d.invisible],
        "probabilities": {"none": d.probability_none, "unknown": d.probability_unknown},
        "controls": {
            "best_wrong_effect": None if wrong is None else {"effect": wrong.effects[0], **_after(wrong)},
            "ceiling": _ceiling(d),
        },
        "ceiling": _ceiling(d),
        "rest": None if d.rest is None else [_region(r) for r in d.rest.regions],
        "witness": _refits(d),
        "next_experiment": _experiment(d.next_experiment),
        "surrogate": None
        if d.surrogate_cost_J is None
        else {"cost_J": d.surrogate_cost_J, "difference_error": d.surrogate_error},
        "held_out": [_held_out(s) for s in d.held_out],
        "notes": d.notes,
    }


def _region(region: GapRegion) -> dict[str, Any]:
    return {
        "axis": region.axis,
        "from": region.low,
        "to": region.high,
        "share_of_energy": region.share_of_energy,
        "share_of_samples": region.share_of_samples,
        "rms_N": region.rms_N,
        "ci95_N": region.ci95_N,
        "q_value": region.q_value,
    }


def _cause(cause: Explanation) -> dict[str, Any]:
    """Return one effect alone."""
    return {
        "effect": cause.effects[0],
        "form": cause.forms[0],
        "probability": cause.probability,
        "parameters": _parameters(cause.estimates[0]),
        **_after(cause),
        "gain": cause.gain,
        "gain_error": cause.gain_error,
    }


def _composition(d: Diagnosis) -> dict[str, Any]:
    """Return all effects together; `parameters` by effect."""
    c = d.composition
    return {
        "effects": c.effects,
        "forms": c.forms,
        **_after(c),
        "parameters": {effect: _parameters(e) for effect, e in zip(c.effects, c.estimates, strict=True)},
        "by_region": [{"region": _region(region), "gap_after_N": after} for region, after in d.by_region],
    }


def _after(e: Explanation) -> dict[str, Any]:
    return {"gap_after_N": e.gap_after_N, "shrink": e.shrink, "shrink_ci95": e.shrink_ci95}


def _parameters(estimates: tuple[Estimate, ...]) -> dict[str, Any]:
    return {e.name: {"value": e.value, "ci95": e.ci95, "at_bound": e.at_bound, "drifts": e.drifts} for e in estimates}


def _ceiling(d: Diagnosis) -> dict[str, Any]:
    shrink = 1.0 - d.ceiling_after_N / d.gap.rms_N if d.gap.rms_N > 0.0 else math.nan
    return {"gap_after_N": d.ceiling_after_N, "shrink": shrink}


def _refits(d: Diagnosis) -> dict[str, Any] | None:
    """Return the refits of a physical model's parameters; null for other simulations."""
    if d.refits is None:
        return None
    refits = [asdict(refit) for refit in d.refits.refits]
    for refit in refits:
        del refit["block_energy"]
    return {"says": d.refit_finding, "note": d.refits.note, "refits": refits}


def _experiment(experiment: NextExperiment | None) -> dict[str, Any]:
    """Return the next experiment; purpose and recipe are empty if none is needed."""
    if experiment is None:
        return {"purpose": "", "recipe": {}}
    return {key: getattr(experiment, key) for key in ("name", "purpose", "recipe", "separates", "distance_N")}


def _held_out(series: HeldOutSeries) -> dict[str, Any]:
    trace = series.trace
    seconds = float(trace.usable.sum()) * trace.step_s
    return {"name": trace.name, "sha256": trace.recording.sha256, "usable_s": seconds}


def to_plain_json(item: object, where: str) -> Any:
    """Return `item` in JSON's types: rounded finite numbers, null for other numbers, lists, objects with text keys."""
    if item is None or isinstance(item, str | bool | int):
        return item
    if isinstance(item, np.bool_ | np.integer | np.ndarray):
        return to_plain_json(item.tolist(), where)
    if isinstance(item, float | np.floating):
        return float(f"{item:.{DIGITS}g}") if math.isfinite(item) else None
    if isinstance(item, Mapping):
        return {str(key): to_plain_json(value, f"{where}: {key}") for key, value in item.items()}
    if isinstance(item, list | tuple):
        return [to_plain_json(value, where) for value in item]
    raise GapError(f"{where}: a {type(item).__name__}; expected text, numbers, lists or objects of them")
