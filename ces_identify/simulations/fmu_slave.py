"""Run an FMU's library with FMPy: unpack it, create an instance, set and read its variables."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from ces_identify.simulations.fmu_ports import Ports
from ces_observer.errors import CesError


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
