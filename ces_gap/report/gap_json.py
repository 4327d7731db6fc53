"""`gap.json`: a diagnosis for programs, schema "ces-gap/1". One table gives the file and its JSON Schema.

Numbers are finite and rounded to six significant digits; unknown or infinite values are null.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, calibration_cells, find_best_other
from ces_gap.errors import GapError
from ces_gap.inference.judgement import WITHIN_BASELINE, WITHIN_NOISE, WITHIN_TIMING, WITHIN_TOLERANCE
from ces_gap.inputs.probe_result import CURRENT_MEANINGS
from ces_gap.report.formatting import AXES
from ces_observer.fields import Schema
from ces_observer.json_text import write_atomically

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
    whole: dict[str, Any] = GAP.write(diagnosis)
    return whole


def gap_schema() -> Schema:
    """Return the JSON Schema of `gap.json`."""
    properties = {"schema": {"const": SCHEMA}, **GAP.schema["properties"]}
    return {**GAP.schema, "properties": properties, "required": list(properties), "description": ABOUT}


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


@dataclass(frozen=True)
class Kind:
    """A kind of value in the file: its JSON Schema, and what is written of a value of the diagnosis."""

    schema: Schema
    write: Callable[[Any], Any] = lambda value: value

    def __call__(self, about: str) -> Kind:
        """Return the same with a description."""
        return Kind({**self.schema, "description": about}, self.write)


Read = str | Callable[[Any], Any]  # an attribute, or a function of the record


def record(**keys: Kind | tuple[Kind, Read]) -> Kind:
    """Return the kind of an object with these keys and no others; a key without `Read` is an attribute of its name."""
    pairs = {key: value if isinstance(value, tuple) else (value, key) for key, value in keys.items()}
    rows = [(key, kind, attrgetter(read) if isinstance(read, str) else read) for key, (kind, read) in pairs.items()]
    properties = {key: kind.schema for key, kind, _ in rows}
    schema = {"type": "object", "properties": properties, "required": list(keys), "additionalProperties": False}
    return Kind(schema, lambda one: {key: kind.write(read(one)) for key, kind, read in rows})


def many(kind: Kind, least: int = 0) -> Kind:
    """Return the kind of a list."""
    schema = {"type": "array", "items": kind.schema} | ({"minItems": least} if least else {})
    return Kind(schema, lambda values: [kind.write(value) for value in values])


def by_name(kind: Kind) -> Kind:
    """Return the kind of an object with any keys, of pairs of a key and a value."""
    schema = {"type": "object", "additionalProperties": kind.schema}
    return Kind(schema, lambda pairs: {name: kind.write(value) for name, value in pairs})


def or_null(kind: Kind) -> Kind:
    """Return the kind of a value that may be None."""
    return Kind({"anyOf": [{"type": "null"}, kind.schema]}, lambda one: None if one is None else kind.write(one))


def number(**bounds: float) -> Kind:
    """Return the kind of a number that may be unknown."""
    return Kind({"type": ["number", "null"], **bounds})


def first(name: str) -> Read:
    """Return what finds the first of an explanation's values."""
    return lambda explanation: getattr(explanation, name)[0]


def itself(item: Any) -> Any:
    """Return the record itself, of which an inner object tells more."""
    return item


def estimates(explanation: Any) -> list[tuple[str, list[tuple[str, Any]]]]:
    """Return the estimates of an explanation by effect and parameter."""
    by_effect = zip(explanation.effects, explanation.estimates, strict=True)
    return [(effect, [(one.name, one) for one in found]) for effect, found in by_effect]


def shrink_of_ceiling(d: Diagnosis) -> float:
    """Return the share of the gap that a learner without physics closes, of what the correction leaves."""
    return 1.0 - d.ceiling_after_N / d.gap.corrected_N if d.gap.corrected_N > 0.0 else math.nan


TEXT, WORD, FLAG = Kind({"type": "string"}), Kind({"type": "string", "minLength": 1}), Kind({"type": "boolean"})
NUMBER, POSITIVE, SHRINK, MAYBE = number(), number(minimum=0), number(maximum=1), number(minimum=0, maximum=1)
PROBABILITY = Kind({"type": "number", "minimum": 0, "maximum": 1})
INTERVAL = Kind({"type": "array", "items": NUMBER.schema, "minItems": 2, "maxItems": 2})

ESTIMATE = record(value=NUMBER, ci95=INTERVAL, at_bound=FLAG, drifts=FLAG)
DEFAULT = {"default": NUMBER("what the simulation had; of its own parameters only").schema}
PARAMETERS = by_name(
    Kind(
        {**ESTIMATE.schema, "properties": {**ESTIMATE.schema["properties"], **DEFAULT}},
        lambda one: ESTIMATE.write(one) | ({} if math.isnan(one.default) else {"default": one.default}),
    )
)
LEFT = {"gap_after_N": POSITIVE, "shrink": SHRINK, "shrink_ci95": INTERVAL}
LEFT_TOGETHER = {key: (kind, f"composition.{key}") for key, kind in LEFT.items()}
REGION = record(
    axis=Kind({"enum": list(AXES)}),
    **{"from": (NUMBER, "low"), "to": (NUMBER, "high")},
    share_of_energy=NUMBER("of the gap's square"),
    share_of_samples=PROBABILITY,
    rms_N=POSITIVE,
    ci95_N=INTERVAL,
    q_value=MAYBE("false-discovery rate at which it exceeds the rest of its axis"),
)
STRONGEST = record(region=(REGION, "strongest"), p_value=(MAYBE("of the test over all regions"), "max_p_value"))
REGION_AFTER = record(region=(REGION, itemgetter(0)), gap_after_N=(POSITIVE, itemgetter(1)))
RARE = record(
    mean_N=NUMBER("mean deviation of the measured force over the window"),
    limit_N=POSITIVE("which the largest of all such windows exceeds in 1 of 200 clean diagnoses"),
    **{"recording": TEXT, "time_s": NUMBER, "window_s": POSITIVE},
    **{"stroke_m": NUMBER, "speed_m_s": NUMBER, "current_A": NUMBER},
)
GAP_SIZE = record(
    rms_N=POSITIVE,
    ci95_N=INTERVAL,
    noise_floor_N=POSITIVE("of the measured force as logged"),
    noise_in_band_N=POSITIVE("the part of it on the grid of the comparison, which is subtracted"),
    cost_J=POSITIVE,
    corrected_N=POSITIVE("once the simulation's own error, learnt from references, is added"),
    corrected_ci95_N=INTERVAL,
    noise_source=TEXT("what showed the noise, as in 8.1 N from repeated cycles"),
)
CAUSE = record(
    effect=(WORD, first("effects")),
    form=(TEXT, first("forms")),
    probability=PROBABILITY,
    parameters=(PARAMETERS, lambda cause: estimates(cause)[0][1]),
    **LEFT,
    gain=NUMBER,
    gain_error=NUMBER,
)
COMPOSITION = record(
    effects=(many(WORD), "composition.effects"),
    forms=(many(TEXT), "composition.forms"),
    **LEFT_TOGETHER,
    probability=(PROBABILITY("of its effects together"), "composition.probability"),
    parameters=(by_name(PARAMETERS)("by effect"), lambda d: estimates(d.composition)),
    without_N=(
        many(POSITIVE)("the gap left without each of several effects, the others refitted"),
        "composition.without_N",
    ),
    by_region=many(REGION_AFTER),
)
CELL = record(speed_m_s=INTERVAL, current_A=INTERVAL, force_N=NUMBER)
INVISIBLE = record(effect=(WORD, itemgetter(0)), reason=(TEXT, itemgetter(1)))
CEILING = record(gap_after_N=(POSITIVE, "ceiling_after_N"), shrink=(SHRINK, shrink_of_ceiling))
CONTROLS = record(
    best_wrong_effect=(
        or_null(record(effect=(WORD, first("effects")), **LEFT)),
        lambda d: find_best_other(d, d.composition),
    ),
    ceiling=(CEILING, itself),
)
RECIPE = Kind({"type": "object"})
EXPERIMENT = record(name=TEXT, purpose=TEXT, recipe=RECIPE, separates=many(WORD), distance_N=POSITIVE)
NO_EXPERIMENT = {"purpose": "", "recipe": {}}
NEXT = Kind(
    {**EXPERIMENT.schema, "required": list(NO_EXPERIMENT)},
    lambda experiment: NO_EXPERIMENT if experiment is None else EXPERIMENT.write(experiment),
)
TWIN = record(
    kind=(TEXT("of damper"), lambda d: d.twin.body.kind),
    cost_J=(POSITIVE("on blocks of the simulated force left out of its fit"), lambda d: d.twin.cost_J),
    replaces=(FLAG("whether it replaces a simulation that cannot be run"), "is_recorded"),
)
TIMING = record(current_lead_samples=NUMBER, position_delay_s=POSITIVE)
PROBE = record(
    summary=TEXT,
    current_convention=Kind({"enum": list(CURRENT_MEANINGS)}),
    current_lead_samples=NUMBER("how much earlier it answers than to a held current; negative if later"),
    current_lead_s=NUMBER,
    position_delay_s=INTERVAL("delay inside: a certain value, and one that it does not exceed"),
    noise_N=POSITIVE("RMS by which equal calls differ, or a smooth force is rough"),
    memory_N=POSITIVE("RMS by which they differ after another call"),
    corrected=TIMING("undone before the effects are fitted, and in augmented.json; zero where nothing is"),
)
HELD_OUT = record(
    name=(TEXT, "trace.name"),
    sha256=(TEXT, "trace.recording.sha256"),
    usable_s=(POSITIVE, lambda series: float(series.trace.usable.sum()) * series.trace.step_s),
)
REASONS = Kind({"enum": ["", WITHIN_TOLERANCE, WITHIN_NOISE, WITHIN_TIMING, WITHIN_BASELINE]})
GAP = record(
    verdict=Kind({"enum": [NAMED, AMBIGUOUS, UNKNOWN, NO_GAP]}),
    sentence=TEXT,
    simulation=TEXT,
    no_gap_reason=REASONS("what a gap that is none lies within"),
    gap=GAP_SIZE,
    rare=or_null(RARE)("the largest local deviation, if it stands out; null otherwise"),
    tolerance_N=POSITIVE("a gap up to this counts as none"),
    visible_from_N=POSITIVE("effects below hide behind the noise and the simulation's own error"),
    where=(many(REGION)("regions of one axis each, most energy first"), "where.regions"),
    max_region=(or_null(STRONGEST), lambda d: None if d.where.strongest is None else d.where),
    causes=many(CAUSE)("each effect alone, most probable first"),
    composition=(COMPOSITION, itself),
    calibration_map=(
        many(CELL)("mean force that a calibration in the composition adds to the simulation, by speed and current"),
        calibration_cells,
    ),
    explained_as_well=many(many(WORD, 1))("parameters and effects that together would explain the gap as well"),
    indistinguishable=many(many(WORD, 2))("groups of effects that are indistinguishable on these recordings"),
    not_separable=many(WORD)("effects that a calibration of the simulation could absorb: references are needed"),
    invisible=many(INVISIBLE)("effects that these recordings cannot show"),
    probabilities=(
        record(none=(PROBABILITY, "probability_none"), unknown=(PROBABILITY, "probability_unknown")),
        itself,
    ),
    controls=(CONTROLS, itself),
    ceiling=(CEILING("what a learner without physics leaves"), itself),
    rest=(
        or_null(many(REGION))("where the unexplained rest lies"),
        lambda d: None if d.rest is None else d.rest.regions,
    ),
    next_experiment=NEXT,
    twin=(
        or_null(TWIN)("the network fitted to the simulation, into which effects are put; null without"),
        lambda d: None if d.twin is None else d,
    ),
    input_probe=(PROBE("what the simulation does to its inputs"), "probe"),
    held_out=many(HELD_OUT),
    notes=many(TEXT),
)
