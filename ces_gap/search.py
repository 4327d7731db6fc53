"""Which effects: every form alone, then compositions by beam search with joint refits, deletions and swaps.

The data left out decide. A composition grows only while the paired gain there exceeds twice its error and a twentieth
of the gap. Signatures order what is tried next, and never decide.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.comparison import gain
from ces_gap.effect import Effect
from ces_gap.evidence import Evidence
from ces_gap.fit import Fit, fit_alone, fit_together

F = NDArray[np.float64]

BEAM = 2
TRIED = 3  # additions refitted jointly for each composition in the beam
SWAPS = 2  # of each effect in the best composition
MOST_EFFECTS = 3
LEAST_SHARE = 0.05  # of the gap's energy that another effect must explain
LEAST_Z = 2.0
CLEAR_SHARE = 0.1  # of the noise's energy
REFINED, HOPEFUL = 10, 0.4  # forms that are refined: so many, and within so much of the gap's energy of the best
LEAST_ENERGY = 0.02  # of the noise's: a smaller gap is not looked into
PARAMETER = 0.005  # share of the gap's energy that a parameter must be worth when effects are ranked
SIMPLER = 0.02  # share of the gap's energy that a form with more parameters must win

Progress = Callable[[str, float], None]
Refine = Callable[[Evidence, Fit], Fit]


@dataclass(frozen=True)
class Found:
    """`none` (r,) is the whitened residual without effects; `alone` the best form of each effect, best first."""

    none: F
    forms: tuple[Fit, ...]
    alone: tuple[Fit, ...]
    best: Fit | None
    gap_energy: float  # whitened squares above the noise's
    evidence: Evidence


def search(evidence: Evidence, effects: Sequence[Effect], refine: Refine, threads: int, progress: Progress) -> Found:
    """Return the best explanations of the evidence by the effects.

    `refine` redoes a fit with the simulation itself where the evidence has only a stand-in for it; it is asked for the
    most promising fits alone.
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
        forms[k] = refine(evidence, fit)
    alone = best_forms(forms, energy)
    best = grow(evidence, none, alone, forms, energy, refine, progress)
    return Found(none, tuple(forms), alone, best, energy, evidence)


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
    return tuple(sorted(chosen.values(), key=lambda f: f.cost + PARAMETER * energy * len(f.searched)))


def grow(
    evidence: Evidence,
    none: F,
    alone: Sequence[Fit],
    forms: Sequence[Fit],
    energy: float,
    refine: Refine,
    progress: Progress,
) -> Fit | None:
    """Return the best composition, or None if not even one effect gains more than its error."""
    beam: list[Fit] = list(alone[:BEAM])
    best = beam[0] if beam and _worth(evidence, none, beam[0], 0.0) else None
    for size in range(2, MOST_EFFECTS + 1):
        if best is None or best.cost - len(none) < LEAST_SHARE * energy:
            break
        progress(f"trying {size} effects together", (size - 1) / MOST_EFFECTS)
        joint = [fit_together(evidence, parts) for parts in _additions(beam, alone, forms)]
        joint.sort(key=lambda f: f.cost)
        joint = sorted((refine(evidence, fit) for fit in joint[:BEAM]), key=lambda f: f.cost)
        if not joint or not _worth(evidence, best.left_out, joint[0], LEAST_SHARE * energy):
            break
        best, beam = joint[0], joint[:BEAM]
    return pruned(evidence, best, alone, forms, energy, refine) if best is not None and len(best.effects) > 1 else best


def pruned(
    evidence: Evidence, best: Fit, alone: Sequence[Fit], forms: Sequence[Fit], energy: float, refine: Refine
) -> Fit:
    """Return the composition after deletions that cost nothing and swaps that gain."""
    for left_out in range(len(best.effects)):
        others = [f for k, f in enumerate(_parts(best, forms)) if k != left_out]
        fewer = refine(evidence, fit_together(evidence, others))
        if not _worth(evidence, fewer.left_out, best, LEAST_SHARE * energy):
            return pruned(evidence, fewer, alone, forms, energy, refine) if len(others) > 1 else fewer
        for _, swap in _ranked(fewer, _outside(alone, best.names))[:SWAPS]:
            swapped = fit_together(evidence, [*_parts(fewer, forms), swap])
            if swapped.cost < best.cost and _worth(evidence, best.left_out, swapped := refine(evidence, swapped), 0.0):
                best = swapped
                break
    return best


def _worth(evidence: Evidence, before: F, after: Fit, least: float) -> bool:
    """True if the fit gains more than `least`, and more than twice its error or so much that noise cannot.

    What happens in a few blocks only, as at a bump stop, has a large error between blocks however clear it is.
    """
    paired = gain(evidence, before, after.left_out)
    return paired.energy > least and (paired.z > LEAST_Z or paired.energy > CLEAR_SHARE * len(before))


def _additions(beam: Sequence[Fit], alone: Sequence[Fit], forms: Sequence[Fit]) -> list[list[Fit]]:
    """Return the parts of compositions to refit: each in the beam with the effects that promise most."""
    made: dict[frozenset[str], list[Fit]] = {}
    for fit in beam:
        for _, other in _ranked(fit, _outside(alone, fit.names))[:TRIED]:
            made.setdefault(frozenset((*fit.names, *other.names)), [*_parts(fit, forms), other])
    return list(made.values())


def _ranked(fit: Fit, others: Sequence[Fit]) -> list[tuple[float, Fit]]:
    """Return the others by what their tangents would still explain, most first."""
    gains = [(_linear_gain(fit, other), other) for other in others]
    return sorted(gains, key=lambda pair: -pair[0])


def _linear_gain(fit: Fit, other: Fit) -> float:
    """Return the squares that a linear step along both tangents explains."""
    tangents = np.concatenate([fit.jacobian, other.jacobian], axis=1)
    scale = np.linalg.norm(tangents, axis=0)
    tangents = tangents[:, scale > 0.0] / scale[scale > 0.0]
    gram = tangents.T @ tangents + 1e-6 * np.eye(tangents.shape[1])
    slope = tangents.T @ fit.residual
    return float(slope @ np.linalg.solve(gram, slope))


def _outside(alone: Sequence[Fit], names: Sequence[str]) -> list[Fit]:
    return [f for f in alone if f.names[0] not in names]


def _parts(fit: Fit, forms: Sequence[Fit]) -> list[Fit]:
    """Return the single fits that a composition is made of, begun where the composition ended."""
    parts, first = [], 0
    for effect in fit.effects:
        single = next(f for f in forms if f.effects[0] is effect)
        count = len(effect.parameters)
        parts.append(_moved(single, fit.searched[first : first + count]))
        first += count
    return parts


def _moved(fit: Fit, searched: F) -> Fit:
    return replace(fit, searched=searched)
