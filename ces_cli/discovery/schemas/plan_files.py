"""Schemas of the plans: `ces iterate`, `ces learn-stroke` and `ces identify --campaign`."""

from __future__ import annotations

from collections.abc import Mapping

from ces_cli.discovery.schemas.parts import (
    FLAG,
    TEXT,
    TEXTS,
    Schema,
    mapping_of,
    number_between,
    of_dataclass,
    of_kinds,
    one_of,
    one_or_list_of,
    with_description,
)
from ces_identify.campaign.axes import COMMON, LIMITS, STRUCTURES, CampaignAxis
from ces_identify.campaign.plan import AUTO
from ces_identify.polynomial.search_limits import METHODS
from ces_identify.structures import KITS
from ces_iterate.plan import plan as iterate_plan
from ces_iterate.rigs.kinds import RIG_SETTINGS
from ces_iterate.stroke import plan as stroke_plan
from ces_iterate.stroke.actuator_model import ActuatorModel
from ces_iterate.stroke.goal import LearningSettings, ProbeSettings
from ces_iterate.stroke.limits import StrokeLimits
from ces_rig.drive.servo_actuator import ServoActuator

AXES: Mapping[str, Schema] = {  # one value on each axis of a campaign, besides the sizes of structures
    "terms": number_between(1, 200, whole=True),
    "method": one_of(METHODS),
    "candidates": TEXT,
    "rate_Hz": {"anyOf": [{"const": AUTO}, number_between(1.0, 1e5)]},
    "bandwidth_Hz": {"anyOf": [{"const": AUTO}, number_between(0.01, 5e4)]},
    "certificate": FLAG,
    "seeds": number_between(0, 2**31, whole=True),
    "seconds": number_between(0.1, 1e6),
    "target": number_between(0.0, 100.0),
    "starts": number_between(1, 10000, whole=True),
    "threads": number_between(1, 256, whole=True),
}
SIZES = {size.name: size for kit in KITS.values() for size in kit.sizes}


def iterate_schema() -> Schema:
    """Return the schema of a plan for `ces iterate`."""
    plan = of_dataclass(iterate_plan.SimpleSettings)
    sections = {name: of_dataclass(cls) for name, cls in iterate_plan.SECTIONS.items()}
    properties = {**plan["properties"], **sections, "rig": of_kinds(RIG_SETTINGS)}
    return mapping_of({key: properties[key] for key in iterate_plan.KEYS}, ("limits", "rig"))


def learn_stroke_schema() -> Schema:
    """Return the schema of a plan for `ces learn-stroke`."""
    properties = {
        "description": TEXT,
        "experiment": with_description(TEXT, "packaged experiment, or a file beside this one: its stroke is wanted"),
        "rig": of_kinds(RIG_SETTINGS),
        "actuator": of_dataclass(ServoActuator),
        "limits": of_dataclass(StrokeLimits),
        "probe": of_dataclass(ProbeSettings),
        "learning": of_dataclass(LearningSettings),
        "model": of_dataclass(ActuatorModel),
    }
    return mapping_of({key: properties[key] for key in stroke_plan.KEYS}, ("experiment",))


def campaign_schema() -> Schema:
    """Return the schema of a campaign."""
    bags = {"anyOf": [TEXT, {**TEXTS, "minItems": 1, "uniqueItems": True}]}
    sets = {
        "type": "object",
        "minProperties": 1,
        "propertyNames": {"pattern": r"^[\w.+-]+$"},
        "additionalProperties": bags,
    }
    structures = {name: {"anyOf": [{"type": "null"}, mapping_of(_axes(axes))]} for name, axes in STRUCTURES.items()}
    properties = {
        "bags": with_description(sets, "sets of recordings to identify on; each gives models of its own"),
        "validate": with_description(sets, "recordings to validate every model on"),
        "structures": {**mapping_of(structures), "minProperties": 1},
        **_axes(COMMON),
        "limits": mapping_of({key: with_description(AXES[key], axis.expected) for key, axis in LIMITS.items()}),
        "split": number_between(0.05, 1.0),
        "signals": with_description({"type": ["string", "null"]}, "signals file (default: the packaged one)"),
    }
    return mapping_of(properties, ("bags", "structures"))


def _axes(axes: Mapping[str, CampaignAxis]) -> dict[str, Schema]:
    return {key: with_description(one_or_list_of(_one_value(key)), axis.expected) for key, axis in axes.items()}


def _one_value(key: str) -> Schema:
    if key in AXES:
        return AXES[key]
    whole = SIZES[key].whole
    return number_between(*whole, whole=True) if whole else {"type": ["string", "integer"]}
