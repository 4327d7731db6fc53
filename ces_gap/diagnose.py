"""The whole diagnosis: a simulation and recordings go in, verdict, causes and what they leave come out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.ceiling import learn_ceiling
from ces_gap.baseline.correction import LearntCorrection, learn_correction
from ces_gap.baseline.learner import Learnt
from ces_gap.baseline.noise import Noise, white
from ces_gap.baseline.plant import Plant
from ces_gap.diagnosis import (
    AMBIGUOUS,
    NAMED,
    NO_GAP,
    UNKNOWN,
    Diagnosis,
    Explained,
    Gap,
    NextExperiment,
    Series,
    Where,
)
from ces_gap.effects.effect import Composition, Effect, Setting
from ces_gap.effects.library import library
from ces_gap.effects.user_effects import require_sound
from ces_gap.experiment.next_experiment import next_experiment
from ces_gap.experiment.twins import Twins, seen_by, twin_classes
from ces_gap.inference.anchored import anchor, polished, reruns
from ces_gap.inference.comparison import gain
from ces_gap.inference.evidence import Evidence, gather
from ces_gap.inference.explaining import Judge, drift, judge, stuck
from ces_gap.inference.fit import Fit
from ces_gap.inference.rivals import joined, least_left, stand_ins
from ces_gap.inference.search import Found, search
from ces_gap.inference.shrinkage import Blocks, cut
from ces_gap.inference.static_map import absorbed_by_map, static_features
from ces_gap.inference.verdict import Figures, Probabilities, calibration, probabilities, rivalled
from ces_gap.intake.checks import check_traces, invisible
from ces_gap.intake.given import Given, make_ready
from ces_gap.report.sentence import sentence
from ces_gap.trace import Trace
from ces_gap.where.locate import gap_within, locate
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation

F = NDArray[np.float64]
Progress = Callable[[str, float], None]

CLEAR_Z = 20.0  # z for which a gain as large as the noise counts, in however few blocks it arose
EXACT_CAUSES = 3  # causes whose shrink is computed with the simulation itself, however slow
TWIN_CANDIDATES = 6  # effects compared as twins


@dataclass(frozen=True)
class Options:
    """`effects` of the user's own beside the library's; `threads` to fit with; `seed` of resampling.

    `experiment` False leaves out the search for the next experiment.
    """

    effects: tuple[Effect, ...] = ()
    threads: int = 1
    seed: int = 1
    experiment: bool = True


def _quiet(what: str, share: float) -> None:
    """Take in progress that nobody watches."""


def diagnose(
    simulation: Simulation,
    spec: str,
    real: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    reference: Sequence[Recording] = (),
    options: Options | None = None,
    progress: Progress = _quiet,
) -> Diagnosis:
    """Return what causes the gap between `simulation` (`spec` is how it was named) and the `real` recordings.

    Judged on `held_out` (a part of `real` if none), the simulation's own error learnt from `reference`. `progress` is
    told what is being done and the share of that step. Raises CesError for what cannot be diagnosed.
    """
    how = options or Options()
    given = make_ready(simulation, real, held_out, reference, progress)
    for effect in how.effects:
        require_sound(effect, given.real[0])
    notes = check_traces([*given.real, *given.held_out, *given.reference], simulation, spec)
    return _Diagnosing(given, spec, how, progress).result(notes)


class _Diagnosing:
    """One diagnosis on its way: each step is computed from those before."""

    def __init__(self, given: Given, spec: str, how: Options, progress: Progress) -> None:
        self.given, self.spec, self.how, self.progress = given, spec, how, progress
        self.effects = (*library(), *how.effects)
        progress("learning the simulation's own error", 0.0)
        self.correction: LearntCorrection | None = None
        self.evidence = self._evidence()
        self.plant = self.evidence.plant

    def _evidence(self) -> Evidence:
        given = self.given
        if given.reference:
            self.correction, learnt = learn_correction(given.reference)
            features = [self.correction.dictionary.features(t, t.inputs, t.simulated) for t in given.real]
            return gather(given.real, Plant(given.cheap, self.correction), learnt.noise, features, learnt.covariance)
        left = learn_ceiling(given.real, [t.simulated for t in given.real])[1].noise.rms_N
        noise = white(max(left, *(t.noise_N for t in given.real)))
        return gather(given.real, Plant(given.cheap), noise, static_features(given.real), None)

    def result(self, notes: tuple[str, ...]) -> Diagnosis:
        """Return the finished diagnosis."""
        evidence = self.evidence
        unseen = invisible(self.effects, self.given.real)
        blind = {name for name, _ in unseen}
        seen = [e for e in self.effects if e.name not in blind]
        found = search(evidence, seen, self._refined, self.how.threads, self.progress, self._near)
        self.evidence = evidence = found.evidence
        self.progress("asking the generic learner", 0.0)
        before, after = self._learnt(list(evidence.alone)), self._learnt(self._explained(found.best))
        figures = self._figures(found, before, after)
        names = found.best.names if found.best is not None else ()
        odds = probabilities(figures, least_left(found), names, calibration())
        court = judge(self._blocks(after), self.given.cheap, self.given.exact, self.plant)
        self.progress("comparing twins", 0.0)
        twins, rivals = self._twins(found), stand_ins(found)
        verdict = self._verdict(found, odds, bool(rivals))
        causes = self._causes(found, odds, court)
        composition = self._composition(found, verdict, court)
        self.progress("locating the gap", 0.0)
        where, composition, rest = self._where(court, composition, verdict)
        made = Diagnosis(
            verdict=verdict,
            sentence="",
            simulation=self.spec,
            gap=self._gap(court),
            where=where,
            causes=causes,
            composition=composition,
            indistinguishable=joined(rivals, twins.classes if twins is not None else ()),
            not_separable=() if self.given.reference else absorbed_by_map(evidence, found.alone),
            invisible=unseen,
            ceiling_after_N=self._ceiling(court),
            wrong=next((c for c in causes if c.effects[0] not in composition.effects), None),
            probability_none=odds.none,
            probability_unknown=odds.unknown,
            rest=rest,
            next_experiment=self._next(found, verdict, twins, rivals),
            surrogate_cost_J=self.given.surrogate.cost_J if self._recorded() and self.given.surrogate else None,
            held_out=self._series(court, composition),
            notes=notes,
            correction=self.correction,
            surrogate=self.given.surrogate if self._recorded() else None,
            baselines=_baselines(found),
            figures=figures,
        )
        return replace(made, sentence=sentence(made))

    def _recorded(self) -> bool:
        return self.given.exact is None

    def _refined(self, evidence: Evidence, fit: Fit) -> Fit:
        if self.given.exact is None or self.given.exact is self.given.cheap:
            return fit
        return polished(evidence, fit, self.given.exact, self.given.cheap)

    def _near(self, evidence: Evidence, fit: Fit) -> Evidence:
        if self.given.exact is None or self.given.exact is self.given.cheap or not reruns(fit.effects):
            return evidence
        return anchor(evidence, fit, self.given.exact, self.given.cheap)

    def _figures(self, found: Found, before: Learnt, after: Learnt) -> Figures:
        evidence, best = self.evidence, found.best
        residual = best.left_out if best is not None else found.none
        gained = gain(evidence, found.none, residual)
        open_ = gain(evidence, found.none, found.none - evidence.whiten(before.crossfitted))
        more = gain(evidence, residual, residual - evidence.whiten(after.crossfitted))
        left = (float(residual @ residual) - len(residual)) / found.gap_energy
        learnable = more.energy / found.gap_energy
        return Figures(
            energy=(float(found.none @ found.none) - len(found.none)) / len(found.none),
            gain_z=max(gained.z, CLEAR_Z * gained.energy / len(residual)) if best is not None else 0.0,
            ceiling_z=open_.z,
            unexplained=left if evidence.noise_known else learnable,
            learnable=learnable,
            learnable_z=more.z,
            stuck=stuck(best) if best is not None else 0,
            drift=drift(best) if best is not None else 0.0,
        )

    def _explained(self, best: Fit | None) -> list[F]:
        """Return the force [N] with the best explanation on each real trace."""
        if best is None:
            return list(self.evidence.alone)
        plant = Plant(self.given.exact or self.given.cheap, self.plant.correction)
        pairs = zip(self.evidence.traces, self.evidence.alone, strict=True)
        return [plant.with_effects(best.composition, t, a) for t, a in pairs]

    def _learnt(self, forces: list[F]) -> Learnt:
        """Return what the generic learner makes of what these forces [N] leave, on blocks it did not see."""
        return learn_ceiling(self.evidence.traces, forces)[1]

    def _blocks(self, after: Learnt) -> Blocks:
        """Return the held-out blocks, with noise of no more than the references or the best explanation leave."""
        taught = self.evidence.noise.rms_N if self.given.reference else np.inf
        return cut(self.given.held_out, self.how.seed, min(taught, after.noise.rms_N))

    def _verdict(self, found: Found, odds: Probabilities, replaceable: bool) -> str:
        weights = calibration()
        if odds.none > 1.0 - weights.least_gap:
            return NO_GAP
        if found.best is None or odds.unknown > (1.0 - odds.none) * (1.0 - weights.least_known):
            return UNKNOWN
        if replaceable or rivalled(found.best.names, odds):
            return AMBIGUOUS
        return NAMED

    def _causes(self, found: Found, odds: Probabilities, court: Judge) -> tuple[Explained, ...]:
        inside = found.best.names if found.best is not None else ()
        ranked = sorted(found.alone, key=lambda f: (-odds.effects[f.names[0]], f.names[0] not in inside, f.cost))
        causes = []
        for k, fit in enumerate(ranked):
            self.progress(f"judging {fit.names[0]}", k / len(ranked))
            gained = gain(self.evidence, found.none, fit.left_out)
            share, error = gained.energy / found.gap_energy, gained.error / found.gap_energy
            one = court.explained(fit, share, error, k < EXACT_CAUSES or fit.names[0] in inside)
            causes.append(replace(one, probability=odds.effects[fit.names[0]]))
        return tuple(causes)

    def _composition(self, found: Found, verdict: str, court: Judge) -> Explained:
        if found.best is None or verdict == NO_GAP:
            return court.nothing()
        gained = gain(self.evidence, found.none, found.best.left_out)
        return court.explained(found.best, gained.energy / found.gap_energy, gained.error / found.gap_energy, True)

    def _gap(self, court: Judge) -> Gap:
        given, corrected = court.before, court.blocks.energy(court.alone)
        rms, ci95 = court.blocks.rms(given)
        fixed, fixed_ci95 = court.blocks.rms(corrected) if self.given.reference else (rms, ci95)
        return Gap(rms, ci95, _floor(court.blocks), _cost_J(court.blocks), fixed, fixed_ci95)

    def _where(self, court: Judge, composition: Explained, verdict: str) -> tuple[Where, Explained, Where | None]:
        """Return where the gap lies, the composition with what it leaves there, where the unknown rest lies."""
        traces = [*self.evidence.traces, *court.blocks.traces]
        alone = [*self.evidence.alone, *court.alone]
        where = locate(traces, _less(traces, alone), self._known(traces), self.how.seed)
        judged, left = court.blocks.traces, _less(court.blocks.traces, court.forces(composition.composition, True))
        within = gap_within(where.regions, judged, left, self._known(judged))
        composition = replace(composition, by_region=tuple(zip(where.regions, within, strict=True)))
        rest = locate(judged, left, self._known(judged), self.how.seed) if verdict == UNKNOWN else None
        return where, composition, rest

    def _known(self, traces: Sequence[Trace]) -> Noise | list[float]:
        return self.evidence.noise if self.given.reference else [t.noise_N for t in traces]

    def _ceiling(self, court: Judge) -> float:
        """Return the gap [N] that the learner, taught by the real recordings, leaves on the held-out ones."""
        dictionary, learnt = learn_ceiling(self.evidence.traces, self.evidence.alone)
        pairs = zip(court.blocks.traces, court.alone, strict=True)
        forces = [a + dictionary.features(t, t.inputs, a) @ learnt.weights for t, a in pairs]
        return court.blocks.rms(court.blocks.energy(forces))[0]

    def _twins(self, found: Found) -> Twins | None:
        if found.best is None:
            return None
        fitted = [f.composition.settings[0] for f in found.alone[:TWIN_CANDIDATES]]
        return twin_classes(
            self.plant, self.evidence.traces, fitted, seen_by(self.evidence), around=_others(found.best, fitted)
        )

    def _next(
        self, found: Found, verdict: str, twins: Twins | None, rivals: Sequence[tuple[str, ...]]
    ) -> NextExperiment | None:
        if not self.how.experiment or verdict in (NO_GAP, NAMED) or found.best is None:
            return None
        self.progress("choosing the next experiment", 0.0)
        settings = {f.names[0]: f.composition.settings[0] for f in found.alone}
        alike = [(group[0], group[1]) for group in rivals] or (twins.pairs() if twins is not None else ())
        pairs = [(settings[a], settings[b]) for a, b in alike]
        first = [f.composition.settings[0] for f in found.alone[:2]]
        pairs = pairs or ([(first[0], first[1])] if len(first) == 2 else [])
        return next_experiment(
            self.plant, self.evidence.traces, pairs, self.evidence.noise.rms_N, exact=self.given.exact
        )

    def _series(self, court: Judge, composition: Explained) -> tuple[Series, ...]:
        forces = court.forces(composition.composition, True)
        return tuple(Series(t, a, f) for t, a, f in zip(court.blocks.traces, court.alone, forces, strict=True))


def _others(best: Fit, fitted: Sequence[Setting]) -> Composition:
    """Return the effects of a composition beside those compared."""
    names = {s.name for s in fitted}
    return Composition(tuple(s for s in best.composition.settings if s.name not in names))


def _less(traces: Sequence[Trace], forces: Sequence[F]) -> list[F]:
    """Return measured less modelled force [N] (n,) on each trace."""
    return [t.force - f for t, f in zip(traces, forces, strict=True)]


def _floor(blocks: Blocks) -> float:
    return float(np.sqrt(blocks.noise.sum() / max(float(blocks.ticks.sum()), 1.0)))


def _cost_J(blocks: Blocks) -> float:
    """Return the cost J [%] of the simulation as given (thesis eq. 3.5)."""
    force = np.concatenate([t.force[t.usable] for t in blocks.traces])
    given = np.concatenate([t.as_given[t.usable] for t in blocks.traces])
    return 100.0 * float(np.linalg.norm(force - given) / max(float(np.linalg.norm(force - force.mean())), 1e-9))


def _baselines(found: Found) -> dict[str, str]:
    """Return what simpler ways of choosing would have named: for comparison in blind tests."""
    n = len(found.none)
    bic = min(found.alone, key=lambda f: n * np.log(f.residual @ f.residual) + len(f.searched) * np.log(n))
    flexible = max(found.alone, key=lambda f: (len(f.searched), -f.cost))
    likest = max(found.alone, key=lambda f: _likeness(found.none, f))
    return {"signature_correlation": likest.names[0], "bic": bic.names[0], "most_flexible": flexible.names[0]}


def _likeness(none: F, fit: Fit) -> float:
    signature = none - fit.residual
    return float(abs(signature @ none) / max(float(np.linalg.norm(signature) * np.linalg.norm(none)), 1e-12))
