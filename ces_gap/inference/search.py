"""Which effects: every form alone, then compositions by beam search with joint refits, contested at the end.

The data left out decide. A composition grows only while the paired gain there exceeds twice its error and a twentieth
of the gap. Signatures order what is tried next, and never decide.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.effects.effect import Effect
from ces_gap.inference.anchored import Refinement
from ces_gap.inference.comparison import LEAST_SHARE, burdened, preferred, worth
from ces_gap.inference.contest import Contest
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import Fit, fit_alone
from ces_gap.inference.joining import fit_each, parts, ranked
from ces_gap.progress import Progress, ignore_progress

F = NDArray[np.float64]

BEAM = 2
TRIED = 3  # additions refitted jointly for each composition in the beam
MOST_EFFECTS = 3
REFINED, HOPEFUL = 10, 0.4  # forms that are refined: so many, and within so much of the gap's energy of the best
LEAST_ENERGY = 0.02  # of the noise's: a smaller gap is not looked into
SIMPLER = 0.02  # share of the gap's energy that a form with more parameters must win


@dataclass(frozen=True)
class Found:
    """`none` (r,) is the whitened residual without effects; `alone` the best form of each effect, best first.

    `tried` are compositions of as many effects as the best, refitted with one of its effects replaced.
    """

    none: F
    forms: tuple[Fit, ...]
    alone: tuple[Fit, ...]
    best: Fit | None
    gap_energy: float  # whitened squares above the noise's
    evidence: Evidence
    tried: tuple[Fit, ...] = ()


def search(
    evidence: Evidence,
    effects: Sequence[Effect],
    refinement: Refinement,
    threads: int,
    progress: Progress = ignore_progress,
) -> Found:
    """Return the best explanations of the evidence by the effects.

    `refinement` redoes the most promising fits with the simulation itself where the evidence has only a surrogate.
    """
    forms: list[Fit] = []
    with ThreadPoolExecutor(max(1, threads)) as pool:
        for fit in pool.map(lambda effect: fit_alone(evidence, effect), effects):
            forms.append(fit)
            progress(f"fitting {fit.names[0]}", len(forms) / len(effects))
    if not evidence.noise_known:
        evidence, forms = _as_quiet_as_explained(evidence, forms)
    none = evidence.residual(evidence.alone)
    energy = max(float(none @ none) - len(none), LEAST_ENERGY * len(none))
    forms.sort(key=lambda f: f.cost)
    hopeful = forms[0].cost + HOPEFUL * energy
    for k, fit in enumerate([f for f in forms[:REFINED] if f.cost < hopeful]):
        progress(f"running the simulation with {fit.names[0]}", k / REFINED)
        forms[k] = refinement.refine(evidence, fit)
    alone = best_forms(forms, energy)
    best = grow(evidence, none, alone, forms, energy, refinement, threads, progress)
    tried: tuple[Fit, ...] = ()
    if best is not None and len(best.effects) > 1:
        progress("trying other effects in their place", 0.0)
        best, tried = Contest(evidence, none, forms, energy, refinement, threads).won(best)
    return Found(none, tuple(forms), alone, best, energy, evidence, tried)


def _as_quiet_as_explained(evidence: Evidence, forms: Sequence[Fit]) -> tuple[Evidence, list[Fit]]:
    """Return evidence and fits with noise no stronger than what the best effect leaves.

    Without references the noise is only known to be at most what the generic learner leaves.
    """
    factor = min(1.0, *(float(np.sqrt(f.cost / len(f.left_out))) for f in forms))
    quieter = [
        replace(f, residual=f.residual / factor, jacobian=f.jacobian / factor, left_out=f.left_out / factor)
        for f in forms
    ]
    return evidence.scaled(factor), quieter


def best_forms(forms: Sequence[Fit], energy: float) -> tuple[Fit, ...]:
    """Return one form of each effect, best first: a richer one only if it explains clearly more."""
    chosen: dict[str, Fit] = {}
    for fit in sorted(forms, key=lambda f: len(f.searched)):
        held = chosen.get(fit.names[0])
        more = len(fit.searched) - len(held.searched) if held is not None else 0
        if held is None or fit.cost < held.cost - (SIMPLER * energy if more > 0 else 0.0):
            chosen[fit.names[0]] = fit
    return tuple(sorted(chosen.values(), key=lambda f: burdened(f, energy)))


def grow(
    evidence: Evidence,
    none: F,
    alone: Sequence[Fit],
    forms: Sequence[Fit],
    energy: float,
    refinement: Refinement,
    threads: int,
    progress: Progress,
) -> Fit | None:
    """Return the best composition, or None if not even one effect gains more than its error."""
    beam: list[Fit] = list(alone[:BEAM])
    best = beam[0] if beam and worth(evidence, none, beam[0], 0.0) else None
    for size in range(2, MOST_EFFECTS + 1):
        if best is None or best.cost - len(none) < LEAST_SHARE * energy:
            break
        progress(f"trying {size} effects together", (size - 1) / MOST_EFFECTS)
        joint = [f for f in _additions(evidence, none, beam, forms, refinement, threads) if f.cost < best.cost]
        joint.sort(key=lambda f: f.cost)
        beam = [refinement.refine(evidence, fit) for fit in joint[:BEAM]]
        better = preferred(evidence, [best, *beam], energy)
        if not worth(evidence, best.left_out, better, LEAST_SHARE * energy):
            break
        best = better
    return best


def _additions(
    evidence: Evidence, none: F, beam: Sequence[Fit], forms: Sequence[Fit], refinement: Refinement, threads: int
) -> list[Fit]:
    """Return each fit in the beam refitted with the effects that promise most beside it, no composition twice."""
    made: dict[frozenset[str], tuple[Evidence, list[Fit]]] = {}
    for fit in beam:
        close = refinement.anchor(evidence, fit)
        for other in ranked(fit, forms, none)[:TRIED]:
            made.setdefault(frozenset((*fit.names, *other.names)), (close, [*parts(fit, forms), other]))
    return fit_each(list(made.values()), threads)
