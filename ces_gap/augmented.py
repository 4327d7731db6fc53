"""`augmented.json`: a simulation with the correction and the effects that a diagnosis has found, again a simulation.

It names the original simulation as on the command line, with file paths relative to its own folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.arrays import F
from ces_data.findings import warn
from ces_data.recording import Recording
from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.baseline.plant import DirectSimulator, Plant
from ces_gap.baseline.twin import Twin
from ces_gap.baseline.wrappers import ON_TIME, AroundSimulation, InputTiming, RetimedSimulation
from ces_gap.effects.effect import Composition, Effect, Setting
from ces_gap.effects.library import class_of, library_effect, user_effect
from ces_gap.effects.refitted import FORM, NetworkPart, read_part
from ces_gap.errors import GapError
from ces_gap.sensor_noise import UNMEASURED
from ces_gap.trace import make_trace, smooth_recording
from ces_identify.simulations.fmu import SPEC
from ces_identify.simulations.simulation import Simulation, find_predictions
from ces_observer import __version__
from ces_observer.errors import CesError, ModelError
from ces_observer.fields import Field
from ces_observer.json_text import parse_json, read_bounded, write_atomically
from ces_observer.records import Record, items, part, read_document, write_record
from ces_observer.shapes import ByName

SCHEMA = "ces-augmented/1"
FILES = (".json", ".yaml", ".yml")
MAX_BYTES = 4_000_000
MAX_EFFECTS = 20
AGAIN = "give a model's file, or a function of a module, such as force in simulator.py"

Opener = Callable[[str], Simulation]


@dataclass(frozen=True)
class NamedSimulation:
    """A simulation by its place relative to the file that names it; the hash is that of its own file, if it has one."""

    spec: str
    sha256: str | None


@dataclass(frozen=True, kw_only=True)
class EffectEntry:
    """An effect with its values: one of the library, of a user's class, or a part of two networks."""

    effect: str = part()
    form: str = part()
    user_class: str = part(default="", key="class", optional=True)
    networks: Mapping[str, Any] | None = part(default=None, optional=True)
    parameters: Mapping[str, float] = part()


@dataclass(frozen=True, kw_only=True)
class AugmentedFile:
    """What the file holds beside its schema."""

    sim: NamedSimulation = part()
    parameters: Mapping[str, float] | None = part(default=None, optional=True)
    input_timing: InputTiming = part(default=ON_TIME, optional=True)
    correction: LearnedCorrection | None = part()
    twin: Mapping[str, Any] | None = part()
    is_recorded: bool = part()
    effects: tuple[EffectEntry, ...] = items(0, MAX_EFFECTS)
    provenance: Mapping[str, Any] = part()


FILE = Field(kind=Record(AugmentedFile))


@dataclass(frozen=True)
class AugmentedSimulation(AroundSimulation):
    """A simulation with a correction and effects; the `twin` holds those inside, and replaces one `is_recorded`."""

    name: str
    composition: Composition
    correction: LearnedCorrection | None = None
    twin: Twin | None = None
    is_recorded: bool = False
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def force(self, recording: Recording) -> F:
        """Return the force [N] at every position sample (n,), NaN where the simulation has none.

        As in the diagnosis, the simulation runs on the smoothed position, if it can be run. The added force is computed
        at the rate of the position and interpolated, so that the simulation's own force keeps its detail.
        """
        if not self.composition.settings and self.correction is None:
            return self.simulation.force(recording)
        if find_predictions(self.simulation) is None:
            recording = smooth_recording(recording, make_trace(recording, np.zeros(len(recording.channel("position")))))
        own = self.simulation.force(recording)
        trace = make_trace(recording, own, UNMEASURED, thinned=False)
        simulator = self.twin if self.is_recorded and self.twin else DirectSimulator(self.simulation)
        plant = Plant(simulator, self.correction, self.twin)
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
        stamps = recording.channel("position").stamps_ns
        return np.asarray(own + np.interp((stamps - stamps[0]) * 1e-9, trace.time_s, force - trace.simulated))


def file_of(spec: str) -> Path | None:
    """Return the file of a simulation; None for `topic:/name` and `module:function`."""
    path = _split(spec)[0]
    return Path(path) if path else None


def _split(spec: str) -> tuple[str, str]:
    """Return the path in `spec`, empty if it has none, and the rest."""
    if not spec.startswith("topic:") and (fmu := SPEC.fullmatch(spec)):
        return fmu[1], spec[len(fmu[1]) :]
    return (spec, "") if not spec.startswith("topic:") and Path(spec).suffix.lower() in FILES else ("", spec)


def name_simulation(spec: str, folder: Path) -> dict[str, str | None]:
    """Return the entry `sim` of a file in `folder`: the simulation `spec` relative to it if possible, and its hash.

    It warns of a function that no other program finds by its name.
    """
    path, rest = _split(spec)
    if not path:
        if not spec.startswith("topic:") and not _is_importable(spec):
            warn(f"no program can open what names the simulation {spec}: {AGAIN}")
        return {"spec": spec, "sha256": None}
    try:
        relative = Path(os.path.relpath(Path(path).resolve(), folder.resolve())).as_posix()
    except ValueError:  # another drive
        relative = str(Path(path).resolve())
    return {"spec": relative + rest, "sha256": _digest(Path(path))}


def save_augmented(
    path: Path,
    spec: str,
    composition: Composition,
    correction: LearnedCorrection | None = None,
    twin: Twin | None = None,
    is_recorded: bool = False,
    provenance: Mapping[str, Any] | None = None,
    timing: InputTiming = ON_TIME,
) -> None:
    """Write the file atomically; `spec` names the simulation. Raises CesError if it cannot be written."""
    sim = name_simulation(spec, path.parent)
    write_atomically(path, augmented_text(sim, composition, correction, twin, is_recorded, provenance, timing))


def augmented_text(
    sim: Mapping[str, str | None],
    composition: Composition,
    correction: LearnedCorrection | None = None,
    twin: Twin | None = None,
    is_recorded: bool = False,
    provenance: Mapping[str, Any] | None = None,
    timing: InputTiming = ON_TIME,
    values: Mapping[str, float] | None = None,
) -> str:
    """Return the text of the file; `sim` comes from `name_simulation`, `values` are those of its parameters."""
    file = AugmentedFile(
        sim=NamedSimulation(str(sim["spec"]), sim["sha256"]),
        parameters=values or None,
        input_timing=timing,
        correction=correction,
        twin=twin.as_json() if twin is not None and (is_recorded or composition.edits) else None,
        is_recorded=is_recorded,
        effects=tuple(map(_make_entry, composition.settings)),
        provenance={"tool": f"ces_observer {__version__}", **(provenance or {})},
    )
    return json.dumps({"schema": SCHEMA, **write_record(file)}, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def has_schema(path: Path, name: str) -> bool:
    """True if the file is JSON of at most `MAX_BYTES` with a version of the schema `name`."""
    try:
        document = parse_json(read_bounded(path, MAX_BYTES), str(path))
    except (OSError, ModelError):
        return False
    return isinstance(document, Mapping) and str(document.get("schema", "")).startswith(f"{name}/")


def is_augmented(path: Path) -> bool:
    """True if the file is that of an augmented simulation."""
    return has_schema(path, "ces-augmented")


def load_augmented(path: Path, open_simulation: Opener) -> AugmentedSimulation:
    """Read and check the file; `open_simulation` opens the simulation that it names. Raises CesError.

    The simulation's file must be the same as when the file was written; this excludes circular references.
    """
    try:
        values = parse_json(read_bounded(path, MAX_BYTES), str(path))
    except OSError as error:
        raise GapError(f"{path}: cannot be read: {error.strerror}; `ces diagnose` writes one") from None
    again = "run `ces diagnose` again"
    file: AugmentedFile = read_document(FILE, values, str(path), SCHEMA, again, GapError)
    settings = tuple(_read_setting(entry, f"{path}: effects[{i}]") for i, entry in enumerate(file.effects))
    twin = None if file.twin is None else Twin.from_json(file.twin, f"{path}: twin")
    simulation = open_named(path, file.sim, open_simulation)
    if file.parameters:
        simulation = simulation.with_values(file.parameters)
    if file.input_timing:
        simulation = RetimedSimulation(simulation, file.input_timing)
    composition = Composition(settings)
    return AugmentedSimulation(
        simulation, str(path), composition, file.correction, twin, file.is_recorded, file.provenance
    )


def open_named(path: Path, sim: NamedSimulation, open_simulation: Opener, writer: str = "diagnose") -> Simulation:
    """Return the simulation that `sim` in the file `path` names (`name_simulation`), unless its own file has changed.

    `writer` is the program that wrote the file. Raises CesError.
    """
    spec, rest = _split(sim.spec)
    if spec:
        file = path.parent / spec
        if not file.is_file():
            raise GapError(f"{path}: its simulation {file} is missing; restore it or run `ces {writer}` again")
        if _digest(file) != sim.sha256:
            raise GapError(f"{path}: its simulation {file} has changed since; run `ces {writer}` again")
        rest = f"{file}{rest}"
    return open_simulation(rest)


def _is_importable(spec: str) -> bool:
    module, colon, name = spec.partition(":")
    if not colon or module == "__main__":
        return False
    return module not in sys.modules or callable(getattr(sys.modules[module], name, None))


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


def _make_entry(setting: Setting) -> EffectEntry:
    effect = setting.effect
    parameters = {p.name: v for p, v in zip(effect.parameters, setting.values, strict=True)}
    networks = effect.as_json() if isinstance(effect, NetworkPart) else None
    user_class = None if networks else class_of(effect)
    return EffectEntry(
        effect=setting.name, form=effect.form, user_class=user_class or "", networks=networks, parameters=parameters
    )


def _read_setting(entry: EffectEntry, where: str) -> Setting:
    """Return an effect with its values, each within its bounds apart from rounding."""
    name, form = entry.effect, entry.form
    try:
        if form == FORM:
            effect: Effect = read_part(name, entry.networks)
        else:
            effect = user_effect(entry.user_class) if entry.user_class else library_effect(name, form)
    except (GapError, ModelError) as error:
        raise GapError(f"{where}: {error}") from None
    if (effect.name, effect.form) != (name, form):
        class_name = f"{effect.name} ({effect.form})"
        raise GapError(f"{where}: class is {class_name}; expected {name} ({form}); run `ces diagnose` again")
    names = tuple(p.name for p in effect.parameters)
    given = Field(kind=ByName(Field(kind=float), names, names)).check(
        entry.parameters, f"{where}: parameters", GapError
    )
    values = []
    for p in effect.parameters:
        slack = Field(kind=float, low=p.low - 1e-9 * abs(p.low), high=p.high + 1e-9 * abs(p.high))
        value = slack.check(given[p.name], f"{where}: parameters: {p.name}", GapError)
        values.append(min(max(value, p.low), p.high))
    return Setting(effect, tuple(values))
