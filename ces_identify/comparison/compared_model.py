"""A model, or any other simulation, that is compared: its name, and the recordings that it was identified on."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ces_identify.recordings.recording import Recording
from ces_identify.sense.content import find_known_recording, identification_rows
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_observer.model import Model

TRAINED, TEST, UNKNOWN = "identified on", "test", "not known"
FITTED_ROLES = ("identification", "real", "reference")  # of recordings in a model's and an augmented.json's provenance

TrainingRow = Mapping[str, Any]  # a recording in a provenance: name, hash, share and marks


@dataclass(frozen=True)
class ComparedModel:
    """A simulation with the name that tables and charts show, and its `source` (a path or the like).

    `trained_on` describes the recordings that it was identified on; `training_known` is False if there may be others,
    because no file says so.
    """

    name: str
    simulation: Simulation
    source: str = ""
    trained_on: tuple[TrainingRow, ...] = ()
    training_known: bool = False

    @property
    def model(self) -> Model | None:
        """The model if it is one, None for any other simulation."""
        return self.simulation.model if isinstance(self.simulation, ModelSimulation) else None

    def use_of(self, recording: Recording, part: tuple[float, float]) -> str:
        """Return TRAINED if the model was identified on some of this `part` of the recording, TEST, or UNKNOWN."""
        if find_known_recording(recording, {"identification": list(self.trained_on)}, part):
            return TRAINED
        return TEST if self.training_known and recording.sha256 else UNKNOWN


def make_compared_model(name: str, simulation: Simulation, source: str = "") -> ComparedModel:
    """Return the simulation with the recordings that the provenance of its file names."""
    inside = simulation.innermost
    provenances = [getattr(simulation, "provenance", {})] if inside is not simulation else []
    provenances += [inside.model.provenance] if isinstance(inside, ModelSimulation) else [{}]
    rows = tuple(row for provenance in provenances for row in _fitted_rows(provenance))
    known = all(provenances) and all(row.get("sha256") or row.get("marks") for row in rows)
    return ComparedModel(name, simulation, source, rows, known)


def name_sources(sources: Sequence[str]) -> list[str]:
    """Return a name for each path or specification: the file's stem, with its folders where stems are equal."""
    return [_shortest(source, sources) for source in sources]


def _shortest(source: str, sources: Sequence[str]) -> str:
    others = [other for other in sources if other != source]
    for depth in range(1, 6):
        name = _end_of(source, depth)
        if all(name != _end_of(other, depth) for other in others):
            break
    return name


def _end_of(source: str, depth: int) -> str:
    path = Path(source)
    return "/".join([*path.parts[-depth:-1], path.stem if path.suffix in (".json", ".yaml", ".yml") else path.name])


def _fitted_rows(provenance: Mapping[str, Any]) -> Iterator[TrainingRow]:
    for role in FITTED_ROLES:
        yield from identification_rows({"identification": provenance.get(role)})
