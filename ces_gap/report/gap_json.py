"""`gap.json`: a diagnosis for programs, schema "ces-gap/1". One table of fields gives the file and its JSON Schema.

Numbers are finite and rounded to six significant digits; unknown or infinite values are null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, calibration_cells, find_best_other
from ces_gap.errors import GapError
from ces_gap.inference.judgement import Within
from ces_gap.inputs.probe_result import CURRENT_MEANINGS
from ces_gap.report.formatting import AXES
from ces_observer.fields import Field, Schema
from ces_observer.json_text import write_atomically
from ces_observer.records import Of, document_schema, record_of
from ces_observer.shapes import ByName

SCHEMA = "ces-gap/1"
DIGITS = 6  # significant digits of a number
ABOUT = (
    "SI units, named at the end of each key. A gap is an RMS [N] on held-out recordings with the noise subtracted. "
    "null: unknown."
)


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
    content: dict[str, Any] = GAP.write(diagnosis)
    return content


def gap_schema() -> Schema:
    """Return the JSON Schema of `gap.json`."""
    return document_schema(GAP, SCHEMA) | {"description": ABOUT}


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


def many(kind: Field, least: int = 0) -> Field:
    """Return the field of a list."""
    return Field(kind=kind, many=True, min_count=least)


def by_name(kind: Field) -> Field:
    """Return the field of an object with any keys."""
    return Field(kind=ByName(kind))


def or_null(kind: Field) -> Field:
    """Return the field of a value that may be None."""
    return replace(kind, null=None)


def word(*choices: str) -> Field:
    """Return the field of one of some words."""
    return Field(choices=choices)


def first(name: str) -> Of:
    """Return what finds the first of an explanation's values."""
    return lambda explanation: getattr(explanation, name)[0]


def itself(item: Any) -> Any:
    """Return the record itself, of which an inner object tells more."""
    return item


def estimates(explanation: Any) -> dict[str, dict[str, Any]]:
    """Return the estimates of an explanation by effect and parameter."""
    by_effect = zip(explanation.effects, explanation.estimates, strict=True)
    return {effect: {estimate.name: estimate for estimate in of_effect} for effect, of_effect in by_effect}


def shrink_of_ceiling(d: Diagnosis) -> float:
    """Return the share of the gap that a learner without physics closes."""
    return 1.0 - d.ceiling_after_N / d.base_N if d.base_N > 0.0 else math.nan


TEXT, FLAG, NUMBER = Field(kind=str), Field(kind=bool), Field(kind=float, null=None)
POSITIVE, SHRINK, MAYBE = replace(NUMBER, low=0.0), replace(NUMBER, high=1.0), replace(NUMBER, low=0.0, high=1.0)
PROBABILITY = Field(kind=float, low=0.0, high=1.0)
INTERVAL = Field(kind=NUMBER, many=True, min_count=2, max_count=2)

DEFAULT = replace(NUMBER, default=None, optional=True).about("what the simulation had; of its own parameters only")
ESTIMATE = record_of(
    value=NUMBER,
    ci95=INTERVAL,
    at_bound=FLAG,
    drifts=FLAG,
    default=(DEFAULT, lambda one: None if math.isnan(one.default) else one.default),
)
PARAMETERS = by_name(ESTIMATE)
LEFT = {"gap_after_N": POSITIVE, "shrink": SHRINK, "shrink_ci95": INTERVAL}
LEFT_TOGETHER = {key: (kind, f"composition.{key}") for key, kind in LEFT.items()}
REGION = record_of(
    axis=word(*AXES),
    **{"from": (NUMBER, "low"), "to": (NUMBER, "high")},
    share_of_energy=NUMBER.about("of the gap's square"),
    share_of_samples=PROBABILITY,
    rms_N=POSITIVE,
    ci95_N=INTERVAL,
    q_value=MAYBE.about("false-discovery rate at which it exceeds the rest of its axis"),
)
STRONGEST = record_of(
    region=(REGION, "strongest"), p_value=(MAYBE.about("of the test over all regions"), "max_p_value")
)
REGION_AFTER = record_of(region=(REGION, itemgetter(0)), gap_after_N=(POSITIVE, itemgetter(1)))
RARE = record_of(
    mean_N=NUMBER.about("mean deviation of the measured force over the window"),
    limit_N=POSITIVE.about("which the largest of all such windows exceeds in 1 of 200 clean diagnoses"),
    **{"recording": TEXT, "time_s": NUMBER, "window_s": POSITIVE},
    **{"stroke_m": NUMBER, "speed_m_s": NUMBER, "current_A": NUMBER},
)
GAP_SIZE = record_of(
    rms_N=POSITIVE,
    ci95_N=INTERVAL,
    noise_floor_N=POSITIVE.about("of the measured force as logged"),
    noise_in_band_N=POSITIVE.about("the part of it on the grid of the comparison, which is subtracted"),
    cost_J=POSITIVE,
    corrected_N=POSITIVE.about("once the simulation's own error, learnt from references, is added"),
    corrected_ci95_N=INTERVAL,
    noise_source=TEXT.about("what showed the noise, as in 8.1 N from repeated cycles"),
)
CAUSE = record_of(
    effect=(TEXT, first("effects")),
    form=(TEXT, first("forms")),
    probability=PROBABILITY,
    parameters=(PARAMETERS, lambda cause: estimates(cause)[cause.effects[0]]),
    **LEFT,
    gain=NUMBER,
    gain_error=NUMBER,
)
COMPOSITION = record_of(
    effects=(many(TEXT), "composition.effects"),
    forms=(many(TEXT), "composition.forms"),
    **LEFT_TOGETHER,
    probability=(PROBABILITY.about("of its effects together, and of each"), "composition.probability"),
    parameters=(by_name(PARAMETERS).about("by effect"), lambda d: estimates(d.composition)),
    without_N=(
        many(POSITIVE).about("the gap left without each of several effects, the others refitted"),
        "composition.without_N",
    ),
    by_region=many(REGION_AFTER),
)
CELL = record_of(speed_m_s=INTERVAL, current_A=INTERVAL, force_N=NUMBER)
INVISIBLE = record_of(effect=(TEXT, itemgetter(0)), reason=(TEXT, itemgetter(1)))
CEILING = record_of(gap_after_N=(POSITIVE, "ceiling_after_N"), shrink=(SHRINK, shrink_of_ceiling))
CONTROLS = record_of(
    best_wrong_effect=(
        or_null(record_of(effect=(TEXT, first("effects")), **LEFT)),
        lambda d: find_best_other(d, d.composition),
    ),
    ceiling=(CEILING, itself),
)
RECIPE = Field(kind=Mapping)
EXPERIMENT = record_of(name=TEXT, purpose=TEXT, recipe=RECIPE, separates=many(TEXT), distance_N=POSITIVE)
NO_EXPERIMENT = {"purpose": "", "recipe": {}}
NEXT = replace(EXPERIMENT, null=NO_EXPERIMENT, rules={"required": list(NO_EXPERIMENT)})
TWIN = record_of(
    kind=(TEXT.about("of damper"), lambda d: d.twin.body.kind),
    cost_J=(POSITIVE.about("on blocks of the simulated force left out of its fit"), lambda d: d.twin.cost_J),
    replaces=(FLAG.about("whether it replaces a simulation that cannot be run"), "is_recorded"),
)
TIMING = record_of(current_lead_samples=NUMBER, position_delay_s=POSITIVE)
PROBE = record_of(
    summary=TEXT,
    current_convention=word(*CURRENT_MEANINGS),
    current_lead_samples=NUMBER.about("how much earlier it answers than to a held current; negative if later"),
    current_lead_s=NUMBER,
    position_delay_s=INTERVAL.about("delay inside: a certain value, and one that it does not exceed"),
    noise_N=POSITIVE.about("RMS by which equal calls differ, or a smooth force is rough"),
    memory_N=POSITIVE.about("RMS by which they differ after another call"),
    corrected=TIMING.about("undone before the effects are fitted, and in augmented.json; zero where nothing is"),
)
HELD_OUT = record_of(
    name=(TEXT, "trace.name"),
    sha256=(TEXT, "trace.recording.sha256"),
    usable_s=(POSITIVE, lambda series: float(series.trace.usable.sum()) * series.trace.step_s),
)
REASONS = word("", Within.TOLERANCE, Within.NOISE, Within.TIMING, Within.BASELINE_ERROR)
GAP = record_of(
    verdict=word(NAMED, AMBIGUOUS, UNKNOWN, NO_GAP),
    sentence=TEXT,
    simulation=TEXT,
    no_gap_reason=REASONS.about("what a gap that is none lies within"),
    gap=GAP_SIZE,
    rare=or_null(RARE).about("the largest local deviation, if it stands out; null otherwise"),
    tolerance_N=POSITIVE.about("a gap up to this counts as none"),
    visible_from_N=POSITIVE.about("effects below hide behind the noise and the simulation's own error"),
    where=(many(REGION).about("regions of one axis each, most energy first"), "where.regions"),
    max_region=(or_null(STRONGEST), lambda d: None if d.where.strongest is None else d.where),
    causes=many(CAUSE).about("each effect alone, most probable first"),
    composition=(COMPOSITION, itself),
    calibration_map=(
        many(CELL).about("mean force that a calibration in the composition adds, by speed and current"),
        calibration_cells,
    ),
    explained_as_well=many(many(TEXT, 1)).about("parameters and effects that together would explain the gap as well"),
    indistinguishable=many(many(TEXT, 2)).about("groups of effects that are indistinguishable on these recordings"),
    not_separable=many(TEXT).about("effects that a calibration of the simulation could absorb: references are needed"),
    invisible=many(INVISIBLE).about("effects that these recordings cannot show"),
    probabilities=(
        record_of(none=(PROBABILITY, "probability_none"), unknown=(PROBABILITY, "probability_unknown")),
        itself,
    ),
    controls=(CONTROLS, itself),
    ceiling=(CEILING.about("what a learner without physics leaves"), itself),
    rest=(
        or_null(many(REGION)).about("where the unexplained rest lies"),
        lambda d: None if d.rest is None else d.rest.regions,
    ),
    next_experiment=NEXT,
    twin=(
        or_null(TWIN).about("the network fitted to the simulation, into which effects are put; null without"),
        lambda d: None if d.twin is None else d,
    ),
    input_probe=(PROBE.about("what the simulation does to its inputs"), "probe"),
    held_out=many(HELD_OUT),
    notes=many(TEXT),
)
