"""The stage of doubts: effects that these recordings cannot distinguish, and the experiment that would."""

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

MAX_COMPARED_EFFECTS = 6


@dataclass(frozen=True)
class Doubts:
    """Groups of `indistinguishable` effects, and the `pairs` that an experiment should distinguish."""

    indistinguishable: tuple[tuple[str, ...], ...]
    pairs: tuple[tuple[Setting, Setting], ...]


NO_DOUBTS = Doubts((), ())


def find_doubts(plant: Plant, result: EffectSearchResult, interchangeable: Sequence[tuple[str, ...]]) -> Doubts:
    """Return what the recordings leave open; `interchangeable` are the groups of alternatives from the search."""
    compared = _compare_fits(plant, result)
    settings = {f.names[0]: f.composition.settings[0] for f in result.alone}
    names = [(group[0], group[1]) for group in interchangeable] or (compared.pairs() if compared is not None else ())
    pairs = tuple((settings[a], settings[b]) for a, b in names)
    if not pairs and len(result.alone) > 1:
        first, second = (f.composition.settings[0] for f in result.alone[:2])
        pairs = ((first, second),)
    return Doubts(merge_groups(interchangeable, compared.classes if compared is not None else ()), pairs)


def propose_experiment(
    plant: Plant, result: EffectSearchResult, doubts: Doubts, exact: TraceSimulator | None
) -> NextExperiment | None:
    """Return the experiment that resolves the doubts fastest, None without doubts.

    Raises GapError if no candidate would resolve them.
    """
    evidence = result.evidence
    return choose_next_experiment(plant, evidence.traces, doubts.pairs, evidence.noise.rms_N, exact=exact)


def _compare_fits(plant: Plant, result: EffectSearchResult) -> IndistinguishableEffects | None:
    if result.best is None:
        return None
    fitted = [f.composition.settings[0] for f in result.alone[:MAX_COMPARED_EFFECTS]]
    names = {s.name for s in fitted}
    others = Composition(tuple(s for s in result.best.composition.settings if s.name not in names))
    return find_indistinguishable_effects(
        plant, result.evidence.traces, fitted, make_evidence_whitening(result.evidence), around=others
    )
