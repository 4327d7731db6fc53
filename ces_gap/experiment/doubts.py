"""The stage of doubts: which effects these recordings cannot tell apart, and the experiment that would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.baseline.plant import Plant, Rerun
from ces_gap.effects.effect import Composition, Setting
from ces_gap.experiment.experiment_files import NextExperiment
from ces_gap.experiment.next_experiment import next_experiment
from ces_gap.experiment.twins import Twins, seen_by, twin_classes
from ces_gap.inference.rivals import joined
from ces_gap.inference.search import Found

TWIN_CANDIDATES = 6  # effects compared as twins


@dataclass(frozen=True)
class Doubts:
    """Groups of `indistinguishable` effects, and the `pairs` that an experiment should tell apart."""

    indistinguishable: tuple[tuple[str, ...], ...]
    pairs: tuple[tuple[Setting, Setting], ...]


def find_doubts(plant: Plant, found: Found, interchangeable: Sequence[tuple[str, ...]]) -> Doubts:
    """Return what the recordings leave open; `interchangeable` are groups that the search found."""
    twins = _twins(plant, found)
    settings = {f.names[0]: f.composition.settings[0] for f in found.alone}
    alike = [(group[0], group[1]) for group in interchangeable] or (twins.pairs() if twins is not None else ())
    pairs = tuple((settings[a], settings[b]) for a, b in alike)
    if not pairs and len(found.alone) > 1:
        first, second = (f.composition.settings[0] for f in found.alone[:2])
        pairs = ((first, second),)
    return Doubts(joined(interchangeable, twins.classes if twins is not None else ()), pairs)


def propose_experiment(plant: Plant, found: Found, doubts: Doubts, exact: Rerun | None) -> NextExperiment | None:
    """Return the experiment that settles the doubts soonest, None if there is none."""
    evidence = found.evidence
    return next_experiment(plant, evidence.traces, doubts.pairs, evidence.noise.rms_N, exact=exact)


def _twins(plant: Plant, found: Found) -> Twins | None:
    if found.best is None:
        return None
    fitted = [f.composition.settings[0] for f in found.alone[:TWIN_CANDIDATES]]
    names = {s.name for s in fitted}
    beside = Composition(tuple(s for s in found.best.composition.settings if s.name not in names))
    return twin_classes(plant, found.evidence.traces, fitted, seen_by(found.evidence), around=beside)
