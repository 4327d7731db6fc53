"""The stage of doubts: which effects these recordings cannot tell apart, and the experiment that would."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ces_gap.baseline.plant import Plant, TraceSimulator
from ces_gap.effects.effect import Composition, Setting
from ces_gap.experiment.experiment_files import NextExperiment
from ces_gap.experiment.indistinguishable import (
    IndistinguishableEffects,
    find_indistinguishable_effects,
    make_evidence_whitening,
)
from ces_gap.experiment.next_experiment import choose_next_experiment
from ces_gap.inference.alternatives import merge_groups
from ces_gap.inference.search import EffectSearchResult

MAX_COMPARED_EFFECTS = 6  # effects compared as twins


@dataclass(frozen=True)
class Doubts:
    """Groups of `indistinguishable` effects, and the `pairs` that an experiment should tell apart."""

    indistinguishable: tuple[tuple[str, ...], ...]
    pairs: tuple[tuple[Setting, Setting], ...]


def find_doubts(plant: Plant, found: EffectSearchResult, interchangeable: Sequence[tuple[str, ...]]) -> Doubts:
    """Return what the recordings leave open; `interchangeable` are groups that the search found."""
    twins = _twins(plant, found)
    settings = {f.names[0]: f.composition.settings[0] for f in found.alone}
    alike = [(group[0], group[1]) for group in interchangeable] or (twins.pairs() if twins is not None else ())
    pairs = tuple((settings[a], settings[b]) for a, b in alike)
    if not pairs and len(found.alone) > 1:
        first, second = (f.composition.settings[0] for f in found.alone[:2])
        pairs = ((first, second),)
    return Doubts(merge_groups(interchangeable, twins.classes if twins is not None else ()), pairs)


def propose_experiment(
    plant: Plant, found: EffectSearchResult, doubts: Doubts, exact: TraceSimulator | None
) -> NextExperiment | None:
    """Return the experiment that settles the doubts soonest, None if there is none."""
    evidence = found.evidence
    return choose_next_experiment(plant, evidence.traces, doubts.pairs, evidence.noise.rms_N, exact=exact)


def _twins(plant: Plant, found: EffectSearchResult) -> IndistinguishableEffects | None:
    if found.best is None:
        return None
    fitted = [f.composition.settings[0] for f in found.alone[:MAX_COMPARED_EFFECTS]]
    names = {s.name for s in fitted}
    beside = Composition(tuple(s for s in found.best.composition.settings if s.name not in names))
    return find_indistinguishable_effects(
        plant, found.evidence.traces, fitted, make_evidence_whitening(found.evidence), around=beside
    )
