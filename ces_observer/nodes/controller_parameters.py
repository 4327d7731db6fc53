"""The controller node's parameters, declared and read into checked settings; some may change at run time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.parameter import Parameter

from ces_observer.control.controller_tuning import Tuning
from ces_observer.control.force_curve import ForceCurve
from ces_observer.control.model_inverse import ModelInverse
from ces_observer.model import Model, load_model
from ces_observer.nodes.controller_table import ALL, CURVE, FORCES, LOOP, SPEEDS, TUNING
from ces_observer.nodes.model_check import require_stable
from ces_observer.nodes.node_parameters import declare_table, model_path

LIVE = tuple(spec.name for spec in (*LOOP, *TUNING, *CURVE) if spec.live)


@dataclass(frozen=True)
class LiveSettings:
    """The checked settings that may change while the node runs."""

    curve: ForceCurve
    tuning: Tuning
    feedback: str
    max_age_s: float


@dataclass(frozen=True)
class ControllerSettings:
    """The settings at the start; a negative `valve_lag_s` is replaced by that of the model's inverse."""

    values: Mapping[str, Any]  # by the names in FIXED
    model: Model
    model_path: Path
    inverse: ModelInverse
    live: LiveSettings


def declare_settings(node: Node) -> ControllerSettings:
    """Declare and read the node's parameters; raises CesError or rclpy's ParameterException."""
    values = declare_table(node, ALL)
    path = model_path(values["model"])
    model = load_model(path)
    if not values["allow_uncertified"]:
        require_stable(model, str(path))
    inverse = ModelInverse.from_model(model, str(path))
    return ControllerSettings(values, model, path, inverse, build_live_settings(values, inverse.lag_s))


def read_live_settings(node: Node, parameters: Sequence[Parameter], model_lag_s: float) -> LiveSettings:
    """Return the live settings with `parameters` changed; raises CesError if together they cannot be used.

    Only the file of a new model is checked: changing to the model takes too long for a parameter callback.
    """
    for parameter in parameters:
        if parameter.name == "model":
            load_model(model_path(parameter.value))
    values = {name: node.get_parameter(name).value for name in LIVE}
    values.update({parameter.name: parameter.value for parameter in parameters if parameter.name in values})
    return build_live_settings(values, model_lag_s)


def build_live_settings(values: Mapping[str, Any], model_lag_s: float) -> LiveSettings:
    """Return the settings in `values`, by parameter name; raises CesError if they cannot be used."""
    for spec in LOOP:
        spec.check_value(values[spec.name])
    field_names = {"timeout_s": "max_gap_s"}
    tuning = {field_names.get(spec.name, spec.name): values[spec.name] for spec in TUNING}
    if tuning["valve_lag_s"] < 0.0:
        tuning["valve_lag_s"] = Tuning.lead_s(model_lag_s, tuning["preview_s"])
    curve = ForceCurve.from_points(values[SPEEDS], values[FORCES])
    return LiveSettings(curve, Tuning(**tuning), values["feedback"], values["max_age_s"])
