"""The common request of a fleet's diagnoses, and a key for each result that identifies its inputs.

The request is sent to the workers as bytes, with the user's simulation and effects by value: workers do not need the
user's modules.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ces_gap.augmented.augmented_file import name_simulation
from ces_gap.augmented.simulation_spec import file_of
from ces_gap.diagnosis import Diagnosis
from ces_gap.effects.user_effects import class_of
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import FunctionSimulation, Simulation
from ces_observer import __version__

if TYPE_CHECKING:
    from ces_gap.pipeline import DiagnoseOptions

UNITS = "units"
OURS = ("ces_observer", "ces_identify", "ces_gap", "ces_rig", "ces_cli")

Diagnose = Callable[..., Diagnosis]
Files = Callable[..., Mapping[str, str]]


@dataclass(frozen=True)
class DiagnosisRequest:
    """The common part of all jobs: simulation, references and options.

    `diagnose` and `files` are `ces_gap.pipeline.diagnose` and `ces_gap.report.result_files.result_files`, or
    replacements of them.
    """

    simulation: Simulation
    spec: str
    reference: tuple[Recording, ...]
    options: DiagnoseOptions
    diagnose: Diagnose
    files: Files

    def pack(self) -> bytes:
        """Return the request as bytes that a worker unpacks without the user's modules."""
        cloudpickle = _cloudpickle()
        with contextlib.ExitStack() as stack:
            for module in self._user_modules():
                cloudpickle.register_pickle_by_value(module)
                stack.callback(cloudpickle.unregister_pickle_by_value, module)
            packed: bytes = cloudpickle.dumps(self)
            return packed

    def digest(self) -> str:
        """Return a hash of everything that determines the results; `threads` does not."""
        inputs = {
            "tool": __version__,
            "sim": [self.spec, _file_digest(file_of(self.spec))],
            "code": sorted(_code_digest(module) for module in self._user_modules()),
            "effects": sorted(filter(None, map(class_of, self.options.effects))),
            "seed": self.options.seed,
            "tolerance": self.options.tolerance,
            "reference": [r.sha256 for r in self.reference],
        }
        return hashlib.sha256(json.dumps(inputs).encode()).hexdigest()

    def _user_modules(self) -> list[Any]:
        """Return the modules with code of the user."""
        names = {type(effect).__module__ for effect in self.options.effects}
        if isinstance(self.simulation, FunctionSimulation):
            names.add(str(getattr(self.simulation.function, "__module__", "")))
        return [sys.modules[n] for n in sorted(names) if n in sys.modules and n.partition(".")[0] not in OURS]


@dataclass(frozen=True)
class DiagnosisJob:
    """One unit to diagnose: its name, the key of its result, and the folder of its files in the results folder.

    `sim` names the simulation relative to that folder: workers may have no access to its file.
    """

    key: str
    name: str
    output: str
    sim: Mapping[str, str | None] = field(compare=False)

    @property
    def identity(self) -> dict[str, Any]:
        """The columns that identify the unit of a row."""
        return {"key": self.key, "name": self.name}


def job_of(
    name: str, recordings: Sequence[Recording], request: DiagnosisRequest, signal_settings: str, folder: Path
) -> DiagnosisJob:
    """Return the job of a unit with files below `folder`; `signal_settings` describes how recordings were read."""
    inputs = [request.digest(), signal_settings, [r.sha256 for r in recordings]]
    key = hashlib.sha256(json.dumps(inputs).encode()).hexdigest()[:20]
    output = f"{UNITS}/{name}-{key[:8]}"
    return DiagnosisJob(key, name, output, name_simulation(request.spec, folder / output))


def _cloudpickle() -> Any:
    """Return cloudpickle: its own package, or the copy inside joblib before version 1.6."""
    try:
        return import_module("cloudpickle")
    except ImportError:
        return import_module("joblib.externals.cloudpickle")


def _file_digest(file: Path | None) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest() if file is not None and file.is_file() else ""


def _code_digest(module: Any) -> str:
    return _file_digest(Path(inspect.getsourcefile(module) or ""))
