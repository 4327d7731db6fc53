"""Declares the nodes' parameters from their tables, with description and range, and reads them into checked settings.

rclpy has already declared those that were set at the start (automatically_declare_parameters_from_overrides), without
description; so unknown parameters can be reported. With names in the observer's `dampers`, each damper has parameters
NAME.model, NAME.position.topic and so on; one that is not set has the value of the parameter without the name.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, ClassVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter

from ces_observer.control.force_controller import ForceCurve, Tuning
from ces_observer.control.inverse_map import ModelInverse
from ces_observer.errors import CesError, ModelError, SignalsError
from ces_observer.model import Model, load_model
from ces_observer.nodes import parameter_table as tables
from ces_observer.nodes.guarded_node import GuardedNode
from ces_observer.nodes.model_check import require_stable
from ces_observer.nodes.parameter_table import DAMPERS, LOOP, NAME, OF_A_DAMPER, OF_THE_NODE
from ces_observer.options import Option
from ces_observer.signals import DEFAULTS, MOTIONS, NAMES, NUMBERS, Constant, Signals, override

NULL = "null"  # what `ros2 param dump` writes for a parameter that is not set, and ROS 2 then reads as a text
LIVE_OF_CONTROLLER = tuple(spec.name for spec in (*LOOP, *tables.TUNING, *tables.CURVE) if spec.live)
SIGNALS = ("position", "current", "force", *MOTIONS)


class TableNode(GuardedNode):
    """A guarded node whose parameters are declared from a table; raises CesError for a parameter without a type.

    `MAY_BE_EMPTY` names the lists that may be empty; ROS 2 has no type for an empty list. `answer` is what became of a
    parameter that is being set, if more is to be said than that it is set.
    """

    MAY_BE_EMPTY: ClassVar[frozenset[str]] = frozenset()
    IS_MANAGED: ClassVar[bool] = False  # parameters that are not live may change while it is not configured

    def __init__(self, name: str) -> None:
        self.specs: dict[str, Option] = {}  # by parameter name
        self.answer: SetParametersResult | None = None
        try:
            super().__init__(name, automatically_declare_parameters_from_overrides=True)
        except ValueError:
            raise CesError("a parameter has no value or is an empty list; remove it") from None

    def declare_parameters(self, namespace: str, parameters: list[Any], ignore_override: bool = False) -> list[Any]:
        """Do the same as rclpy, but leave empty lists in MAY_BE_EMPTY to `declare`."""
        typed = [
            parameter
            for parameter in parameters
            if not (ignore_override and parameter[0] in self.MAY_BE_EMPTY and parameter[1] is None)
        ]
        declared: list[Any] = super().declare_parameters(namespace, typed, ignore_override)
        return declared

    def set_parameters_atomically(self, parameter_list: list[Parameter]) -> SetParametersResult:
        """Do the same as rclpy, but refuse first, in the words of rclcpp and of the table; return `answer` if any."""
        try:
            for parameter in parameter_list:
                self._require_settable(parameter)
        except CesError as error:
            return SetParametersResult(successful=False, reason=str(error))
        self.answer = None
        result = super().set_parameters_atomically(parameter_list)
        return (self.answer or result) if result.successful else result

    @property
    def is_configured(self) -> bool:
        """Whether parameters that are not live are in use."""
        return True

    def _require_settable(self, parameter: Parameter) -> None:
        if not self.has_parameter(parameter.name):
            raise CesError(f"parameter '{parameter.name}' cannot be set because it was not declared")
        descriptor = self.describe_parameter(parameter.name)
        if descriptor.read_only:
            raise CesError(f"parameter '{parameter.name}' cannot be set because it is read-only")
        if spec := self.specs.get(parameter.name):
            if self.is_configured and not spec.live:
                raise CesError(f"parameter '{parameter.name}' cannot be set because {tables.IN_USE}")
            check_given(spec, parameter)
        else:
            tables.require_type(parameter.name, Parameter.Type(descriptor.type).name, parameter.type_.name)

    def refuse_parameters(self, check: Callable[[Sequence[Parameter]], object]) -> None:
        """Refuse changes of parameters for which `check` raises CesError; it does not see those of ROS itself."""

        def answer(parameters: Sequence[Parameter]) -> SetParametersResult:
            own = [parameter for parameter in parameters if parameter.name.partition(".")[0] not in tables.OF_ROS]
            try:
                if own:
                    check(own)
            except CesError as error:
                return SetParametersResult(successful=False, reason=str(error))
            return SetParametersResult(successful=True)

        self.add_on_set_parameters_callback(answer)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Call `callback` by the steady clock, whatever the node's time does."""
        self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def check_given(spec: Option, given: Parameter) -> None:
    """Raise CesError unless a parameter has the type and the range in its table."""
    tables.check_value(spec, given.name, given.type_.name, given.value)


def declare_table(node: TableNode, table: Iterable[Option], groups: Collection[str] = ()) -> dict[str, Any]:
    """Declare all of `table`, warn of unknown parameters, and return the values by name.

    Names below one of `groups` are not unknown. Raises CesError or rclpy's ParameterException if a value is wrong.
    """
    values = {spec.name: declare(node, spec) for spec in table}
    warn_of_unknown(node, values, groups)
    return values


def warn_of_unknown(
    node: Node, known_names: Collection[str], groups: Collection[str] = (), owners: Collection[str] = ()
) -> None:
    """Log a warning for each parameter that `find_unknown` returns."""
    for name in tables.find_unknown(node.get_parameters_by_prefix(""), known_names, groups, owners):
        node.get_logger().warning(
            f"parameter '{name}' is unknown and ignored; known are {', '.join(sorted(known_names))}"
        )


def declare(node: TableNode, spec: Option) -> Any:
    """Declare `spec` and return its value; raises CesError or rclpy's ParameterException if the value is wrong."""
    value = declare_anew(node, spec.name, spec)
    return spec.check_parameter([] if value is None and isinstance(spec.default, list) else value)


def descriptor_of(spec: Option) -> ParameterDescriptor:
    """Return the ROS descriptor of `spec`."""
    descriptor = ParameterDescriptor(description=spec.described)
    is_limited = isfinite(spec.high)
    if is_limited or spec.choices:
        descriptor.additional_constraints = spec.expected
    if is_limited and spec.kind is int:
        descriptor.integer_range = [IntegerRange(from_value=int(spec.low), to_value=int(spec.high), step=1)]
    elif is_limited:
        descriptor.floating_point_range = [FloatingPointRange(from_value=float(spec.low), to_value=float(spec.high))]
    return descriptor


def declare_anew(node: TableNode, name: str, spec: Option, note: str = "") -> Any:
    """Declare a parameter, again if it has no description, and return its value; raises CesError if that is wrong.

    Without a default it may be not set, or NULL.
    """
    descriptor, is_null = descriptor_of(spec), False
    descriptor.description += note
    descriptor.read_only = not spec.live and (spec.name in tables.OF_THE_PROCESS or not node.IS_MANAGED)
    # rclpy cannot return several parameters if one of a fixed type is not set.
    descriptor.dynamic_typing = spec.default is None
    if node.has_parameter(name):
        given = node.get_parameter_or(name)
        is_null = spec.default is None and given.value == NULL
        if not is_null:
            check_given(spec, given)
        node.undeclare_parameter(name)
    node.specs[name] = spec
    return node.declare_parameter(name, spec.default, descriptor, ignore_override=is_null).value


def value_of(node: Node, name: str) -> Any:
    """Return the value of a parameter, None if it is not set or not declared."""
    return node.get_parameter_or(name).value


def model_path(text: str) -> Path:
    """Return the path in a parameter `model`; raises ModelError unless it is an absolute path."""
    try:
        path = Path(text).expanduser()
    except RuntimeError:  # there is no such user
        path = Path()
    if not path.is_absolute():  # the node's working folder is not that of who sets the parameter
        what = f"is {text!r}" if text else "is not set"
        raise ModelError(f"parameter 'model' {what}; expected the absolute path of a model file: /path/model.json")
    return path


def load_first_model(values: Mapping[str, Any]) -> tuple[Path, Model]:
    """Load the model that a node starts with, and prove it stable unless `allow_uncertified`; raises CesError."""
    path = model_path(values["model"])
    model = load_model(path)
    if not values["allow_uncertified"]:
        require_stable(model, str(path))
    return path, model


@dataclass(frozen=True)
class DamperSettings:
    """The settings of one damper; `key` is its name in `dampers`, empty if it is the only one."""

    key: str
    name: str
    model: Model
    model_path: Path
    signals: Signals
    values: dict[str, Any]  # by the names in OF_A_DAMPER, as they were when it was configured

    @property
    def label(self) -> str:
        """Its name in logs and diagnostics."""
        return self.key or self.name

    @property
    def prefix(self) -> str:
        """Prefix of its own parameters."""
        return f"{self.key}." if self.key else ""

    @property
    def topics(self) -> str:
        """Prefix of its topics and services."""
        return f"~/{self.key}/" if self.key else "~/"


def declare_observer(node: TableNode) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Declare the observer's parameters; returns values by the names in OF_THE_NODE, and the names in `dampers`.

    Raises CesError or rclpy's ParameterException.
    """
    values = {spec.name: declare(node, spec) for spec in OF_THE_NODE}
    keys = _declare_dampers(node)
    for spec in (*OF_A_DAMPER, NAME):
        declare(node, spec)
        for key in keys:
            declare_anew(node, f"{key}.{spec.name}", replace(spec, default=None), "; not set: as for all dampers")
    for prefix in ("", *(f"{key}." for key in keys)):
        _declare_signals(node, prefix)
    known_names = {spec.name for spec in (*OF_THE_NODE, *OF_A_DAMPER, NAME)} | {DAMPERS}
    warn_of_unknown(node, known_names, NAMES, keys)
    return values, keys


def read_dampers(node: Node, keys: tuple[str, ...]) -> tuple[DamperSettings, ...]:
    """Return the settings of each damper by the present parameters, its model loaded and proved; raises CesError."""
    return tuple(_read_damper(node, key) for key in keys or ("",))


def governing_parameter(node: Node, prefix: str, name: str) -> str:
    """Return the name of the parameter whose value now applies to the damper with this prefix: its own, or the common.

    A damper without a name has the common one alone.
    """
    return name if value_of(node, prefix + name) is None else prefix + name


def live_value(node: Node, prefix: str, name: str) -> Any:
    """Return the present value of a parameter for the damper with this prefix."""
    return value_of(node, governing_parameter(node, prefix, name))


def check_live_values(parameters: Sequence[Parameter]) -> None:
    """Raise CesError if one of these parameters is the path of a model that cannot be used."""
    for parameter in parameters:
        if parameter.name.rpartition(".")[2] == "model":
            load_model(model_path(parameter.value))


def _declare_dampers(node: TableNode) -> tuple[str, ...]:
    keys = declare_anew(node, DAMPERS, tables.OF_DAMPERS) or []
    for key in keys:
        if not key.isidentifier() or not key.isascii() or key in NAMES:
            raise CesError(
                f"parameter '{DAMPERS}' has '{key}'; expected letters, digits and underscores that do not begin with a "
                "digit, and not the name of a signal"
            )
    if len(set(keys)) < len(keys):
        raise CesError(f"parameter '{DAMPERS}' is {list(keys)}; expected each name once")
    return tuple(keys)


def _declare_signals(node: TableNode, prefix: str) -> None:
    """Declare the parameters of all signals; with the `prefix` of one damper they have no defaults."""
    for signal in SIGNALS:
        defaults = {**DEFAULTS[signal], **NUMBERS} if signal in DEFAULTS and not prefix else {}
        for spec in tables.signal_options(signal, defaults):
            declare_anew(node, prefix + spec.name, spec)


def _read_damper(node: Node, key: str) -> DamperSettings:
    """Read the settings of a damper, its own over the common ones; raises CesError."""
    prefix = f"{key}." if key else ""
    values = {s.name: s.check_parameter(live_value(node, prefix, s.name), prefix + s.name) for s in OF_A_DAMPER}
    signals = _read_signals(node, prefix)
    position = signals["position"]
    if isinstance(position, Constant):
        raise SignalsError(
            f"signal '{prefix}position' is constant; expected topic, type and field of a measured position"
        )
    path, model = load_first_model(values)
    joint = next((element for _, element in position.field.steps if isinstance(element, str)), "")
    name = value_of(node, prefix + NAME.name) or joint or key or "damper"
    return DamperSettings(key, name, model, path, signals, values)


def _read_signals(node: Node, prefix: str) -> Signals:
    """Return the signals of a damper, its own settings over the common ones; raises SignalsError."""

    def read(name: str) -> dict[str, Any]:
        keys = {key: value_of(node, f"{name}.{key}") for key in node.get_parameters_by_prefix(name)}
        return {key: value for key, value in keys.items() if value is not None}

    mapping = {signal: override(read(signal), read(prefix + signal)) for signal in SIGNALS}
    mapping = {signal: keys for signal, keys in mapping.items() if keys or signal in DEFAULTS}  # others are optional
    return Signals.from_mapping(mapping, f"parameters of '{prefix[:-1]}'" if prefix else "parameters")


@dataclass(frozen=True)
class LiveSettings:
    """The controller's checked settings that may change while it runs."""

    curve: ForceCurve
    tuning: Tuning
    feedback: str
    max_age_s: float


@dataclass(frozen=True)
class ControllerSettings:
    """The settings when it was configured; a negative `valve_lag_s` is replaced by that of the model's inverse."""

    values: Mapping[str, Any]  # by the names in tables.OF_THE_CONTROLLER
    model: Model
    model_path: Path
    inverse: ModelInverse
    live: LiveSettings


def declare_controller(node: TableNode) -> dict[str, Any]:
    """Declare the controller's parameters; returns their values. Raises CesError or rclpy's ParameterException."""
    return declare_table(node, tables.OF_THE_CONTROLLER)


def read_controller(node: Node, names: Iterable[str]) -> ControllerSettings:
    """Return the settings by the present parameters, the model loaded, proved and inverted; raises CesError."""
    values = {name: value_of(node, name) for name in names}
    path, model = load_first_model(values)
    inverse = ModelInverse.from_model(model, str(path))
    return ControllerSettings(values, model, path, inverse, build_live_settings(values, inverse.lag_s))


def read_live_settings(node: Node, parameters: Sequence[Parameter], model_lag_s: float) -> LiveSettings:
    """Return the live settings with `parameters` changed; raises CesError if together they cannot be used.

    Only the file of a new model is checked: changing to the model takes too long for a parameter callback.
    """
    changed = {parameter.name: parameter.value for parameter in parameters}
    if "model" in changed:
        load_model(model_path(changed["model"]))
    values = {name: changed.get(name, node.get_parameter(name).value) for name in LIVE_OF_CONTROLLER}
    return build_live_settings(values, model_lag_s)


def build_live_settings(values: Mapping[str, Any], model_lag_s: float) -> LiveSettings:
    """Return the settings in `values`, by parameter name; raises CesError if they cannot be used."""
    tuning = {spec.name: values[spec.name] for spec in tables.TUNING}
    if tuning["valve_lag_s"] < 0.0:
        tuning["valve_lag_s"] = Tuning.lead_s(model_lag_s, tuning["preview_s"])
    curve = ForceCurve.from_points(values[tables.SPEEDS], values[tables.FORCES])
    return LiveSettings(curve, Tuning(**tuning), values["feedback"], values["max_age_s"])
