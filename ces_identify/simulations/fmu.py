"""The variables of an FMU that are piston position, speed, valve current and damping force, and their units.

FMPy's model description and the user's names go in; `Ports` come out. Variables without a name from the user are found
by declared unit, then by name; an ambiguous choice raises an error that lists the variables.
"""

from __future__ import annotations

import ctypes
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F, I
from ces_data.recording import Recording
from ces_identify.prepare.series import usable_samples
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError

SPEC = re.compile(r"(.+\.fmu)(?::(.*))?", re.IGNORECASE | re.DOTALL)  # FILE.fmu:names
INPUTS = ("position", "speed", "current")
ROLES = (*INPUTS, "force")
WORDS = {
    "position": {"position", "pos", "x", "z", "stroke", "displacement", "disp", "travel"},
    "speed": {"speed", "velocity", "vel", "v"},
    "current": {"current", "cur", "i", "voltage"},
    "force": {"force", "f"},
}
DIMENSIONS = {  # exponents of kg, m, s, A; a valve may be driven by a voltage, which then replaces the current
    "position": {(0, 1, 0, 0)},
    "speed": {(0, 1, -1, 0)},
    "current": {(0, 0, 0, 1), (1, 2, -3, -1)},
    "force": {(1, 1, -2, 0)},
}
VALID = "valid"  # name of a Boolean output: the force may be used
GAP_S, GAP_INTERVALS = 0.05, 10.0  # a gap is longer than both, as in `ces_identify.prepare.sampling`
SMOOTHING_HZ = 70.0  # [Hz] zero-phase low-pass for the speed: above the stroke, below the noise of the position
MAX_STEPS = 50_000_000


@dataclass(frozen=True)
class Port:
    """A real variable of the FMU: SI value = `factor` · its value + `offset`."""

    name: str
    reference: int
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Ports:
    """The input variables (some of position, speed, current) and the force; `valid` is a value reference, if any."""

    inputs: Mapping[str, Port]
    force: Port
    valid: int | None = None


def read_names(text: str, where: str) -> dict[str, str]:
    """Read `position=x,current=i,force=F` (any of them); an empty name means no such variable. Raises CesError."""
    names: dict[str, str] = {}
    for part in filter(None, re.split(r",(?=\w+=)", text)):
        role, equals, name = part.partition("=")
        if role not in ROLES or not equals or role in names:
            raise CesError(f"{where}: '{part}'; expected each of {', '.join(ROLES)} at most once, as position=NAME")
        names[role] = name
    return names


def choose_ports(description: Any, names: Mapping[str, str], where: str) -> Ports:
    """Return the variables that `names` gives or, for the other roles, that units and names identify.

    `description` is FMPy's ModelDescription. Raises CesError, naming `where` and listing the variables, if a variable
    is missing or ambiguous, without a force, or with neither position nor speed.
    """
    chooser = _Chooser(description, where)
    ports = {role: chooser.choose(role, names.get(role)) for role in ROLES}
    force = ports.pop("force")
    inputs = {role: port for role, port in ports.items() if port is not None}
    if force is None:
        raise chooser.unclear_error("no output that is the damping force; name it", "force")
    if not inputs.keys() & {"position", "speed"}:
        raise chooser.unclear_error("no input that is the piston's position or speed; name it", "position")
    if "current" not in inputs and "current" not in names and chooser.has_other_inputs(inputs):
        raise chooser.unclear_error(
            "no input that is the valve current; name it, or give current= if there is none", "current"
        )
    return Ports(inputs, force, chooser.find_valid())


class _Chooser:
    def __init__(self, description: Any, where: str) -> None:
        self.where = where
        self.units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
        self.variables = list(description.modelVariables)
        self.inputs = [v for v in self.variables if v.causality == "input" and v.type == "Real"]
        self.outputs = [v for v in self.variables if v.causality == "output" and v.type == "Real"]

    def choose(self, role: str, name: str | None) -> Port | None:
        """Return the port of a role; None if there is none."""
        variables = self.outputs if role == "force" else self.inputs
        if name == "":
            return None
        if name is not None:
            return self._find_by_name(role, name, variables)
        matches = [v for v in variables if self._dimension(v) in DIMENSIONS[role]]
        if not matches:
            matches = [v for v in variables if self._dimension(v) is None and _words(v.name) & WORDS[role]]
        if len(matches) > 1:
            matches = [v for v in matches if _words(v.name) & WORDS[role]] or matches
        if len(matches) > 1:
            raise self.unclear_error(f"{' and '.join(v.name for v in matches)} may each be the {role}; name one", role)
        return self._port(matches[0]) if matches else None

    def has_other_inputs(self, inputs: Mapping[str, Port]) -> bool:
        """Return whether any other real input could be a current."""
        taken = {port.name for port in inputs.values()}
        return any(v.name not in taken and self._dimension(v) is None for v in self.inputs)

    def find_valid(self) -> int | None:
        """Return the value reference of the Boolean output VALID, None if there is none."""
        valid = (v for v in self.variables if (v.name, v.type, v.causality) == (VALID, "Boolean", "output"))
        return next((int(v.valueReference) for v in valid), None)

    def unclear_error(self, what: str, role: str) -> CesError:
        """Return the error that asks the user for a name."""
        path = self.where.rpartition("/")[2]
        return CesError(
            f"{self.where}: {what} ({path}:{role}=NAME); inputs: {self._list(self.inputs)}; "
            f"outputs: {self._list(self.outputs)}"
        )

    def _find_by_name(self, role: str, name: str, variables: Sequence[Any]) -> Port:
        for variable in variables:
            if variable.name == name:
                return self._port(variable)
        raise self.unclear_error(f"no real {'output' if role == 'force' else 'input'} '{name}' for the {role}", role)

    def _port(self, variable: Any) -> Port:
        base = self.units.get(_unit(variable))
        factor, offset = (base.factor, base.offset) if base is not None else (1.0, 0.0)
        return Port(variable.name, int(variable.valueReference), float(factor), float(offset))

    def _dimension(self, variable: Any) -> tuple[int, int, int, int] | None:
        base = self.units.get(_unit(variable))
        return None if base is None else (base.kg, base.m, base.s, base.A)

    def _list(self, variables: Iterable[Any]) -> str:
        return ", ".join(f"{v.name} [{_unit(v) or '?'}]" for v in variables) or "none"


def _unit(variable: Any) -> str | None:
    declared = variable.declaredType.unit if variable.declaredType is not None else None
    return variable.unit or declared


def _words(name: str) -> set[str]:
    """Return the words of the last part of a name: `damper.pistonForce_N` gives piston, force and n."""
    last = name.rpartition(".")[2]
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", last)}


def import_fmpy(part: str = "fmpy") -> Any:
    """Return FMPy or one of its modules; raises CesError if it is not installed."""
    try:
        return import_module(part)
    except ImportError:
        raise CesError("an FMU needs FMPy, which is not installed; pip install 'ces_observer[fmi]'") from None


def read_description(path: str) -> Any:
    """Return FMPy's ModelDescription of an FMU; raises CesError if it cannot be read."""
    reader = import_fmpy("fmpy.model_description")
    if not Path(path).is_file():
        raise CesError(f"{path}: no such file; expected a co-simulation FMU")
    try:
        return reader.read_model_description(path, validate=False)
    except zipfile.BadZipFile:
        raise CesError(f"{path}: not an FMU or damaged: not a zip file") from None
    except Exception as error:
        raise CesError(f"{path}: not an FMU or damaged: {_format_line(error)}") from None


@contextmanager
def extract_fmu(path: str) -> Iterator[tuple[Any, str]]:
    """Unzip the FMU into a temporary folder; yield its description and the folder, which is removed afterwards."""
    with tempfile.TemporaryDirectory(prefix="ces_fmu_", ignore_cleanup_errors=sys.platform == "win32") as folder:
        try:
            import_fmpy().extract(path, folder)
        except Exception as error:
            raise CesError(f"{path}: cannot be unpacked: {_format_line(error)}") from None
        yield read_description(path), folder


@contextmanager
def open_instance(description: Any, folder: str, errors: list[str]) -> Iterator[Any]:
    """Load the library and yield an instance; its error messages are appended to `errors`."""
    fmi2, here = import_fmpy("fmpy.fmi2"), Path.cwd()
    try:
        slave = fmi2.FMU2Slave(
            guid=description.guid,
            modelIdentifier=description.coSimulation.modelIdentifier,
            unzipDirectory=folder,
            instanceName="ces_observer",
        )
    finally:
        os.chdir(here)  # FMPy does not restore the working folder if loading fails
    slave.instantiate(callbacks=_callbacks(fmi2, errors))
    try:
        yield slave
        slave.terminate()
    finally:
        with suppress(Exception):
            slave.freeInstance()


def _callbacks(fmi2: Any, errors: list[str]) -> Any:
    def log(_: object, name: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > fmi2.fmi2Warning:
            errors.append((message or b"").decode("utf-8", "replace"))

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    return callbacks


class FmuVariables:
    """The input and output variables of an FMPy slave, in preallocated arrays: a step only calls C."""

    def __init__(self, slave: Any, ports: Ports) -> None:
        self.slave, self.ports = slave, ports
        self.count = len(ports.inputs)
        self.references = (ctypes.c_uint * self.count)(*(port.reference for port in ports.inputs.values()))
        self.values, self.slopes = (ctypes.c_double * self.count)(), (ctypes.c_double * self.count)()
        self.orders = (ctypes.c_int * self.count)(*[1] * self.count)
        self.force_reference, self.force_value = (ctypes.c_uint * 1)(ports.force.reference), (ctypes.c_double * 1)()
        self.valid_reference, self.valid_value = (ctypes.c_uint * 1)(ports.valid or 0), (ctypes.c_int * 1)()

    def start(self, at_s: float, inputs: list[Any]) -> None:
        """Initialise at a time; inputs are in the FMU's units, in the order of the ports."""
        self.slave.setupExperiment(startTime=at_s)
        self.slave.enterInitializationMode()
        self._set_inputs(inputs)
        self.slave.exitInitializationMode()

    def step(self, at_s: float, length_s: float, inputs: list[Any], slopes: list[Any] | None = None) -> None:
        """Do a step with constant inputs, or with inputs at its beginning and their derivatives [1/s]."""
        self._set_inputs(inputs)
        if slopes:
            self.slopes[:] = slopes
            self.slave.fmi2SetRealInputDerivatives(
                self.slave.component, self.references, self.count, self.orders, self.slopes
            )
        self.slave.fmi2DoStep(self.slave.component, at_s, length_s, 1)

    def force(self) -> float:
        """Return the force [N]; NaN if the FMU marks it as not valid."""
        if self.ports.valid is not None:
            self.slave.fmi2GetBoolean(self.slave.component, self.valid_reference, 1, self.valid_value)
            if not self.valid_value[0]:
                return float("nan")
        self.slave.fmi2GetReal(self.slave.component, self.force_reference, 1, self.force_value)
        return self.ports.force.factor * float(self.force_value[0]) + self.ports.force.offset

    def _set_inputs(self, inputs: list[Any]) -> None:
        self.values[:] = inputs
        self.slave.fmi2SetReal(self.slave.component, self.references, self.count, self.values)


def _format_line(error: Exception) -> str:
    return str(error).strip().replace("\n", " ") or type(error).__name__


@dataclass(frozen=True)
class FmuSimulation(Simulation):
    """An FMU with its `ports`; `step_s` is its fixed communication step [s], 0 if steps may vary."""

    path: str
    ports: Ports
    interpolates: bool
    step_s: float

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample; NaN at unusable or late samples, and where it is not valid.

        Raises CesError if the FMU fails or returns a force that is not finite.
        """
        samples = usable_samples(recording, 1e6)
        time = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
        force = np.full(len(recording.channel("position")), np.nan)
        with extract_fmu(self.path) as (description, folder):
            for part in split_at_gaps(samples.stamps_ns):
                inputs = self._inputs(time[part], samples.position[part], samples.current[part])
                force[samples.index[part]] = self._run(description, folder, time[part], inputs)
        return force

    def _inputs(self, time: F, position: F, current: F) -> dict[str, F]:
        """Return the FMU's inputs by role, in its own units."""
        signals = {"position": position, "current": current}
        if "speed" in self.ports.inputs:
            signals["speed"] = smooth_speed(time, position)
        return {role: (signals[role] - port.offset) / port.factor for role, port in self.ports.inputs.items()}

    def _run(self, description: Any, folder: str, time: F, inputs: Mapping[str, F]) -> F:
        """Return the force [N] at the times of a stretch without a gap."""
        points = self._points(time)
        columns = [np.interp(points, time, inputs[role]) for role in self.ports.inputs]
        force = self._step_through(description, folder, points, np.stack(columns, axis=1))
        return force if points is time else np.asarray(np.interp(time, points, force))

    def _points(self, time: F) -> F:
        """Return the communication points [s]."""
        if self.step_s == 0.0 or len(time) < 2:
            return time
        count = int(np.ceil((time[-1] - time[0]) / self.step_s - 1e-9))
        if count > MAX_STEPS:
            raise CesError(f"{self.path}: {count} steps of {self.step_s:g} s; expected at most {MAX_STEPS}")
        return np.asarray(time[0] + self.step_s * np.arange(count + 1))

    def _step_through(self, description: Any, folder: str, points: F, inputs: F) -> F:
        """Step a new instance over the points; inputs (points, variables) in the FMU's units, force in N."""
        messages: list[str] = []
        at = float(points[0])
        force = np.empty(len(points))
        with np.errstate(over="ignore"):  # an outlier
            slopes = (np.diff(inputs, axis=0) / np.diff(points)[:, None]).tolist()
        values, times = inputs.tolist(), points.tolist()
        try:
            with open_instance(description, folder, messages) as slave:
                variables = FmuVariables(slave, self.ports)
                variables.start(at, values[0])
                force[0] = variables.force()
                for k, at in enumerate(times[:-1]):
                    now = (values[k], slopes[k]) if self.interpolates else (values[k + 1],)
                    variables.step(at, times[k + 1] - at, *now)
                    force[k + 1] = variables.force()
        except CesError:
            raise
        except Exception as error:
            reason = " ".join([str(error), *messages[-1:]]).replace("\n", " ")
            raise CesError(f"{self.path}: the FMU failed at {at:.6f} s: {reason}") from None
        invalid = np.isinf(force) if self.ports.valid is not None else ~np.isfinite(force)
        if invalid.any():
            bad = int(np.argmax(invalid))
            raise CesError(f"{self.path}: returned {force[bad]} N at {points[bad]:.3f} s; expected finite forces")
        return force


def open_fmu(spec: str) -> FmuSimulation:
    """Return the simulation `FILE.fmu` or `FILE.fmu:position=NAME,speed=NAME,current=NAME,force=NAME`.

    The file is only read; `force` runs it. Raises CesError if FMPy is missing, if the file is no FMI 2.0 co-simulation
    with a binary for this platform, or if its variables are ambiguous.
    """
    match = SPEC.fullmatch(spec)
    if match is None:
        raise CesError(f"{spec}: expected FILE.fmu or FILE.fmu:position=NAME,current=NAME,force=NAME")
    path, names = match[1], read_names(match[2] or "", spec)
    description = read_description(path)
    _require_runnable(path, description)
    capabilities = description.coSimulation
    return FmuSimulation(
        path,
        choose_ports(description, names, path),
        bool(capabilities.canInterpolateInputs),
        0.0 if capabilities.canHandleVariableCommunicationStepSize else _fixed_step(path, description),
    )


def split_at_gaps(stamps_ns: I) -> list[I]:
    """Return the indices of the samples of each stretch without a gap, in order, without late samples."""
    steps = np.abs(np.diff(stamps_ns))
    gap_ns = max(GAP_S * 1e9, GAP_INTERVALS * float(np.median(steps))) if len(steps) else 0.0
    parts = np.split(np.arange(len(stamps_ns)), np.flatnonzero(steps > gap_ns) + 1)
    latest = [np.maximum.accumulate(stamps_ns[part]) for part in parts]
    return [part[np.diff(so_far, prepend=so_far[:1] - 1) > 0] for part, so_far in zip(parts, latest, strict=True)]


def smooth_speed(time: F, position: F) -> F:
    """Return the smoothed speed (n,) [m/s], without delay, from positions [m] at increasing times [s]."""
    if len(time) < 3:
        return np.zeros(len(time))
    even = np.linspace(time[0], time[-1], len(time))
    rate = 1.0 / (even[1] - even[0])
    sos = butter(4, min(SMOOTHING_HZ, 0.2 * rate), fs=rate, output="sos")
    pad = min(len(time) - 1, round(0.2 * rate))
    smooth = sosfiltfilt(sos, np.interp(even, time, position), padlen=pad)
    return np.asarray(np.interp(time, even, np.gradient(smooth, even)))


def _require_runnable(path: str, description: Any) -> None:
    """Raise CesError unless this is FMI 2.0 co-simulation with a binary for this machine."""
    if description.fmiVersion != "2.0":
        raise CesError(f"{path}: FMI {description.fmiVersion}; expected FMI 2.0; export it again")
    if description.coSimulation is None:
        raise CesError(f"{path}: for model exchange only; expected co-simulation; export it again with its solver")
    here, there = import_fmpy().platform, import_fmpy().supported_platforms(path)
    if here not in there:
        has = ", ".join("sources" if platform == "c-code" else platform for platform in there) or "none"
        raise CesError(f"{path}: no binary for {here}; it has: {has}; compile or export it for this machine")


def _fixed_step(path: str, description: Any) -> float:
    experiment = description.defaultExperiment
    step = float(experiment.stepSize or 0.0) if experiment is not None else 0.0
    if not 0.0 < step < float("inf"):
        raise CesError(f"{path}: needs a fixed step but DefaultExperiment has no stepSize; export it again with one")
    return step
