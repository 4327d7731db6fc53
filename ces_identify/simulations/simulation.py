"""The interface of all simulations of the damper, and those by models, Python functions and recorded predictions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ces_data.arrays import F
from ces_data.recording import Channel, Recording
from ces_identify.limits import TickLimits
from ces_identify.prepare.series import PositionSamples, interpolate_force, usable_samples
from ces_identify.simulations.parameters import (
    Parameter,
    change_hydraulic,
    declared_parameters,
    hydraulic_parameters,
    with_defaults,
)
from ces_identify.simulations.simulate import OpenedRecording, open_recording, run_opened
from ces_observer.errors import CesError
from ces_observer.model import Model

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
