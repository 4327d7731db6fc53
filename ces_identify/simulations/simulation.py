"""The interface of all simulations of the damper; those by models, functions and predictions; parameters to be fitted.

A Python function declares parameters by keyword-only arguments with defaults, `def force(time_s, position_m, current_A,
*, knee_m_s=0.12)`, the unit at the end of the name; an FMU by its variables of causality parameter. Those of a
hydraulic model are what wear and another specimen change: each scales or shifts a whole part of the damper, as a softer
spring or less gas would. Mounts, moving mass and the drive's lead are those of the rig and stay.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_identify.limits import TickLimits
from ces_identify.physical.laws import EASY, SHUT, STARTS
from ces_identify.prepare.series import PositionSamples, changes, interpolate_force, usable_samples
from ces_identify.simulations.simulate import OpenedRecording, open_recording, run_opened
from ces_observer.errors import CesError
from ces_observer.limits import NumberLimits
from ces_observer.model import Model
from ces_observer.structures.curves import Bypass, FlowMap
from ces_observer.structures.hydraulic import EDGES, FrictionElement, Hydraulic, SideForces


@dataclass(frozen=True)
class Parameter:
    """A number of a simulation by `name`: its `default`, and what is possible, [`low`, `high`].

    One that is `whole` counts something and never changes by a fraction. `unit` is empty where the name ends with it.
    """

    name: str
    default: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""
    whole: bool = False


def declared_parameters(function: Callable[..., Any], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the finite numbers among the keyword-only arguments of a function; `values` replace their defaults.

    Switches (bool), texts and whatever else is no number are settings and left out.
    """
    try:
        arguments = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):  # compiled code without a signature
        return ()
    numbers = [a for a in arguments if a.kind is a.KEYWORD_ONLY and is_number(a.default)]
    parameters = [Parameter(a.name, float(a.default), whole=isinstance(a.default, int)) for a in numbers]
    return with_defaults(parameters, values)


def is_number(value: object) -> bool:
    """Return whether a default is a finite number, of Python or of NumPy, and no switch."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def with_defaults(parameters: Iterable[Parameter], values: Mapping[str, float]) -> tuple[Parameter, ...]:
    """Return the parameters with the `values` as their defaults."""
    return tuple(replace(p, default=float(values.get(p.name, p.default))) for p in parameters)


VALVES = {  # the edge and the direction of flow in which a valve acts
    "compression_valve": ("piston", "onward"),
    "rebound_valve": ("piston", "back"),
    "base_valve": ("base", "onward"),
    "external_valve": ("external", "onward"),
}
TIMES = "times"
MAX_GAIN = 3.0  # of the current: more would turn curves of a valve around
MAX_GAS = 5.0  # change of the gas force, relative to the largest force
WIDER = 10.0  # ranges of pressures and forces, in which a changed model is held
LEAST = 0.01  # rise of a changed curve, relative to the least before


def hydraulic_parameters(model: Model) -> tuple[Parameter, ...]:
    """Return the parameters of a model; none if it is not hydraulic."""
    body = model.body
    if not isinstance(body, Hydraulic):
        return ()
    friction_N, lag_s = (
        sum(element.yield_N for element in body.side.friction),
        0.5 * (body.valve.rise_s + body.valve.fall_s),
    )
    most_N, speed = max(map(abs, model.force_envelope_N)), max(map(abs, model.envelope.speed_m_s))
    currents = changes(np.array(model.envelope.current_A))  # of a constant one, gain and lag are unknown
    return (
        *(Parameter(name, 1.0, unit=TIMES) for name in find_valves(body)),
        *([Parameter("current_gain", 1.0, 1.0 / MAX_GAIN, MAX_GAIN, TIMES)] if currents else []),
        Parameter("leak_m_s_rtN", 0.0, 0.0, speed / float(np.sqrt(most_N))),
        Parameter("oil_stiffness", 1.0, unit=TIMES),
        Parameter("gas_rate", 1.0, unit=TIMES),
        Parameter("gas_force_change_N", 0.0, -MAX_GAS * most_N, MAX_GAS * most_N),
        *([Parameter("friction_N", friction_N)] if friction_N > 0.0 else []),
        *([Parameter("valve_lag_s", lag_s)] if currents and lag_s > 0.0 else []),
    )


def find_valves(body: Hydraulic) -> list[str]:
    """Return the valves of its kind of damper; checks and what is shut are none."""
    laws = {name: getattr(getattr(STARTS[body.kind], edge), way) for name, (edge, way) in VALVES.items()}
    return [name for name, law in laws.items() if law not in (EASY, SHUT)]


def change_hydraulic(model: Model, values: Mapping[str, float]) -> Model:
    """Return the model with `values` of some of its parameters, its force held within wider limits."""
    body = model.body
    assert isinstance(body, Hydraulic)
    value = {**{p.name: p.default for p in hydraulic_parameters(model)}, **values}
    lags = value.get("valve_lag_s", 1.0) / max(0.5 * (body.valve.rise_s + body.valve.fall_s), 1e-300)
    edges: dict[str, Any] = {edge: _change_edge(getattr(body, edge), edge, value) for edge in EDGES}
    changed = replace(
        body,
        **edges,
        valve=replace(body.valve, rise_s=lags * body.valve.rise_s, fall_s=lags * body.valve.fall_s),
        compression_m_N=body.compression_m_N / value["oil_stiffness"],
        rebound_m_N=body.rebound_m_N / value["oil_stiffness"],
        bypass=_add_leak(body.bypass, value["leak_m_s_rtN"], model.envelope.position_m),
        side=_change_side(body.side, value, 0.5 * sum(model.envelope.position_m)),
        most_N=WIDER * body.most_N,
    )
    low, high = model.force_envelope_N
    return replace(model, body=changed, force_envelope_N=(WIDER * low, WIDER * high), certificate=None)


def _change_edge(flow: FlowMap, edge: str, value: Mapping[str, float]) -> FlowMap:
    """Return the curves of an edge: what the current adds times the gain, and each direction times its valve."""
    at, drops = np.array(flow.at), np.array(flow.rows)
    rises = np.diff(drops, axis=1)
    more = np.maximum(rises[0] + value.get("current_gain", 1.0) * (rises - rises[0]), LEAST * rises.min(axis=0))
    valves = {way: name for name, (place, way) in VALVES.items() if place == edge}
    onward, back = (value.get(valves.get(way, ""), 1.0) for way in ("onward", "back"))
    scaled = more * np.where(at[:-1] < 0.0, back, onward)
    ends = np.insert(np.cumsum(scaled, axis=1), 0, 0.0, axis=1)
    return FlowMap(flow.at, tuple(map(tuple, (ends - ends[:, at == 0.0]).tolist())))


def _add_leak(bypass: Bypass | None, leak: float, position_m: tuple[float, float]) -> Bypass | None:
    """Return a bypass that is open by `leak` [m/s/√N] over the whole stroke, beside the one that there is."""
    if leak <= 0.0:
        return bypass
    own = bypass or Bypass(position_m, (NumberLimits.MIN_OPENING, NumberLimits.MIN_OPENING))
    return Bypass(own.position_m, tuple(opening + leak for opening in own.values))


def _change_side(side: SideForces, value: Mapping[str, float], middle_m: float) -> SideForces:
    middle_N, whole_N = side.gas(middle_m), sum(element.yield_N for element in side.friction)
    gas = (middle_N + value["gas_rate"] * (gas_N - middle_N) + value["gas_force_change_N"] for gas_N in side.gas_N)
    rub, gain = value.get("friction_N", whole_N) / max(whole_N, 1e-300), value.get("current_gain", 1.0)
    return replace(
        side, gas_N=tuple(gas), friction=tuple(_change_friction(element, rub, gain) for element in side.friction)
    )


def _change_friction(element: FrictionElement, rub: float, gain: float) -> FrictionElement:
    """Return the friction with both of its forces scaled; it yields after the same way."""
    before, yield_N, moved_N = element.yield_N + element.moved_N, rub * element.yield_N, gain * element.moved_N
    return FrictionElement(element.stiffness_N_m * (yield_N + moved_N) / max(before, 1e-300), yield_N, moved_N)


ForceFunction = Callable[..., F]  # time_s, position_m, current_A (and named numbers) -> force_N, all of shape (n,)


@runtime_checkable
class Simulation(Protocol):
    """A source of simulated forces; every kind of simulation is a subclass."""

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample of `recording`, shape (n,), NaN where there is none."""

    @property
    def innermost(self) -> Simulation:
        """The simulation inside all wrappers; itself if it wraps none."""
        return self

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The named numbers that may be fitted, with their present values as defaults."""
        return ()

    def with_values(self, values: Mapping[str, float]) -> Simulation:
        """Return the simulation with other values of some of its `parameters`."""
        return self

    def open(self, recording: Recording) -> Any:
        """Return what runs on a recording share whatever the values, for `run`."""
        return recording

    def run(self, opened: Any) -> F:
        """Return the force [N] as `force` does, on an opened recording."""
        return self.force(opened)


@dataclass(frozen=True)
class ModelSimulation(Simulation):
    """The free run of a model, as the estimator computes it; with other `values` it is changed from `identified`."""

    model: Model
    values: Mapping[str, float] = field(default_factory=dict, hash=False)
    identified: Model | None = None

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of a hydraulic model: its valves, oil, gas and friction."""
        return with_defaults(hydraulic_parameters(self.identified or self.model), self.values)

    def with_values(self, values: Mapping[str, float]) -> ModelSimulation:
        """Return the model with other values."""
        identified, changed = self.identified or self.model, {**self.values, **values}
        return ModelSimulation(change_hydraulic(identified, changed), changed, identified) if changed else self

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample."""
        return self.run(self.open(recording))

    def open(self, recording: Recording) -> OpenedRecording:
        """Return the ticks of the recording."""
        return open_recording(recording, self.model.sampling)

    def run(self, opened: OpenedRecording) -> F:
        """Return the force [N] at every position sample."""
        return run_opened(self.model, opened).force


@dataclass(frozen=True)
class FunctionSimulation(Simulation):
    """A function of time [s], position [m] and current [A], and of named `values`; errors mention `name`."""

    name: str
    function: ForceFunction
    values: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The numbers among the function's keyword-only arguments."""
        return declared_parameters(self.function, self.values)

    def with_values(self, values: Mapping[str, float]) -> FunctionSimulation:
        """Return the function with other values; those of whole numbers are passed as such."""
        whole = {p.name for p in self.parameters if p.whole}
        return replace(self, values={**self.values, **{n: int(v) if n in whole else v for n, v in values.items()}})

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample; raises CesError if the function or its values are invalid."""
        return self.run(self.open(recording))

    def open(self, recording: Recording) -> tuple[F, PositionSamples, int]:
        """Return the times [s] of the usable samples, the samples, and the number of all."""
        samples, logged = usable_samples(recording, 1e6), recording.channel("position")
        return (samples.stamps_ns - logged.stamps_ns[0]) * 1e-9, samples, len(logged)

    def run(self, opened: tuple[F, PositionSamples, int]) -> F:
        """Return the force [N] at every position sample."""
        time, samples, count = opened
        try:
            given = (values.copy() for values in (time, samples.position, samples.current))
            force = self.function(*given, **self.values)
            force = np.asarray(force, dtype=np.float64)
        except CesError:
            raise
        except (Exception, SystemExit) as error:
            called = "; it gets (time_s, position_m, current_A)" if isinstance(error, TypeError) else ""
            raise CesError(f"{self.name}: raised {type(error).__name__}: {error}{called}") from error
        if force.shape != time.shape:
            raise CesError(f"{self.name}: returned shape {force.shape}; expected {time.shape}, one for each sample")
        if not np.isfinite(force).all():
            bad = int(np.argmin(np.isfinite(force)))
            raise CesError(f"{self.name}: returned {force[bad]} at {time[bad]:.3f} s; expected finite forces")
        out = np.full(count, np.nan)
        out[samples.index] = force
        return out


@dataclass(frozen=True)
class RecordedSimulation(Simulation):
    """Predictions recorded in the bag itself, read as the signal `sim_force`."""

    topic: str

    def force(self, recording: Recording) -> F:
        """Return the recorded prediction [N] interpolated at every position sample."""
        if "sim_force" not in recording.channels:
            raise CesError(f"{recording.name}: no predictions on topic {self.topic}")
        return interpolate_force(recording, recording.channel("position").stamps_ns, TickLimits.MIN_GAP_S, "sim_force")


def find_predictions(simulation: Simulation) -> RecordedSimulation | None:
    """Return the recorded predictions inside a simulation, None if it computes its force."""
    inside = simulation.innermost
    return inside if isinstance(inside, RecordedSimulation) else None


def replace_force(recording: Recording, force: F) -> Recording:
    """Return the recording with a simulated force [N] (n,) at its position samples in place of the measured one."""
    channel = Channel("force", "N", recording.channel("position").stamps_ns, force)
    return replace(recording, channels={**recording.channels, "force": channel})


def function_simulation(spec: str) -> FunctionSimulation:
    """Return the simulation `module:function`; raises CesError if it cannot be imported."""
    module, _, name = spec.partition(":")
    try:
        function = getattr(import_module(module), name)
    except (Exception, SystemExit) as error:  # whatever the user's file does when it is imported
        what = str(error) if isinstance(error, ImportError | AttributeError) else f"{type(error).__name__}: {error}"
        raise CesError(
            f"{spec}: cannot be imported ({what}); expected module:function, here or on PYTHONPATH"
        ) from None
    if not callable(function):
        raise CesError(f"{spec}: is a {type(function).__name__}; expected function(time_s, position_m, current_A)")
    return FunctionSimulation(spec, function)
