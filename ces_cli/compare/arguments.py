"""The arguments of `ces compare`, told apart by what they are: simulations, campaigns and recordings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import find_bags
from ces_cli.terminal.simulations import find_file, open_simulation, with_predictions
from ces_identify.comparison.compared_model import ComparedModel, make_compared_model, name_sources
from ces_identify.numerics.arrays import F
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.fmu_ports import SPEC
from ces_identify.simulations.simulation import Simulation, find_predictions
from ces_observer.errors import CesError
from ces_observer.signals import Signals

FILES = (".json", ".yaml", ".yml")
RESULTS = "results.jsonl"


@dataclass(frozen=True)
class ComparedWords:
    """The arguments by kind: specifications of simulations, folders of campaigns, and words that name bags."""

    simulations: tuple[str, ...]
    campaigns: tuple[Path, ...]
    bags: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """The names of simulations and campaigns."""
        return [*name_sources(self.simulations), *(path.resolve().name for path in self.campaigns)]

    @property
    def inputs(self) -> list[Path | None]:
        """The files and folders that are read."""
        return [*map(find_file, self.simulations), *self.campaigns, *map(Path, self.bags)]


def sort_words(words: Sequence[str]) -> ComparedWords:
    """Return the arguments by kind; raises CesError for a simulation that is given twice."""
    simulations = [word for word in words if _is_simulation(word)]
    for word in simulations:
        if simulations.count(word) > 1:
            raise CesError(f"{word} is given twice; a model does not differ from itself")
    campaigns = [word for word in words if (Path(word) / RESULTS).is_file()]
    bags = [word for word in words if word not in simulations and word not in campaigns]
    return ComparedWords(tuple(simulations), tuple(map(Path, campaigns)), tuple(bags))


def _is_simulation(word: str) -> bool:
    if word.startswith("topic:") or SPEC.fullmatch(word) or Path(word).suffix.lower() in FILES:
        return True
    return ":" in word and not Path(word).exists()


def read_recordings(words: Sequence[str], signals: Signals) -> list[tuple[Path, Recording]]:
    """Return the recordings with a measured force that the arguments name, with their paths. Raises CesError."""
    return [(path, terminal.read_one(path, signals, terminal.FORCE)) for path in find_bags(words)]


def open_models(
    specs: Sequence[str],
    recordings: Sequence[tuple[Path, Recording]],
    signals: Signals,
    names: Mapping[str, str] | None = None,
) -> list[ComparedModel]:
    """Return the simulations; predictions are read from the recordings' bags.

    `names` holds names that are known already; the others come from their files, with folders where they are equal.
    """
    known = names or {}
    opened = [_with_predictions(open_simulation(spec), recordings, signals) for spec in specs]
    return [
        make_compared_model(known.get(spec, name), simulation, spec)
        for name, simulation, spec in zip(name_sources(specs), opened, specs, strict=True)
    ]


@dataclass(frozen=True)
class PredictedSimulation(Simulation):
    """A simulation whose force is in the bags; `extended` holds each recording with it, by the recording's source."""

    simulation: Simulation
    extended: Mapping[str, Recording]

    @property
    def innermost(self) -> Simulation:
        """The simulation inside."""
        return self.simulation.innermost

    def force(self, recording: Recording) -> F:
        """Return the recorded force [N] at every position sample (n,)."""
        return self.simulation.force(self.extended[recording.source])


def _with_predictions(
    simulation: Simulation, recordings: Sequence[tuple[Path, Recording]], signals: Signals
) -> Simulation:
    if find_predictions(simulation) is None:
        return simulation
    extended = {r.source: with_predictions(simulation, path, r, signals) for path, r in recordings}
    return PredictedSimulation(simulation, extended)
