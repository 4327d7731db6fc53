"""Identification from end to end: recordings in, a model with its costs out.

The steps: sampling from the positions, preparation, fit of a structure, and evaluation on held-out data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_data.checks.content import marks_of_copies, require_distinct
from ces_data.findings import WRONG_MODEL, Finding
from ces_data.recording import Recording
from ces_data.samples import without_spikes
from ces_identify.limits import ResultLimits, TickLimits
from ces_identify.numerics.search import INTERRUPTED, Listener, SearchResult
from ces_identify.prepare.sampling import choose_motion, choose_sampling
from ces_identify.prepare.series import Series, prepare
from ces_identify.structures import run_batch
from ces_identify.structures.forgetting import find_forgetting
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.training import build_training
from ces_identify.validation.band import fit_band
from ces_identify.validation.cost_table import RULE, cost_table, usage
from ces_identify.validation.evaluate import (
    IDENTIFICATION,
    VALIDATION,
    Evaluation,
    describe_size,
    evaluate,
    pooled_cost,
)
from ces_observer import __version__
from ces_observer.errors import CesError, RecordingError
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial

UNLIKE_FORCE = "the force does not follow these signals: check that topics, signs and damper are the right ones"
STRETCHES = "identified_on"  # key of the provenance
COSTS = "cost_J_percent"  # key of the provenance


@dataclass(frozen=True)
class IdentificationResult:
    """A model, its evaluations (identification first) and the results of all starts, best first."""

    model: Model
    evaluations: tuple[Evaluation, ...]
    search_results: tuple[SearchResult, ...]

    def __repr__(self) -> str:
        return f"{self._describe()}\n{cost_table(self.evaluations)}"

    def _repr_html_(self) -> str:
        return str(Markup("<p>{}</p>{}").format(self._describe(), cost_table(self.evaluations).to_html()))

    def _describe(self) -> str:
        """Return what the model is in a line."""
        model = self.model
        proof = "stability not proved" if model.certificate is None else "proved stable"
        return f"{model.structure}: {describe_size(model)} at {model.sampling.rate_Hz:g} Hz, {proof}; costs J:"

    def require_explained(self, found: Sequence[Finding] = (), ignore_findings: bool = False) -> IdentificationResult:
        """Return the result with the findings in spite of which it was identified in the model's provenance.

        `found` are those of the checks. Raises RecordingError if the model explains nothing of the force that it was
        fitted to, unless `ignore_findings`.
        """
        failure = self._describe_failure()
        reasons = [f.text for f in found if f.signal != "current"] or [UNLIKE_FORCE]
        if failure and not ignore_findings:
            raise RecordingError(f"{failure}; {reasons[0]}; --ignore-findings keeps such a model")
        forced = [f.text for f in found if f.severity == WRONG_MODEL] + [failure] * bool(failure)
        if not forced:
            return self
        return replace(self, model=replace(self.model, provenance={**self.model.provenance, "forced": forced}))

    def _describe_failure(self) -> str:
        """Return what shows that the model explains nothing; '' if it does, or for an interrupted or weighted fit."""
        fitted = [e for e in self.evaluations if e.role == IDENTIFICATION]
        stopped = any(one.ended == INTERRUPTED for one in self.search_results)
        if stopped or "weights" in self.model.provenance["selection"]:
            return ""
        cost = pooled_cost(fitted)
        noise = max(_noise_share(e.series.force[e.series.scored]) for e in fitted)
        if not cost**2 < ResultLimits.UNEXPLAINED_J**2 + (100.0 * noise) ** 2:
            return f"the model explains nothing of the force: J is {cost:.1f} % on the data that it was fitted to"
        if cost > ResultLimits.WITHOUT_SPEED_J and not _follows_motion(self.model):
            return f"no term of the model follows the motion, and J is {cost:.1f} % on the data that it was fitted to"
        return ""


def _noise_share(force: F) -> float:
    """Return the RMS of the white noise in a force (n,), by its third differences, over its standard deviation."""
    return float(1.4826 * np.median(np.abs(np.diff(force, 3))) / np.sqrt(20.0) / force.std())


def _follows_motion(model: Model) -> bool:
    """Return whether a polynomial has the speed, a constructed input, or two positions in its terms; others have."""
    if not isinstance(model.body, Polynomial):
        return True
    factors = [factor for term in model.body.terms for factor in term.inputs]
    positions = {factor.lag for factor in factors if factor.signal == "position"}
    return len(positions) > 1 or not {f.signal for f in factors} <= {"position", "current"}


def identify(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    options: IdentifyOptions | None = None,
    listener: Listener = lambda result: None,
    fitter: Fitter = fit_polynomial,
) -> IdentificationResult:
    """Identify a model on the first `options.share` of every recording with the structure's `fitter`.

    Validation data are the rest of the recordings and all of the `validation` recordings; neither fit nor selection
    uses them. Raises CesError if the data hold too little, or if recordings have seconds in common.
    """
    require_distinct(recordings, validation)
    options = options or IdentifyOptions()
    identified = [without_spikes(one.part(0.0, options.share(validation))) for one in recordings]
    motion = choose_motion(recordings, options.speed)
    sampling = choose_sampling(identified, options.rate, options.delay, motion)
    return _identify_at(sampling, recordings, validation, options, listener, fitter)


def _cost_row(e: Evaluation) -> dict[str, Any]:
    return {"recording": e.name, "role": e.role, "J": round(e.cost, 4) if np.isfinite(e.cost) else None}


def _identify_at(
    sampling: Sampling,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    options: IdentifyOptions,
    listener: Listener,
    fitter: Fitter,
) -> IdentificationResult:
    """Identify a model on the samples as `sampling` has them, with its delay."""
    split = options.share(validation)
    whole = [prepare(without_spikes(r, split), sampling, has_spikes=False) for r in recordings]
    identified = [series.part(0.0, split) for series in whole]
    total = sum(map(len, identified))
    every, everything = -(-total // TickLimits.MAX) if total > TickLimits.ALL else 1, identified
    identified = [series.thin(every) for series in identified]
    thinned = sum(map(len, identified)) < total
    if (scored := sum(int(series.scored.sum()) for series in identified)) < TickLimits.MIN_SCORED:
        text = f"{scored} ticks with a measured force past warm-up; expected at least {TickLimits.MIN_SCORED}"
        raise RecordingError(f"{', '.join(s.name for s in whole)}: {text}: record longer (are the times in s?)")
    fitted = fitter(identified, sampling, options, listener)
    require_shown_cost(fitted, identified, options)
    how = fitted.refit, fitted.leave_out_recordings, options.limits.threads
    band = fit_band(fitted.model, identified, *how) if options.band else None
    model = replace(with_forgetting(fitted.model, identified, options.forget), band=band)
    rest = [series.part(split, 1.0) for series in whole] if split < 1.0 else []
    held_out = [series for series in rest if series.scored.sum() >= TickLimits.MIN_SCORED]
    held_out += [prepare(recording, sampling) for recording in validation]
    evaluations = evaluate(model, everything, IDENTIFICATION) + evaluate(model, held_out, VALIDATION)
    provenance = {
        "tool": f"ces_observer {__version__}",
        "identification": [
            _describe_origin(r) | {"share": [0.0, split], "marks": " ".join(marks_of_copies(r.part(0.0, split)))}
            for r in recordings
        ],
        "validation": [_describe_origin(r) for r in validation],
        "usage": usage(identified, held_out),
        "usage_rule": RULE,
        COSTS: [_cost_row(e) for e in evaluations],
        "selection": {
            **fitted.how,
            "starts": options.limits.starts,
            "starts_with_model": count_starts(fitted.results),
            "first_seed": options.limits.seed,
            "best_seed": fitted.results[0].seed,
            **({"seconds": round(options.limits.time, 3)} if np.isfinite(options.limits.time) else {}),
            "trials": sum(result.trials for result in fitted.results),
            "ended": fitted.results[0].ended,
            **({"weights": str(options.weight)} if options.weight else {}),
            **({STRETCHES: f"one minute in {every} of these long recordings"} if thinned else {}),
        },
    }
    return IdentificationResult(replace(model, provenance=provenance), tuple(evaluations), tuple(fitted.results))


def require_shown_cost(fitted: Fitted, series: Sequence[Series], options: IdentifyOptions) -> None:
    """Raise CesError if the model's free run is worse, on all selection ticks, than the search said of it."""
    training = build_training(series, options.weight)
    cost = training.cost(run_batch(fitted.model, training.inputs, training.segments)[0], training.selection)
    shown = fitted.results[0].cost
    if not cost <= ResultLimits.AGREEMENT * shown + ResultLimits.AGREEMENT_J:
        raise CesError(
            f"the search showed J {shown:.2f} %, and its model has {cost:.2f} % on the same seconds: its fit leaves "
            "out some of them; take another structure, and report this"
        )


def with_forgetting(model: Model, series: Sequence[Series], forget_s: float) -> Model:
    """Return a certified model with how it forgets its start; raises CesError if it does not, in `forget_s`."""
    if model.certificate is None:
        return model
    measured = find_forgetting(model, series, forget_s, run_batch)
    if not (measured.suffices or model.body.keeps_past):
        raise CesError(
            f"the model does not forget where it was started: {measured.describe()}; --forget {2.0 * forget_s:g} "
            "allows it more time; or take another structure"
        )
    facts = {"forgetting": measured.to_mapping()} if measured.pasts else {}
    return replace(model, certificate={**model.certificate, **facts}, settles_s=measured.settles_s)


def count_starts(results: Sequence[SearchResult]) -> int:
    """Return the number of starts among the results; a start may have several."""
    return len({result.seed for result in results})


def _describe_origin(recording: Recording) -> dict[str, str]:
    return {"recording": recording.name, "sha256": recording.sha256}
