"""An FMU as a simulation: `FILE.fmu` or `FILE.fmu:position=NAME,current=NAME,force=NAME` in, forces out.

FMPy reads and steps the FMU. Which of its variables are piston position, speed, valve current and damping force, the
user says, or their declared units and names do; an ambiguous choice raises an error that lists the variables.
"""

from __future__ import annotations

import math
import os
import re
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_data.arrays import F, I
from ces_data.recording import Recording
from ces_identify.prepare.sampling import longest_gap_s
from ces_identify.prepare.series import usable_samples
from ces_identify.simulations.simulation import Parameter, Simulation, with_defaults
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
    variables = _Variables(description, where)
    ports = {role: variables.choose(role, names.get(role)) for role in ROLES}
    force = ports.pop("force")
    inputs = {role: port for role, port in ports.items() if port is not None}
    if force is None:
        raise variables.unclear_error("no output that is the damping force; name it", "force")
    if not inputs.keys() & {"position", "speed"}:
        raise variables.unclear_error("no input that is the piston's position or speed; name it", "position")
    taken = {port.name for port in inputs.values()}
    may_be_current = any(v.name not in taken and variables.dimension(v) is None for v in variables.inputs)
    if "current" not in inputs and "current" not in names and may_be_current:
        raise variables.unclear_error(
            "no input that is the valve current; name it, or give current= if there is none", "current"
        )
    valid = (v for v in description.modelVariables if (v.name, v.type, v.causality) == (VALID, "Boolean", "output"))
    return Ports(inputs, force, next((int(v.valueReference) for v in valid), None))


class _Variables:
    """The real inputs and outputs of an FMU with their units."""

    def __init__(self, description: Any, where: str) -> None:
        self.where = where
        self.units = {unit.name: unit.baseUnit for unit in description.unitDefinitions}
        real = [v for v in description.modelVariables if v.type == "Real"]
        self.inputs = [v for v in real if v.causality == "input"]
        self.outputs = [v for v in real if v.causality == "output"]

    def choose(self, role: str, name: str | None) -> Port | None:
        """Return the port of a role; None if there is none."""
        kind, variables = ("output", self.outputs) if role == "force" else ("input", self.inputs)
        if name is not None:
            matches = [v for v in variables if v.name == name]
            if name and not matches:
                raise self.unclear_error(f"no real {kind} '{name}' for the {role}", role)
        else:
            named = [v for v in variables if _words(v.name) & WORDS[role]]
            matches = [v for v in variables if self.dimension(v) in DIMENSIONS[role]]
            matches = matches or [v for v in named if self.dimension(v) is None]
            if len(matches) > 1:
                matches = [v for v in matches if v in named] or matches
                matches = [v for v in matches if _words(v.name) <= WORDS[role]] or matches
        if len(matches) > 1:
            raise self.unclear_error(f"{' and '.join(v.name for v in matches)} may each be the {role}; name one", role)
        if not matches:
            return None
        base = self.units.get(_unit(matches[0]))
        factor, offset = (base.factor, base.offset) if base is not None else (1.0, 0.0)
        return Port(matches[0].name, int(matches[0].valueReference), float(factor), float(offset))

    def dimension(self, variable: Any) -> tuple[int, int, int, int] | None:
        """Return the exponents of kg, m, s and A in a variable's unit; None if it has none."""
        base = self.units.get(_unit(variable))
        return None if base is None else (base.kg, base.m, base.s, base.A)

    def unclear_error(self, what: str, role: str) -> CesError:
        """Return the error that asks the user for a name."""

        def listed(variables: Iterable[Any]) -> str:
            return ", ".join(f"{v.name} [{_unit(v) or '?'}]" for v in variables) or "none"

        asked = f"{self.where.rpartition('/')[2]}:{role}=NAME"
        return CesError(
            f"{self.where}: {what} ({asked}); inputs: {listed(self.inputs)}; outputs: {listed(self.outputs)}"
        )


def find_parameters(description: Any) -> tuple[tuple[Parameter, int], ...]:
    """Return the numbers of causality parameter in the FMU's own units, each with its value reference."""
    parameters = []
    for v in description.modelVariables:
        if v.causality == "parameter" and v.type in ("Real", "Integer") and v.variability in ("fixed", "tunable"):
            low, high = (float(end) if end is not None else inf for end, inf in ((v.min, -math.inf), (v.max, math.inf)))
            whole = v.type == "Integer"
            parameters.append(
                (Parameter(v.name, float(v.start or 0.0), low, high, _unit(v) or "", whole), int(v.valueReference))
            )
    return tuple(parameters)


def _unit(variable: Any) -> str | None:
    declared = variable.declaredType.unit if variable.declaredType is not None else None
    return variable.unit or declared


def _words(name: str) -> set[str]:
    """Return the words of the last part of a name: `damper.pistonForce_N` gives piston, force and n."""
    last = name.rpartition(".")[2]
    return {word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", last)}


def open_fmu(spec: str) -> FmuSimulation:
    """Return the simulation `FILE.fmu` or `FILE.fmu:position=NAME,speed=NAME,current=NAME,force=NAME`.

    The file is only read; `force` runs it. Raises CesError if FMPy is missing, if the file is no FMI 2.0 co-simulation
    with a binary for this platform, or if its variables are ambiguous.
    """
    match = SPEC.fullmatch(spec)
    if match is None:
        raise CesError(f"{spec}: expected FILE.fmu or FILE.fmu:position=NAME,current=NAME,force=NAME")
    path, names = match[1], read_names(match[2] or "", spec)
    description = _read_description(path)
    here, there = _import_fmpy().platform, _import_fmpy().supported_platforms(path)
    capabilities = description.coSimulation
    if description.fmiVersion != "2.0" or capabilities is None or here not in there:
        kind = "for model exchange only" if capabilities is None else "for co-simulation"
        has = ", ".join("sources" if platform == "c-code" else platform for platform in there) or "none"
        raise CesError(
            f"{path}: FMI {description.fmiVersion} {kind}, binaries: {has}; expected FMI 2.0 co-simulation with a "
            f"binary for {here}: compile or export it for this machine"
        )
    step_s = 0.0
    if not capabilities.canHandleVariableCommunicationStepSize:
        step_s = float(getattr(description.defaultExperiment, "stepSize", None) or 0.0)
        if not 0.0 < step_s < float("inf"):
            raise CesError(
                f"{path}: needs a fixed step but DefaultExperiment has no stepSize; export it again with one"
            )
    ports, interpolates = choose_ports(description, names, path), bool(capabilities.canInterpolateInputs)
    return FmuSimulation(path, ports, interpolates, step_s, find_parameters(description))


def _import_fmpy(part: str = "fmpy") -> Any:
    """Return FMPy or one of its modules; raises CesError if it is not installed."""
    try:
        return import_module(part)
    except ImportError:
        raise CesError("an FMU needs FMPy, which is not installed; pip install 'ces_observer[fmi]'") from None


def _read_description(path: str) -> Any:
    """Return FMPy's ModelDescription of an FMU; raises CesError if it cannot be read."""
    reader = _import_fmpy("fmpy.model_description")
    if not Path(path).is_file():
        raise CesError(f"{path}: no such file; expected a co-simulation FMU")
    try:
        return reader.read_model_description(path, validate=False)
    except zipfile.BadZipFile:
        raise CesError(f"{path}: not an FMU or damaged: not a zip file") from None
    except Exception as error:
        raise CesError(f"{path}: not an FMU or damaged: {_format_line(error)}") from None


def _format_line(error: Exception) -> str:
    return str(error).strip().replace("\n", " ") or type(error).__name__


@dataclass(frozen=True)
class FmuSimulation(Simulation):
    """An FMU with its `ports`; `step_s` is its fixed communication step [s], 0 if steps may vary.

    `declared` are its parameters with their value references; `values` replace some of their start values.
    """

    path: str
    ports: Ports
    interpolates: bool
    step_s: float
    declared: tuple[tuple[Parameter, int], ...] = ()
    values: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The variables of causality parameter."""
        return with_defaults([parameter for parameter, _ in self.declared], self.values)

    def with_values(self, values: Mapping[str, float]) -> FmuSimulation:
        """Return the FMU with other start values of some parameters."""
        return replace(self, values={**self.values, **values})

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample; NaN at unusable or late samples, and where it is not valid.

        Raises CesError if the FMU fails or returns a force that is not finite.
        """
        samples = usable_samples(recording, 1e6)
        time = (samples.stamps_ns - samples.stamps_ns[0]) * 1e-9
        force = np.full(len(recording.channel("position")), np.nan)
        with tempfile.TemporaryDirectory(prefix="ces_fmu_", ignore_cleanup_errors=sys.platform == "win32") as folder:
            try:
                _import_fmpy().extract(self.path, folder)
            except Exception as error:
                raise CesError(f"{self.path}: cannot be unpacked: {_format_line(error)}") from None
            description = _read_description(self.path)
            for part in split_at_gaps(samples.stamps_ns):
                signals = {"position": samples.position[part], "current": samples.current[part]}
                if "speed" in self.ports.inputs:
                    signals["speed"] = smooth_speed(time[part], samples.position[part])
                force[samples.index[part]] = self._run(description, folder, time[part], signals)
        return force

    def _run(self, description: Any, folder: str, time: F, signals: Mapping[str, F]) -> F:
        """Return the force [N] at the times of a stretch without a gap; `signals` (n,) by role."""
        points = time  # of communication [s]
        if self.step_s > 0.0 and len(time) > 1:
            count = int(np.ceil((time[-1] - time[0]) / self.step_s - 1e-9))
            if count > MAX_STEPS:
                raise CesError(f"{self.path}: {count} steps of {self.step_s:g} s; expected at most {MAX_STEPS}")
            points = np.asarray(time[0] + self.step_s * np.arange(count + 1))
        inputs = {role: (signals[role] - port.offset) / port.factor for role, port in self.ports.inputs.items()}
        columns = [np.interp(points, time, values) for values in inputs.values()]
        force = self._step_through(description, folder, points, np.stack(columns, axis=1))
        return force if points is time else np.asarray(np.interp(time, points, force))

    def _step_through(self, description: Any, folder: str, points: F, inputs: F) -> F:
        """Step a new instance over the points; inputs (points, variables) in the FMU's units, force in N."""
        messages: list[str] = []
        at = float(points[0])
        force = np.empty(len(points))
        with np.errstate(over="ignore"):  # an outlier
            slopes = (np.diff(inputs, axis=0) / np.diff(points)[:, None]).tolist()
        values, times = inputs.tolist(), points.tolist()
        references = [port.reference for port in self.ports.inputs.values()]
        orders = [1] * len(references)
        try:
            with _open_instance(description, folder, messages) as slave:
                for parameter, reference in self.declared:
                    if parameter.name in self.values:
                        value = self.values[parameter.name]
                        if parameter.whole:
                            slave.setInteger([reference], [int(value)])
                        else:
                            slave.setReal([reference], [value])
                slave.setupExperiment(startTime=at)
                slave.enterInitializationMode()
                slave.setReal(references, values[0])
                slave.exitInitializationMode()
                force[0] = self._read_force(slave)
                for k, at in enumerate(times[:-1]):
                    slave.setReal(references, values[k] if self.interpolates else values[k + 1])
                    if self.interpolates:
                        slave.setRealInputDerivatives(references, orders, slopes[k])
                    slave.doStep(at, times[k + 1] - at)
                    force[k + 1] = self._read_force(slave)
        except CesError:
            raise
        except Exception as error:
            reason = " ".join([str(error), *messages[-1:]]).replace("\n", " ")
            raise CesError(f"{self.path}: the FMU failed at {at:.6f} s: {reason}") from error
        invalid = np.isinf(force) if self.ports.valid is not None else ~np.isfinite(force)
        if invalid.any():
            bad = int(np.argmax(invalid))
            raise CesError(f"{self.path}: returned {force[bad]} N at {points[bad]:.3f} s; expected finite forces")
        return force

    def _read_force(self, slave: Any) -> float:
        """Return the force [N]; NaN if the FMU marks it as not valid."""
        if self.ports.valid is not None and not slave.getBoolean([self.ports.valid])[0]:
            return float("nan")
        return self.ports.force.factor * float(slave.getReal([self.ports.force.reference])[0]) + self.ports.force.offset


@contextmanager
def _open_instance(description: Any, folder: str, errors: list[str]) -> Iterator[Any]:
    """Load the library and yield an instance; its error messages are appended to `errors`."""
    fmi2, here = _import_fmpy("fmpy.fmi2"), Path.cwd()

    def log(_: object, name: bytes, status: int, category: bytes, message: bytes) -> None:
        if status > fmi2.fmi2Warning:
            errors.append((message or b"").decode("utf-8", "replace"))

    callbacks = fmi2.fmi2CallbackFunctions()
    callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(log)
    callbacks.allocateMemory = fmi2.defaultCallbacks.allocateMemory
    callbacks.freeMemory = fmi2.defaultCallbacks.freeMemory
    try:
        names = {"modelIdentifier": description.coSimulation.modelIdentifier, "instanceName": "ces_observer"}
        slave = fmi2.FMU2Slave(guid=description.guid, unzipDirectory=folder, **names)
    finally:
        os.chdir(here)  # FMPy does not restore the working folder if loading fails
    slave.instantiate(callbacks=callbacks)
    try:
        yield slave
        slave.terminate()
    finally:
        with suppress(Exception):
            slave.freeInstance()


def split_at_gaps(stamps_ns: I) -> list[I]:
    """Return the indices of the samples of each stretch without a gap, in order, without late samples."""
    steps = np.abs(np.diff(stamps_ns))
    gap_ns = 1e9 * longest_gap_s(1e9 / max(float(np.median(steps)), 1.0)) if len(steps) else 0.0
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
