"""Identification from end to end: recordings in, a model with its costs out.

Sampling from the positions, preparation, the fit of a structure, and evaluation on what the fit has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_identify.polynomial.limits import Limits, Listener, SearchResult
from ces_identify.preparation.sampling import choose_sampling
from ces_identify.preparation.series import Series, prepare
from ces_identify.preparation.weighting import Weighting
from ces_identify.recordings.recording import Recording
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, evaluate
from ces_identify.validation.usage import RULE, usage
from ces_observer import __version__
from ces_observer.model import Model

MIN_SCORED_TICKS = 50  # ticks of a held-out part worth judging


@dataclass(frozen=True)
class IdentificationResult:
    """A model, its evaluations (identification first, then validation) and what every start found, best first."""

    model: Model
    evaluations: tuple[Evaluation, ...]
    search_results: tuple[SearchResult, ...]


def identify(
    recordings: Sequence[Recording],
    validation: Sequence[Recording] = (),
    options: IdentifyOptions | None = None,
    listener: Listener = lambda found: None,
    fitter: Fitter = fit_polynomial,
) -> IdentificationResult:
    """Identify a model on the first `options.split` of every recording; `fitter` fits the structure wanted.

    It is validated on the rest of them and on the whole of the `validation` recordings, which neither the fit nor the
    selection sees. Raises CesError if the data hold too little.
    """
    options = options or IdentifyOptions()
    seen_positions = [recording.first_part(options.split) for recording in recordings]
    sampling = choose_sampling(seen_positions, options.rate_Hz, options.bandwidth_Hz)
    whole = [prepare(recording, sampling) for recording in recordings]
    fitted = fitter([series.part(0.0, options.split) for series in whole], sampling, options, listener)
    return evaluate_model(fitted, (recordings, whole), validation, options)


def evaluate_model(
    fitted: Fitted,
    source: tuple[Sequence[Recording], Sequence[Series]],
    validation: Sequence[Recording],
    options: IdentifyOptions,
) -> IdentificationResult:
    """Return the fitted model with its costs and where it comes from.

    `source` holds the recordings it was identified on and their whole series.
    """
    model, (recordings, whole) = fitted.model, source
    seen = [series.part(0.0, options.split) for series in whole]
    held_out = _select_held_out(whole, options.split) + [prepare(recording, model.sampling) for recording in validation]
    evaluations = evaluate(model, seen, IDENTIFICATION) + evaluate(model, held_out, VALIDATION)
    history = {
        "tool": f"ces_observer {__version__}",
        "identification": [_origin(r) | {"share": [0.0, options.split]} for r in recordings],
        "validation": [_origin(r) for r in validation],
        "usage": usage(seen, held_out),
        "usage_rule": RULE,
        "cost_J_percent": [
            {"recording": e.name, "role": e.role, "J": round(e.cost, 4) if np.isfinite(e.cost) else None}
            for e in evaluations
        ],
        "selection": {
            **fitted.how,
            **_search_facts(fitted.found, options.limits),
            **_describe_weights(options.weighting),
        },
    }
    return IdentificationResult(replace(model, provenance=history), tuple(evaluations), tuple(fitted.found))


def _describe_weights(weighting: Weighting) -> dict[str, str]:
    return {"weights": str(weighting)} if weighting else {}


def _search_facts(found: Sequence[SearchResult], limits: Limits) -> dict[str, Any]:
    return {
        "starts": len(found),
        "first_seed": limits.seed,
        "best_seed": found[0].seed,
        "seconds": limits.seconds,
        "trials": sum(f.trials for f in found),
        "ended": found[0].ended,
    }


def _select_held_out(whole: Sequence[Series], split: float) -> list[Series]:
    """Return the rest of each series after `split`, where it is long enough to be judged."""
    rest = [series.part(split, 1.0) for series in whole] if split < 1.0 else []
    return [series for series in rest if series.scored.sum() >= MIN_SCORED_TICKS]


def _origin(recording: Recording) -> dict[str, str]:
    return {"recording": recording.name, "sha256": recording.sha256}
