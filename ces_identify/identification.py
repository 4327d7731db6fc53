"""Identification from end to end, and with data left out: recordings in, a model with its costs out.

The steps: sampling from the positions, preparation, fit of a structure, and evaluation on held-out data.

Cross-validation holds each fold out once and evaluates a model identified on the others on it. A single recording is
cut into as many stretches as folds; the parts before and after a held-out stretch become two recordings, so that no
model runs across the cut.

A model is closer to the recordings that it was fitted to than to others. The error that it makes on recordings like
these is that of models that have not seen them: `cross_fit` identifies one model on all recordings, and fits it again
without each recording, or without stretches of a single one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from ces_data.arrays import F, Mask
from ces_data.checks.content import marks_of_copies, require_distinct
from ces_data.findings import WRONG_MODEL, Finding
from ces_data.recording import Recording
from ces_data.samples import without_spikes
from ces_identify.limits import FoldLimits, ResultLimits, TickLimits
from ces_identify.numerics.correlation import noise_rms
from ces_identify.numerics.search import INTERRUPTED, TIME_IS_UP, Listener, SearchResult, clock_s
from ces_identify.prepare.sampling import choose_motion, choose_sampling
from ces_identify.prepare.series import Series, prepare
from ces_identify.structures import run_batch
from ces_identify.structures.forgetting import find_forgetting
from ces_identify.structures.kit import Fitted, Fitter, IdentifyOptions
from ces_identify.structures.polynomial import fit_polynomial
from ces_identify.training import build_training
from ces_identify.validation.band import fit_band, masks_by_recording, masks_by_stretch
from ces_identify.validation.cost_table import COSTS, RULE, usage
from ces_identify.validation.evaluate import (
    IDENTIFICATION,
    VALIDATION,
    CostInterval,
    Evaluation,
    cost_interval,
    evaluate,
    pooled_cost,
)
from ces_observer import __version__
from ces_observer.errors import CesError, OptionName, RecordingError
from ces_observer.model import Model, Sampling
from ces_observer.structures.polynomial import Polynomial

UNLIKE_FORCE = "the force does not follow these signals: check that topics, signs and damper are the right ones"
FIT_SHARE = 0.9  # of a time limit, until there is a model; band, proofs and evaluation have the rest
THINNED = "identified_on"  # key of the provenance


@dataclass(frozen=True, repr=False)
class IdentificationResult:
    """A model, its evaluations (identification first) and the results of all starts, best first."""

    model: Model
    evaluations: tuple[Evaluation, ...]
    search_results: tuple[SearchResult, ...]

    @property
    def starts(self) -> int:
        """Number of starts that gave a model; a start may have several results."""
        return len({result.seed for result in self.search_results})

    def require_explained(
        self, findings: Sequence[Finding] = (), ignore_findings: bool = False
    ) -> IdentificationResult:
        """Return the result with the findings in spite of which it was identified in the model's provenance.

        `findings` are those of the checks. Raises RecordingError if the model explains nothing of the force that it was
        fitted to, unless `ignore_findings`.
        """
        failure = self._describe_failure()
        reasons = [f.text for f in findings if f.signal != "current"] or [UNLIKE_FORCE]
        if failure and not ignore_findings:
            keep = OptionName("ignore_findings", True)
            raise RecordingError(*self._describe_end(), f"{failure}; {reasons[0]}; ", keep, " keeps such a model")
        forced = [f.text for f in findings if f.severity == WRONG_MODEL] + [failure] * bool(failure)
        if not forced:
            return self
        return replace(self, model=replace(self.model, provenance={**self.model.provenance, "forced": forced}))

    def _describe_end(self) -> tuple[str | OptionName, ...]:
        """Return that the search had too little time, for the begin of an error."""
        if not any(result.ended == TIME_IS_UP for result in self.search_results):
            return ()
        seconds = self.model.provenance["selection"].get("seconds", 0.0)
        return f"the search was stopped after {seconds:.3g} s; give it more ", OptionName("time"), ": "

    def _describe_failure(self) -> str:
        """Return what shows that the model explains nothing; '' if it does, or for an interrupted or weighted fit."""
        fitted = [e for e in self.evaluations if e.role == IDENTIFICATION]
        stopped = any(result.ended == INTERRUPTED for result in self.search_results)
        if stopped or "weights" in self.model.provenance["selection"]:
            return ""
        cost = pooled_cost(fitted)
        forces = [e.series.force[e.series.scored] for e in fitted]
        noise = max(noise_rms(force) / float(force.std()) for force in forces)
        if not cost**2 < ResultLimits.UNEXPLAINED_J**2 + (100.0 * noise) ** 2:
            return f"the model explains nothing of the force: J is {cost:.1f} % on the data that it was fitted to"
        if cost > ResultLimits.WITHOUT_SPEED_J and not _follows_motion(self.model):
            return f"no term of the model follows the motion, and J is {cost:.1f} % on the data that it was fitted to"
        return ""


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
    options = options or IdentifyOptions()
    end_s = clock_s() + options.limits.time
    require_distinct(recordings, validation)
    listener("preparing the recordings")
    identified = [without_spikes(recording.share(0.0, options.share(validation))) for recording in recordings]
    motion = choose_motion(recordings, options.speed)
    sampling = choose_sampling(identified, options.rate, options.delay, motion)
    return _identify_at(sampling, recordings, validation, options, listener, fitter, end_s)


def _cost_row(e: Evaluation) -> dict[str, Any]:
    """Return what the model file says of an evaluation, in percent and N; None where it is not known."""
    low, high = (e.interval.low, e.interval.high) if e.interval else (None, None)
    coverage = None if e.coverage is None else 100.0 * e.coverage
    known = {
        "scored_s": e.scored_s,
        "J": e.cost,
        "low": low,
        "high": high,
        "rms_N": e.rms_N,
        "outside": 100.0 * e.outside_share,
        "band": coverage,
    }
    finite = {key: round(v, 4) if v is not None and np.isfinite(v) else None for key, v in known.items()}
    return {"recording": e.name, "role": e.role, **finite}


def _identify_at(
    sampling: Sampling,
    recordings: Sequence[Recording],
    validation: Sequence[Recording],
    options: IdentifyOptions,
    listener: Listener,
    fitter: Fitter,
    end_s: float,
) -> IdentificationResult:
    """Identify a model on the samples as `sampling` has them, with its delay, until `end_s` of `clock_s`."""
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
    limited = replace(options, limits=options.limits.within(end_s, FIT_SHARE))
    fitted = fitter(identified, sampling, limited, listener)
    require_shown_cost(fitted, identified, options)
    listener("fitting the band")
    how = fitted.refit, fitted.leave_out_recordings, options.limits.threads
    band = fit_band(fitted.model, identified, *how) if options.band else None
    model = replace(with_forgetting(fitted.model, identified, options.forget), band=band)
    listener("evaluating the model")
    later = [series.part(split, 1.0) for series in whole] if split < 1.0 else []
    held_out = [series for series in later if series.scored.sum() >= TickLimits.MIN_SCORED]
    held_out += [prepare(recording, sampling) for recording in validation]
    evaluations = evaluate(model, everything, IDENTIFICATION) + evaluate(model, held_out, VALIDATION)
    provenance = {
        "tool": f"ces_observer {__version__}",
        "identification": [
            _describe_origin(r) | {"share": [0.0, split], "marks": " ".join(marks_of_copies(r.share(0.0, split)))}
            for r in recordings
        ],
        "validation": [_describe_origin(r) for r in validation],
        "usage": usage(identified, held_out),
        "usage_rule": RULE,
        COSTS: [_cost_row(e) for e in evaluations],
        "selection": {
            **fitted.how,
            "starts": options.limits.starts,
            "starts_with_model": len({start.seed for start in fitted.results}),
            "first_seed": options.limits.seed,
            "best_seed": fitted.results[0].seed,
            **({"seconds": round(options.limits.time, 3)} if np.isfinite(options.limits.time) else {}),
            "trials": sum(result.trials for result in fitted.results),
            "ended": fitted.results[0].ended,
            **({"weights": str(options.weight)} if options.weight else {}),
            **({THINNED: f"one minute in {every} of these long recordings"} if thinned else {}),
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
            f"the model does not forget where it was started: {measured.describe()}; ",
            OptionName("forget", 2.0 * forget_s),
            " allows it more time; or take another structure",
        )
    facts = {"forgetting": measured.to_mapping()} if measured.pasts else {}
    return replace(model, certificate={**model.certificate, **facts}, settles_s=measured.settles_s)


def _describe_origin(recording: Recording) -> dict[str, str]:
    day = {"day": recording.day} if recording.day else {}
    return {"recording": recording.name, "sha256": recording.sha256, **day}


Identifier = Callable[[Sequence[Recording], Sequence[Recording], IdentifyOptions], IdentificationResult]


@dataclass(frozen=True)
class Fold:
    """Recordings for identification, and those held out."""

    identification: tuple[Recording, ...]
    held_out: tuple[Recording, ...]


@dataclass(frozen=True)
class HeldOutCost:
    """A held-out recording: its fold, the cost J [%] and its interval, and the size of the model."""

    fold: int
    recording: str
    cost: float
    interval: CostInterval | None
    model: str


@dataclass(frozen=True)
class CrossValidation:
    """The held-out costs of all recordings."""

    rows: tuple[HeldOutCost, ...]

    @property
    def mean(self) -> float:
        """Mean J [%] over the recordings; infinite if a free run diverged."""
        return float(np.mean([row.cost for row in self.rows]))

    @property
    def spread(self) -> float:
        """Standard deviation (n - 1) of J [%]; infinite after a divergence. No error of the mean: folds share data."""
        costs = [row.cost for row in self.rows]
        return float(np.std(costs, ddof=1)) if np.isfinite(costs).all() else float("inf")


def cross_validate(
    recordings: Sequence[Recording], folds: int, identify: Identifier, options: IdentifyOptions
) -> CrossValidation:
    """Return the held-out costs of `folds` identifications; raises CesError, also for too few recordings."""
    options, rows = replace(options, split=1.0), []
    for number, fold in enumerate(split_folds(recordings, folds), 1):
        result = identify(fold.identification, fold.held_out, options)
        tests = (e for e in result.evaluations if e.role == VALIDATION)
        rows += [HeldOutCost(number, e.name, e.cost, cost_interval([e]), result.model.size) for e in tests]
    return CrossValidation(tuple(rows))


def split_folds(recordings: Sequence[Recording], folds: int) -> list[Fold]:
    """Return the folds: recordings in turn, or stretches of a single one. Raises CesError if there are too few."""
    if folds < 2:
        raise CesError(OptionName("folds", folds), ": expected at least 2")
    if len(recordings) == 1:
        return list(_cut_into_folds(recordings[0], folds))
    if folds > len(recordings):
        raise CesError(
            OptionName("folds", folds),
            f": {len(recordings)} recordings; expected at most as many folds (or a single recording, which is cut into "
            "stretches)",
        )
    numbered = list(enumerate(recordings))
    return [
        Fold(tuple(r for i, r in numbered if i % folds != k), tuple(r for i, r in numbered if i % folds == k))
        for k in range(folds)
    ]


def cut_recording(recording: Recording, start_ns: int, stop_ns: int) -> Recording:
    """Return the samples with stamps from `start_ns` up to `stop_ns` as a recording."""
    origin = int(recording.channel("position").stamps_ns.min())
    name = f"{recording.name} {(start_ns - origin) * 1e-9:.1f}-{(stop_ns - origin) * 1e-9:.1f} s"
    return replace(recording.between(start_ns, stop_ns), name=name)


def _cut_into_folds(recording: Recording, folds: int) -> Iterator[Fold]:
    stamps = recording.channel("position").stamps_ns
    edges = np.linspace(stamps.min(), stamps.max() + 1, folds + 1).round().astype(np.int64).tolist()
    if edges[1] - edges[0] < FoldLimits.MIN_STRETCH_S * 1e9:
        raise CesError(
            OptionName("folds", folds),
            f": {recording.name} gives stretches of {(edges[1] - edges[0]) * 1e-9:.2f} s; expected at least "
            f"{FoldLimits.MIN_STRETCH_S:g} s; use fewer folds",
        )
    for a, b in pairwise(edges):
        kept = [cut_recording(recording, *span) for span in ((edges[0], a), (b, edges[-1])) if span[0] < span[1]]
        yield Fold(tuple(kept), (cut_recording(recording, a, b),))


@dataclass(frozen=True)
class LeftOutPart:
    """A part of a recording (index), from `start_s` to `stop_s` after its first position sample, unseen by `model`."""

    recording: int
    start_s: float
    stop_s: float
    model: Model


@dataclass(frozen=True)
class CrossFit:
    """A model identified on all recordings, and `models` that have not seen some `parts` of them."""

    result: IdentificationResult
    parts: tuple[LeftOutPart, ...]
    models: tuple[Model, ...]


def cross_fit(
    recordings: Sequence[Recording], options: IdentifyOptions, listener: Listener, fitter: Fitter
) -> CrossFit:
    """Return a model of all recordings, and its refits without each part in turn (none failed); raises CesError."""
    kept: list[tuple[Fitted, Sequence[Series]]] = []

    def keep(series: Sequence[Series], sampling: Sampling, how: IdentifyOptions, listen: Listener) -> Fitted:
        kept.append((fitter(series, sampling, how, listen), series))
        return kept[-1][0]

    result = identify(recordings, (), replace(options, split=1.0), listener, keep)
    fitted, series = kept[-1]
    masks = masks_by_stretch(series) if len(series) == 1 else masks_by_recording(series, FoldLimits.MAX_PARTS)
    with ThreadPoolExecutor(max(1, options.limits.threads)) as pool:
        left_out = list(pool.map(partial(_leave_out, fitted, series), masks))
    parts = tuple(part for group in left_out for part in group)
    return CrossFit(result, parts, tuple(group[0].model for group in left_out if group))


def _leave_out(fitted: Fitted, series: Sequence[Series], masks: Sequence[Mask]) -> list[LeftOutPart]:
    weights: F = np.where(np.concatenate(masks), 0.0, 1.0)
    model = fitted.refit(weights) if fitted.refit is not None else None
    if model is None:
        return []
    parts = []
    for i, (recorded, mask) in enumerate(zip(series, masks, strict=True)):
        if mask.any():  # a part reaches to infinity at the ends of its recording
            start_s = -np.inf if mask[0] else float(recorded.time_s[mask][0])
            stop_s = np.inf if mask[-1] else float(recorded.time_s[mask][-1]) + 1.0 / recorded.rate_Hz
            parts.append(LeftOutPart(i, start_s, stop_s, model))
    return parts
