"""`augmented.json`: writing and reading an `AugmentedSimulation`.

The file names the diagnosed simulation with its hash; everything else in it is numbers. Effects of the user and
simulations that are a `module:function` or an FMU are code: reading the file runs them.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

from ces_gap.augmented.augmented_simulation import AugmentedSimulation
from ces_gap.augmented.simulation_spec import file_of, make_spec_relative, resolve_spec
from ces_gap.baseline.correction import LearnedCorrection
from ces_gap.baseline.surrogate import Surrogate
from ces_gap.effects.effect import Composition, Effect, Setting
from ces_gap.effects.user_effects import class_of, library_effect, user_effect
from ces_gap.errors import GapError
from ces_identify.simulations.simulation import Simulation
from ces_observer import __version__
from ces_observer.errors import ModelError
from ces_observer.json_checks import JsonObject, write_atomically

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
