"""`augmented.json`: a simulation with the correction and the effects that a diagnosis has found, again a simulation.

It names the original simulation as on the command line, with file paths relative to its own folder.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from ces_data.arrays import F
from ces_data.recording import Recording
from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.baseline.plant import Correction, DirectSimulator, Plant, TraceSimulator
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.effects.effect import Composition, Effect, Setting
from ces_gap.effects.user_effects import class_of, library_effect, user_effect
from ces_gap.errors import GapError
from ces_gap.trace import Trace, make_trace, smooth_recording
from ces_identify.simulations.fmu import SPEC
from ces_identify.simulations.simulation import Simulation, find_predictions
from ces_observer import __version__
from ces_observer.errors import CesError, ModelError
from ces_observer.json_text import JsonObject, write_atomically

FILES = (".json", ".yaml", ".yml")


def file_of(spec: str) -> Path | None:
    """Return the file of a simulation; None for `topic:/name` and `module:function`."""
    path = _split(spec)[0]
    return None if path is None else Path(path)


def make_spec_relative(spec: str, folder: Path) -> str:
    """Return `spec` for a file in `folder`: its path relative to the folder where that is possible."""
    path, rest = _split(spec)
    if path is None:
        return spec
    try:
        return Path(os.path.relpath(Path(path).resolve(), folder.resolve())).as_posix() + rest
    except ValueError:  # another drive
        return str(Path(path).resolve()) + rest


def resolve_spec(spec: str, folder: Path) -> str:
    """Return a `spec` that is relative to `folder` as seen from the working directory."""
    path, rest = _split(spec)
    return spec if path is None else str(folder / path) + rest


def _split(spec: str) -> tuple[str | None, str]:
    """Return the path in `spec`, None if it has none, and the rest."""
    if spec.startswith("topic:"):
        return None, spec
    fmu = SPEC.fullmatch(spec)
    if fmu is not None:
        return fmu[1], spec[len(fmu[1]) :]
    return (spec, "") if Path(spec).suffix.lower() in FILES else (None, spec)


@dataclass(frozen=True)
class AugmentedSimulation(Simulation):
    """A simulation with a correction and effects; `surrogate` replaces one that cannot be run again."""

    name: str
    simulation: Simulation
    composition: Composition
    correction: Correction | None = None
    surrogate: TraceSimulator | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)

    @property
    def innermost(self) -> Simulation:
        """The simulation without any effects and corrections."""
        return self.simulation.innermost

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample (n,), NaN where the simulation has none.

        As in the diagnosis, the simulation runs on the smoothed position, if it can be run. The added force is computed
        on the grid of the trace and interpolated, so that the simulation's own force keeps its detail.
        """
        if not self.composition.settings and self.correction is None:
            return self.simulation.force(recording)
        if find_predictions(self.simulation) is None:
            recording = smooth_recording(recording, make_trace(recording, np.zeros(len(recording.channel("position")))))
        own = self.simulation.force(recording)
        trace = make_trace(recording, own)
        plant = Plant(self.surrogate or DirectSimulator(self.simulation), self.correction)
        added = self._apply_effects(plant, trace) - trace.simulated
        stamps = recording.channel("position").stamps_ns
        return np.asarray(own + np.interp((stamps - stamps[0]) * 1e-9, trace.time_s, added))

    def _apply_effects(self, plant: Plant, trace: Trace) -> F:
        try:
            force = plant.with_effects(self.composition, trace)
        except CesError:
            raise
        except Exception as error:  # inconsistent numbers in a file, or an effect of the user
            text = f"{type(error).__name__}: {' '.join(str(error).split())}"
            raise GapError(f"{self.name}: cannot be run: {text}; run `ces diagnose` again") from error
        if not np.isfinite(force).all():
            bad = float(trace.time_s[np.argmin(np.isfinite(force))])
            raise GapError(f"{self.name}: the force is not finite at {bad:.3f} s; run `ces diagnose` again")
        return force


Opener = Callable[[str], Simulation]
LearnedPart = TypeVar("LearnedPart", LearnedCorrection, Surrogate)

SCHEMA = "ces-augmented/1"
MAX_BYTES = 4_000_000
MAX_EFFECTS = 20


class JsonWritable(Protocol):
    """A learnt part that can be written as JSON."""

    def as_json(self) -> dict[str, Any]:
        """Return plain values."""


def save_augmented(
    path: Path,
    spec: str,
    composition: Composition,
    correction: JsonWritable | None = None,
    surrogate: JsonWritable | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write the file atomically; `spec` names the simulation. Raises CesError if it cannot be written."""
    sim = name_simulation(spec, path.parent)
    write_atomically(path, augmented_text(sim, composition, correction, surrogate, provenance))


def name_simulation(spec: str, folder: Path) -> dict[str, str | None]:
    """Return the entry `sim` of a file in `folder`: the simulation `spec` relative to it, and its hash."""
    return {"spec": make_spec_relative(spec, folder), "sha256": _digest(spec)}


def augmented_text(
    sim: Mapping[str, str | None],
    composition: Composition,
    correction: JsonWritable | None = None,
    surrogate: JsonWritable | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of the file; `sim` comes from `name_simulation`."""
    document = {
        "schema": SCHEMA,
        "sim": dict(sim),
        "correction": None if correction is None else correction.as_json(),
        "surrogate": None if surrogate is None else surrogate.as_json(),
        "effects": [_effect_as_json(setting) for setting in composition.settings],
        "provenance": {"tool": f"ces_observer {__version__}", **(provenance or {})},
    }
    return json.dumps(document, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def is_augmented(path: Path) -> bool:
    """True if the file is JSON of at most `MAX_BYTES` with the schema of an augmented simulation."""
    try:
        if path.stat().st_size > MAX_BYTES:
            return False
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, Mapping) and str(document.get("schema", "")).startswith("ces-augmented/")


def load_augmented(path: Path, open_simulation: Opener) -> AugmentedSimulation:
    """Read and check the file; `open_simulation` opens the simulation that it names. Raises CesError."""
    root = JsonObject(_document(path), str(path))
    schema = root.text("schema")
    if schema != SCHEMA:
        raise GapError(f"{path}: schema is '{schema}'; expected '{SCHEMA}'; run `ces diagnose` again")
    settings = tuple(_read_setting(node) for node in root.items("effects", 0, MAX_EFFECTS))
    correction = _read_learned_part(root, "correction", LearnedCorrection)
    surrogate = _read_learned_part(root, "surrogate", Surrogate)
    spec = resolve_spec(root.at("sim").text("spec"), path.parent)
    _require_same(path, spec, root.at("sim"))
    simulation, provenance = open_simulation(spec), root.at("provenance").value
    return AugmentedSimulation(str(path), simulation, Composition(settings), correction, surrogate, provenance)


def _document(path: Path) -> Any:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise GapError(f"{path}: {size} bytes; expected at most {MAX_BYTES} for an augmented simulation")
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
    except OSError as error:
        raise GapError(f"{path}: cannot be read: {error.strerror}; `ces diagnose` writes one") from None
    except (ValueError, RecursionError) as error:
        raise GapError(f"{path}: not a JSON file: {error}") from None


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} found; expected finite numbers")


def _effect_as_json(setting: Setting) -> dict[str, Any]:
    effect, user_class = setting.effect, class_of(setting.effect)
    code = {} if user_class is None else {"class": user_class}
    return {"effect": effect.name, "form": effect.form, **code, "parameters": setting.values_by_name()}


def _read_setting(node: JsonObject) -> Setting:
    name, form = node.text("effect"), node.text("form")
    try:
        effect = user_effect(node.text("class")) if "class" in node.value else library_effect(name, form)
    except ModelError:
        raise
    except GapError as error:
        raise GapError(f"{node.where}: {error}") from None
    if (effect.name, effect.form) != (name, form):
        raise GapError(
            f"{node.where}: class is {effect.name} ({effect.form}); expected {name} ({form}); run `ces diagnose` again"
        )
    return Setting(effect, _read_values(node.at("parameters"), effect))


def _read_values(node: JsonObject, effect: Effect) -> tuple[float, ...]:
    """Return the parameter values, each within its bounds apart from rounding."""
    unknown = set(node.value) - {p.name for p in effect.parameters}
    if unknown:
        expected = ", ".join(p.name for p in effect.parameters)
        raise GapError(f"{node.where}: unknown parameters {', '.join(sorted(unknown))}; expected {expected}")
    slack = [1e-9 * (abs(p.low) + abs(p.high)) for p in effect.parameters]
    return tuple(
        min(max(node.number(p.name, p.low - s, p.high + s), p.low), p.high)
        for p, s in zip(effect.parameters, slack, strict=True)
    )


def _read_learned_part(root: JsonObject, name: str, kind: type[LearnedPart]) -> LearnedPart | None:
    """Return the learnt part `name`, None if it is null."""
    document = root.mapping_or_none(name)
    if document is None:
        return None
    try:
        return kind.from_json(dict(document))
    except (ModelError, KeyError, TypeError, ValueError, IndexError) as error:
        text = f"{type(error).__name__}: {error}; expected the output of `ces diagnose`; run it again"
        raise GapError(f"{root.where}: {name}: {text}") from None


def _digest(spec: str) -> str | None:
    file = file_of(spec)
    return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()


def _require_same(path: Path, spec: str, node: JsonObject) -> None:
    """Raise GapError if the file of the simulation is missing or has changed; this excludes circular references."""
    file = file_of(spec)
    if file is None:
        return
    if not file.is_file():
        raise GapError(f"{path}: its simulation {file} is missing; restore it or run `ces diagnose` again")
    if hashlib.sha256(file.read_bytes()).hexdigest() != node.text("sha256"):
        raise GapError(f"{path}: its simulation {file} has changed since; run `ces diagnose` again")
