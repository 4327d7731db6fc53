from __future__ import annotations

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from diagnoses import ALL, ambiguous, named, no_gap, unknown
from schema_rules import SCHEMA, faults

from ces_gap.errors import GapError
from ces_gap.report.gap_json import gap_document


def leaves(item: Any) -> Iterator[Any]:
    if isinstance(item, dict | list):
        for inner in item.values() if isinstance(item, dict) else item:
            yield from leaves(inner)
    else:
        yield item


@pytest.mark.parametrize("verdict", ALL)
def test_every_verdict_follows_the_schema(verdict: str) -> None:
    document = gap_document(ALL[verdict]())
    assert document["verdict"] == verdict
    assert faults(document) == []
    total = sum(c["probability"] for c in document["causes"]) + sum(document["probabilities"].values())
    assert total == pytest.approx(1.0, abs=0.015)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("schema",), "ces-gap/2"),
        (("verdict",), "perhaps"),
        (("gap", "rms_N"), -1.0),
        (("gap", "ci95_N"), [1.0]),
        (("gap", "rms_N"), "12"),
        (("where", 0, "axis"), "speed"),
        (("where", 0, "share_of_samples"), 1.2),
        (("causes", 0, "probability"), None),
        (("causes", 0, "shrink"), 1.01),
        (("causes", 0, "parameters", "coulomb_N", "value"), True),
        (("composition", "parameters", "friction", "coulomb_N"), 3.0),
        (("indistinguishable",), [["friction"]]),
        (("next_experiment",), None),
        (("surplus",), 1),
    ],
)
def test_schema_refuses_what_the_contract_does(path: tuple[Any, ...], value: object) -> None:
    document = deepcopy(gap_document(named()))
    place: Any = document
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    assert len(faults(document)) == 1


REGION = "axis from to share_of_energy share_of_samples rms_N ci95_N q_value"
KEYS = {  # of ces-gap/1: other programs read them, whatever table writes them
    **dict.fromkeys(
        ["schema", "verdict", "sentence", "simulation", "no_gap_reason", "tolerance_N", "visible_from_N"], ""
    ),
    **dict.fromkeys(["explained_as_well", "indistinguishable", "not_separable", "notes"], ""),
    **dict.fromkeys(("where", "rest"), REGION),
    "gap": "rms_N ci95_N noise_floor_N noise_in_band_N cost_J corrected_N corrected_ci95_N noise_source",
    "max_region": "region p_value",
    "causes": "effect form probability parameters gap_after_N shrink shrink_ci95 gain gain_error",
    "composition": "effects forms gap_after_N shrink shrink_ci95 probability parameters without_N by_region",
    "rare": "mean_N limit_N recording time_s window_s stroke_m speed_m_s current_A",
    "calibration_map": "speed_m_s current_A force_N",
    "invisible": "effect reason",
    "probabilities": "none unknown",
    "controls": "best_wrong_effect ceiling",
    "ceiling": "gap_after_N shrink",
    "next_experiment": "name purpose recipe separates distance_N",
    "twin": "kind cost_J replaces",
    "input_probe": (
        "summary current_convention current_lead_samples current_lead_s position_delay_s noise_N memory_N corrected"
    ),
    "held_out": "name sha256 usable_s",
}


def test_the_keys_are_those_of_the_contract() -> None:
    def inside(schema: dict[str, Any]) -> str:
        schema = schema["anyOf"][1] if "anyOf" in schema else schema
        return inside(schema["items"]) if "items" in schema else " ".join(schema.get("properties", {}))

    assert {key: inside(schema) for key, schema in SCHEMA["properties"].items()} == KEYS
    assert list(gap_document(named())) == list(SCHEMA["properties"])


def test_numbers_are_those_of_the_diagnosis() -> None:
    document, d = gap_document(named()), named()
    assert document["gap"]["rms_N"] == d.gap.rms_N and document["gap"]["corrected_N"] == d.gap.corrected_N
    assert document["causes"][0]["parameters"]["coulomb_N"]["ci95"] == [35.1, 38.4]
    assert document["composition"]["effects"] == ["friction"]
    assert document["ceiling"]["shrink"] == pytest.approx(1.0 - d.ceiling_after_N / d.gap.corrected_N)
    assert document["controls"]["best_wrong_effect"]["effect"] == "valve_lag"
    energies = [row["share_of_energy"] for row in document["where"]]
    assert energies == sorted(energies, reverse=True) and len(energies) == len(d.where.regions)


def test_what_only_some_verdicts_have() -> None:
    pair, missing, nothing, found = (gap_document(make()) for make in (ambiguous, unknown, no_gap, named))
    assert pair["indistinguishable"] == [["valve_lag", "current_hysteresis"]]
    assert pair["next_experiment"]["separates"] == ["valve_lag", "current_hysteresis"]
    assert pair["twin"] == {"kind": "twin tube", "cost_J": 2.7, "replaces": True}
    recipe = found["next_experiment"]["recipe"]  # as plain JSON
    assert recipe["stroke"]["amplitude_m"] == 0.02 and type(recipe["stroke"]["amplitude_m"]) is float
    assert recipe["current"] == {"kind": "steps", "levels_A": [0.3, 1.2], "hold_s": 4}
    assert missing["rest"] and found["rest"] is None
    assert nothing["composition"]["shrink"] is None and nothing["composition"]["effects"] == []
    assert nothing["next_experiment"] == {"purpose": "", "recipe": {}}


def test_numbers_have_six_digits_and_are_finite() -> None:
    d = named()
    gap = replace(d.gap, rms_N=math.pi * 1e3, noise_floor_N=math.nan, ci95_N=(np.float64(1 / 3), math.inf))
    document = gap_document(replace(d, gap=gap))
    assert document["gap"]["rms_N"] == 3141.59 and document["gap"]["noise_floor_N"] is None
    assert document["gap"]["ci95_N"] == [0.333333, None]
    numbers = [v for v in leaves(document) if isinstance(v, float)]
    assert all(math.isfinite(v) and v == float(f"{v:.6g}") for v in numbers)
    assert faults(document) == []


def test_a_recipe_that_json_cannot_represent_is_refused() -> None:
    experiment = named().next_experiment
    assert experiment is not None
    d = replace(named(), next_experiment=replace(experiment, recipe={"stroke": {1, 2}}))
    with pytest.raises(GapError, match="next_experiment: recipe: stroke: a set; expected"):
        gap_document(d)
