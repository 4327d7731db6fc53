"""Identification from end to end: recordings in, a model with its costs out.

The steps: sampling from the positions, preparation, fit of a structure, and evaluation on held-out data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_identify.polynomial.search_limits import Listener, SearchResult
from ces_identify.preparation.sampling import choose_sampling
from ces_identify.preparation.series import Series, prepare
from ces_identify.recordings.recording import Recording
from ces_identify.sense.content import marks_of_copies, require_distinct
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.validation.band_fit import fit_band
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, evaluate
from ces_identify.validation.usage import RULE, usage
from ces_observer import __version__
from ces_observer.band import Band
from ces_observer.model import Model

MIN_SCORED_TICKS = 50  # of a held-out part, for an evaluation


@dataclass(frozen=True)
class IdentificationResult:
    """A model, its evaluations (identification first) and the results of all starts, best first."""

    model: Model
    evaluations: tuple[Evaluation, ...]
    search_results: tuple[SearchResult, ...]

    def with_forced(self, findings: Sequence[str]) -> IdentificationResult:
        """Return the result with the findings in spite of which it was identified in the model's provenance."""
        if not findings:
            return self
        return replace(self, model=replace(self.model, provenance={**self.model.provenance, "forced": list(findings)}))


def identify(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    options: IdentifyOptions | None = None,
    listener: Listener = lambda result: None,
    fitter: Fitter = fit_polynomial,
) -> IdentificationResult:
    """Identify a model on the first `options.split` of every recording with the structure's `fitter`.

    Validation data are the rest of the recordings and all of the `validation` recordings; neither fit nor selection
    uses them. Raises CesError if the data hold too little, or if recordings have seconds in common.
    """
    require_distinct(recordings, validation)
    options = options or IdentifyOptions()
    first_parts = [recording.first_part(options.split) for recording in recordings]
    sampling = choose_sampling(
        first_parts, options.rate_Hz, options.bandwidth_Hz, differentiator=options.differentiator
    )
    whole = [prepare(recording, sampling) for recording in recordings]
    identified = [series.part(0.0, options.split) for series in whole]
    fitted = fitter(identified, sampling, options, listener)
    model = replace(fitted.model, band=_fit_band(fitted, identified) if options.band else None)
    held_out = _select_held_out(whole, options.split) + [prepare(recording, sampling) for recording in validation]
    evaluations = evaluate(model, identified, IDENTIFICATION) + evaluate(model, held_out, VALIDATION)
    provenance = {
        "tool": f"ces_observer {__version__}",
        "identification": [_describe_origin(r) | _describe_part(r, options.split) for r in recordings],
        "validation": [_describe_origin(r) for r in validation],
        "usage": usage(identified, held_out),
        "usage_rule": RULE,
        "cost_J_percent": [
            {"recording": e.name, "role": e.role, "J": round(e.cost, 4) if np.isfinite(e.cost) else None}
            for e in evaluations
        ],
        "selection": {**fitted.how, **_describe_search(fitted.results, options)},
    }
    return IdentificationResult(replace(model, provenance=provenance), tuple(evaluations), tuple(fitted.results))


def _fit_band(fitted: Fitted, identified: Sequence[Series]) -> Band | None:
    return fit_band(fitted.model, identified, fitted.refit, fitted.leave_out_recordings)


def _describe_search(results: Sequence[SearchResult], options: IdentifyOptions) -> dict[str, Any]:
    facts = {
        "starts": options.limits.starts,
        "starts_with_model": count_starts(results),
        "first_seed": options.limits.seed,
        "best_seed": results[0].seed,
        "seconds": options.limits.seconds,
        "trials": sum(result.trials for result in results),
        "ended": results[0].ended,
    }
    return facts | ({"weights": str(options.weighting)} if options.weighting else {})


def count_starts(results: Sequence[SearchResult]) -> int:
    """Return the number of starts among the results; a start may have several."""
    return len({result.seed for result in results})


def _select_held_out(whole: Sequence[Series], split: float) -> list[Series]:
    """Return the rest of each series after `split` that is long enough for an evaluation."""
    rest = [series.part(split, 1.0) for series in whole] if split < 1.0 else []
    return [series for series in rest if series.scored.sum() >= MIN_SCORED_TICKS]


def _describe_part(recording: Recording, split: float) -> dict[str, Any]:
    """Return which part of a recording is used, and marks by which any copy of it is recognised."""
    return {"share": [0.0, split], "marks": " ".join(marks_of_copies(recording.first_part(split)))}


def _describe_origin(recording: Recording) -> dict[str, str]:
    return {"recording": recording.name, "sha256": recording.sha256}
