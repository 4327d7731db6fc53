"""`augmented.json`: an `AugmentedSimulation` written down and read again.

The file names the simulation, which must be the one that was diagnosed (its hash is checked), and holds numbers
otherwise. Effects of the user's own and simulations given as `module:function` or FMU are code, and are run.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

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
    """What was learnt from recordings and can be written down."""

    def as_json(self) -> dict[str, Any]:
        """Return it as plain values."""


def save_augmented(
    path: Path,
    spec: str,
    composition: Composition,
    correction: JsonWritable | None = None,
    surrogate: JsonWritable | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> None:
    """Write the file, whole or not at all; raises CesError if it cannot be. `spec` is the simulation as given."""
    write_atomically(
        path, augmented_text(name_simulation(spec, path.parent), composition, correction, surrogate, provenance)
    )


def name_simulation(spec: str, folder: Path) -> dict[str, str | None]:
    """Return how a file that is to lie in `folder` names the simulation `spec`: where it is, and its hash."""
    return {"spec": make_spec_relative(spec, folder), "sha256": _digest(spec)}


def augmented_text(
    sim: Mapping[str, str | None],
    composition: Composition,
    correction: JsonWritable | None = None,
    surrogate: JsonWritable | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of the file; `sim` is what `name_simulation` returns of the simulation."""
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
    """True if a JSON file of reasonable size says that it is an augmented simulation."""
    try:
        if path.stat().st_size > MAX_BYTES:
            return False
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(document, Mapping) and str(document.get("schema", "")).startswith("ces-augmented/")


def load_augmented(path: Path, open_simulation: Opener) -> AugmentedSimulation:
    """Read and check the file; `open_simulation` opens the simulation it names. Raises CesError in one line."""
    root = JsonObject(_document(path), str(path))
    schema = root.text("schema")
    if schema != SCHEMA:
        raise GapError(f"{path}: schema is '{schema}'; this version reads '{SCHEMA}': diagnose anew")
    settings = tuple(_setting(node) for node in root.items("effects", 0, MAX_EFFECTS))
    correction, surrogate = (
        _read_learned_part(root, "correction", LearnedCorrection),
        _read_learned_part(root, "surrogate", Surrogate),
    )
    spec = resolve_spec(root.at("sim").text("spec"), path.parent)
    _require_same(path, spec, root.at("sim"))
    inside, history = open_simulation(spec), root.at("provenance").value
    return AugmentedSimulation(str(path), inside, Composition(settings), correction, surrogate, history)


def _document(path: Path) -> Any:
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise GapError(f"{path}: {size} bytes; an augmented simulation has at most {MAX_BYTES}")
        return json.loads(path.read_text(encoding="utf-8"), parse_constant=_no_constant)
    except OSError as error:
        raise GapError(f"{path}: cannot be read: {error.strerror}; `ces diagnose` writes one") from None
    except (ValueError, RecursionError) as error:
        raise GapError(f"{path}: not a JSON file: {error}") from None


def _no_constant(name: str) -> None:
    raise ValueError(f"{name} found; expected finite numbers")


def _effect_as_json(setting: Setting) -> dict[str, Any]:
    effect, own = setting.effect, class_of(setting.effect)
    made_of = {} if own is None else {"class": own}
    return {"effect": effect.name, "form": effect.form, **made_of, "parameters": setting.values_by_name()}


def _setting(node: JsonObject) -> Setting:
    name, form = node.text("effect"), node.text("form")
    try:
        effect = user_effect(node.text("class")) if "class" in node.value else library_effect(name, form)
    except ModelError:
        raise
    except GapError as error:
        raise GapError(f"{node.where}: {error}") from None
    if (effect.name, effect.form) != (name, form):
        raise GapError(f"{node.where}: class is {effect.name} ({effect.form}); expected {name} ({form}): diagnose anew")
    return Setting(effect, _values(node.at("parameters"), effect))


def _values(node: JsonObject, effect: Effect) -> tuple[float, ...]:
    """Return the parameters' values, each within its bounds but for rounding."""
    unknown = set(node.value) - {p.name for p in effect.parameters}
    if unknown:
        expected = ", ".join(p.name for p in effect.parameters)
        raise GapError(f"{node.where}: {', '.join(sorted(unknown))} found; expected {expected}")
    slack = [1e-9 * (abs(p.low) + abs(p.high)) for p in effect.parameters]
    return tuple(
        min(max(node.number(p.name, p.low - s, p.high + s), p.low), p.high)
        for p, s in zip(effect.parameters, slack, strict=True)
    )


def _read_learned_part(root: JsonObject, name: str, kind: type[LearnedPart]) -> LearnedPart | None:
    """Return what was learnt under `name`, None if it is null."""
    given = root.mapping_or_none(name)
    if given is None:
        return None
    try:
        made = kind.from_json(dict(given))
        _require_fitting(made)
        return made
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise GapError(
            f"{root.where}: {name}: {type(error).__name__}: {error}; expected what `ces diagnose` writes: diagnose anew"
        ) from None


def _require_fitting(made: LearnedCorrection | Surrogate) -> None:
    """Raise ValueError unless there is a finite weight for each feature: compiled code reads them unchecked."""
    size = made.dictionary.size
    if made.dictionary.by_time or made.weights.shape != (size,) or not np.isfinite(made.weights).all():
        raise ValueError(f"weights of shape {made.weights.shape}; expected {size} finite ones")


def _digest(spec: str) -> str | None:
    file = file_of(spec)
    return None if file is None else hashlib.sha256(file.read_bytes()).hexdigest()


def _require_same(path: Path, spec: str, node: JsonObject) -> None:
    """Raise GapError unless the simulation's file is there and unchanged; so files cannot name each other in a ring."""
    file = file_of(spec)
    if file is None:
        return
    if not file.is_file():
        raise GapError(f"{path}: its simulation {file} is missing; put it there or diagnose anew")
    if hashlib.sha256(file.read_bytes()).hexdigest() != node.text("sha256"):
        raise GapError(f"{path}: its simulation {file} has changed since; diagnose anew")
