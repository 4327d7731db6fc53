"""Models compared on the same recordings: costs, differences, what each model is; in figures, sentences and JSON."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.checks.content import require_once
from ces_data.reading import import_pandas, import_pyplot
from ces_data.recording import Recording
from ces_identify.comparison.compared_models import (
    TEST,
    TRAINED,
    UNKNOWN,
    AlignedRecording,
    ComparedModel,
    Difference,
    PairResult,
    align,
    compare_pairs,
    pooled_costs,
)
from ces_identify.limits import ComparisonLimits
from ces_identify.validation.cost_table import NONE
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, CostInterval, ScoredTicks, interval_of_ticks
from ces_observer.errors import CesError
from ces_report.table import PrintedResult, PrintedResults
from ces_report.typesetting import join_with

ROLES = {TRAINED: IDENTIFICATION, TEST: VALIDATION, UNKNOWN: "unknown"}
MAX_DRAWN = 8  # models in charts, which have so many colours
MAX_LINES = 84  # in the charts of all recordings together, so that the page stays below 3 MB


@dataclass(frozen=True)
class RecordingCost:
    """The cost J [%] of a model on a recording, infinite if it diverged; its `interval`, None if too short.

    `use` says whether the model was identified on the recording (TRAINED), not (TEST), or that is not known.
    """

    recording: str
    cost: float
    rms_N: float
    interval: CostInterval | None
    use: str


@dataclass(frozen=True)
class ModelResult:
    """One model's costs J [%] on each recording, and `pooled` over those on which no model was identified, else all.

    `force_bound_N` is None for a simulation that is not a model, and where stability is not proved.
    """

    name: str
    model: ComparedModel = field(repr=False)
    costs: tuple[RecordingCost, ...]
    pooled: float
    pooled_interval: CostInterval | None
    force_bound_N: float | None

    @property
    def facts(self) -> tuple[str, str, str]:
        """Size, rate [Hz] and delay [ms] of a model, as texts; dashes for a simulation that is not a model."""
        model = self.model.model
        if model is None:
            return "no model file", NONE, NONE
        return model.size, f"{model.sampling.rate_Hz:g}", f"{1e3 * model.sampling.delay_s:g}"

    @property
    def bound_kN(self) -> str:
        """The bound of the force [kN], as text."""
        return NONE if self.force_bound_N is None else f"{self.force_bound_N / 1000:.4g}"


class Pairs(PrintedResults[PairResult]):
    """Every two models once, with the difference of their costs."""

    def to_frame(self) -> Any:
        """Return a DataFrame: J of the first model minus that of the second [%], with its interval, and the verdict."""
        rows = [
            {
                "first": pair.names[0],
                "second": pair.names[1],
                "difference_percent": pair.pooled.value,
                "low_percent": math.nan if pair.pooled.low is None else pair.pooled.low,
                "high_percent": math.nan if pair.pooled.high is None else pair.pooled.high,
                "p_value": math.nan if pair.p_value is None else pair.p_value,
                "verdict": pair.verdict,
                "better": "" if pair.better is None else pair.names[pair.better != pair.first],
            }
            for pair in self
        ]
        return import_pandas().DataFrame(rows)


@dataclass(frozen=True, repr=False)
class Comparison(PrintedResult):
    """Models on the same recordings. `pairs` holds every two models once."""

    models: tuple[ModelResult, ...]
    recordings: tuple[AlignedRecording, ...]
    pairs: Pairs

    @property
    def test_names(self) -> tuple[str, ...]:
        """Recordings on which no model was identified."""
        return tuple(
            r.name for i, r in enumerate(self.recordings) if all(model.costs[i].use != TRAINED for model in self.models)
        )

    @property
    def drawn(self) -> tuple[int, ...]:
        """Models that charts show: all of up to MAX_DRAWN, else those of the lowest pooled cost, in their order."""
        return tuple(sorted(self.by_cost[:MAX_DRAWN]))

    @property
    def drawn_recordings(self) -> tuple[int, ...]:
        """Recordings that charts show: as many as MAX_LINES allow, at least one, tests first, in their order."""
        count = max(1, MAX_LINES // (2 + 4 * len(self.drawn)))
        numbers = range(len(self.recordings))
        tests_first = sorted(numbers, key=lambda n: self.recordings[n].name not in self.test_names)
        return tuple(sorted(tests_first[:count]))

    @property
    def by_cost(self) -> list[int]:
        """Models, the lowest pooled cost first."""
        return sorted(range(len(self.models)), key=lambda i: self.models[i].pooled)

    @property
    def best(self) -> int:
        """The model of the lowest pooled cost."""
        return self.by_cost[0]

    def to_frame(self) -> Any:
        """Return the costs as a DataFrame, a row for each model and recording: J with its interval [%]."""
        rows = [
            {
                "model": one.name,
                "recording": cost.recording,
                "J_percent": cost.cost,
                "low_percent": cost.interval.low if cost.interval else math.nan,
                "high_percent": cost.interval.high if cost.interval else math.nan,
                "rms_N": cost.rms_N,
                "role": ROLES[cost.use],
            }
            for one in self.models
            for cost in one.costs
        ]
        return import_pandas().DataFrame(rows)

    def plot(self) -> Any:
        """Return a matplotlib figure: measured and all simulated forces over time, the costs J in the legend."""
        figure, rows = import_pyplot().subplots(
            len(self.recordings), figsize=(11, 4 * len(self.recordings)), squeeze=False, layout="constrained"
        )
        for n, (recording, axes) in enumerate(zip(self.recordings, rows[:, 0], strict=True)):
            axes.plot(recording.time_s, recording.measured, color="0.3", linewidth=1.0, label="measured")
            for one, force in zip(self.models, recording.forces, strict=True):
                name = f"{one.name}: J = {one.costs[n].cost:.1f} %"
                axes.plot(recording.time_s, force, linewidth=1.0, label=name)
            axes.set(xlabel="Time [s]", ylabel="Force [N]", title=recording.name)
            axes.grid(alpha=0.3)
            axes.legend(loc="upper right")
        return figure

    def pair(self, first: int, second: int) -> PairResult:
        """Return the comparison of two models, whichever comes first."""
        return next(p for p in self.pairs if {p.first, p.second} == {first, second})

    def outside_percent(self, model: int) -> str:
        """Return the largest share [%] of a recording's ticks with some signal outside a model's envelope, as text."""
        shares = [max((use.outside_share for use in r.exits[model]), default=0.0) for r in self.recordings]
        return NONE if self.models[model].model.model is None else f"{100 * max(shares):.1f}"

    def above_lowest(self, model: int) -> Difference | None:
        """Return how much higher the pooled cost of `model` is than the lowest; None if that is not a test."""
        difference = self.pair(self.best, model).minus(self.best) if self.test_names and model != self.best else None
        return None if difference is None or not math.isfinite(difference.value) else difference

    def notes(self) -> list[str]:
        """Return what a reader must know before believing the costs, one sentence each."""
        return [*_training_notes(self), *_exit_notes(self), *_divergence_notes(self)]

    def notes_on_charts(self) -> list[str]:
        """Return which models and recordings the charts leave out."""
        models = [model.name for i, model in enumerate(self.models) if i not in self.drawn]
        recordings = [recording.name for n, recording in enumerate(self.recordings) if n not in self.drawn_recordings]
        notes = []
        if models:
            notes.append(
                f"charts show the {MAX_DRAWN} models of the lowest cost, the tables all {len(self.models)}; not in the "
                f"charts: {join_with(models)}"
            )
        if recordings:
            notes.append(
                f"charts show {len(self.drawn_recordings)} of {len(self.recordings)} recordings, the tables all; "
                f"not in the charts: {join_with(recordings)}"
            )
        return notes


def compare(
    models: Sequence[ComparedModel],
    recordings: Sequence[Recording],
    *,
    announce: Callable[[str], None] = lambda step: None,
) -> Comparison:
    """Run all models over all recordings and compare them.

    `announce` is called with each step before it begins.

    Raises CesError for fewer than two models, equal names, or recordings without a force.
    """
    if not 2 <= len(models) <= ComparisonLimits.MAX_MODELS:
        raise CesError(f"models: {len(models)} given; expected 2 to {ComparisonLimits.MAX_MODELS}")
    names = [model.name for model in models]
    if len(set(names)) < len(names):
        raise CesError(f"two models are named '{max(names, key=names.count)}'; give each a name of its own")
    if not recordings:
        raise CesError("no recording to compare on")
    require_once(recordings)
    aligned = []
    for n, recording in enumerate(recordings, 1):
        announce(f"simulating {recording.name} with {len(models)} models ({n} of {len(recordings)} recordings)")
        aligned.append(align(models, recording))
    announce("comparing")
    uses = [[model.use_of(recording) for recording in recordings] for model in models]
    results, pairs = score_models(models, aligned, uses), compare_pairs(names, aligned, uses)
    return Comparison(tuple(results), tuple(aligned), Pairs(pairs))


def name_sources(sources: Sequence[str]) -> list[str]:
    """Return a name for each path or specification: the file's stem, with its folders where stems are equal."""

    def end_of(source: str, depth: int) -> str:
        path = Path(source)
        last = path.stem if path.suffix in (".json", ".yaml", ".yml") else path.name
        return "/".join([*path.parts[-depth:-1], last])

    names = []
    for source in sources:
        others = [other for other in sources if other != source]
        depths = (n for n in range(1, 6) if all(end_of(source, n) != end_of(other, n) for other in others))
        names.append(end_of(source, next(depths, 5)))
    return names


def score_models(
    models: Sequence[ComparedModel],
    aligned: Sequence[AlignedRecording],
    uses: Sequence[Sequence[str]],
) -> list[ModelResult]:
    """Return the costs of each model; `uses` says what it did with each recording."""
    tests = [r for i, r in enumerate(aligned) if all(use[i] != TRAINED for use in uses)] or list(aligned)
    pooled, each = pooled_costs(tests), [pooled_costs([recording]) for recording in aligned]
    results = []
    for i, model in enumerate(models):
        costs = tuple(
            RecordingCost(r.name, _finite(cost[i]), float(np.sqrt(np.mean(r.errors[i] ** 2))), _interval(i, [r]), use)
            for r, cost, use in zip(aligned, each, uses[i], strict=True)
        )
        certificate = (model.model.certificate if model.model is not None else None) or {}
        bound = certificate.get("force_bound_N")
        bound_N = float(bound) if isinstance(bound, int | float) else None
        result = ModelResult(model.name, model, costs, _finite(pooled[i]), _interval(i, tests), bound_N)
        results.append(result)
    return results


def _finite(cost: float) -> float:
    return float(cost) if np.isfinite(cost) else float("inf")


def _interval(i: int, recordings: Sequence[AlignedRecording]) -> CostInterval | None:
    """Return the interval of the model's pooled J, None if it diverged or a recording is too short."""
    if any(r.diverged[i] for r in recordings):
        return None
    return interval_of_ticks([ScoredTicks(r.errors[i] ** 2, r.measured[r.scored], r.rate_Hz) for r in recordings])


def _training_notes(comparison: Comparison) -> list[str]:
    """Return where a cost is not a test, and for which models that is not known."""
    by_recording: dict[str, list[str]] = {}
    for model in comparison.models:
        for cost in model.costs:
            if cost.use == TRAINED:
                by_recording.setdefault(cost.recording, []).append(model.name)
    notes = [
        f"{join_with(names)} {_was(names)} identified on {recording}; {'its' if len(names) == 1 else 'their'} cost "
        "there is not a test"
        for recording, names in by_recording.items()
    ]
    unknown = [m.name for m in comparison.models if any(cost.use == UNKNOWN for cost in m.costs)]
    if unknown:
        notes.append(
            f"no file says what {join_with(unknown)} {_was(unknown)} identified on; whether these recordings are a "
            "test is not known"
        )
    return notes


def _exit_notes(comparison: Comparison) -> list[str]:
    """Return where recordings leave the envelopes of models, models and recordings of equal ranges together."""
    by_recording: dict[tuple[str, str], list[str]] = {}
    for recording in comparison.recordings:
        for model, exits in zip(comparison.models, recording.exits, strict=True):
            if exits:
                share = f"for {100 * exits[0].outside_share:.1f} % of the time"
                ranges = f"{share}: {'; '.join(map(str, exits))}"
                by_recording.setdefault((recording.name, ranges), []).append(model.name)
    groups: dict[tuple[str, str], list[str]] = {}
    for (recording_name, ranges), names in by_recording.items():
        models = "all models" if len(names) == len(comparison.models) > 2 else join_with(names)
        groups.setdefault((models, ranges), []).append(recording_name)
    return [
        f"{join_with(names)} {'leaves' if len(names) == 1 else 'leave'} the envelope of {models} {ranges}"
        for (models, ranges), names in groups.items()
    ]


def _divergence_notes(comparison: Comparison) -> Iterator[str]:
    """Yield where models have no cost, or one with a force held at its envelope."""
    other = f"diverged, to more than {ComparisonLimits.MAX_RATIO:g} times the measured force,"
    for recording in comparison.recordings:
        for model, lost in zip(comparison.models, recording.diverged, strict=True):
            if lost:
                how = other if model.model.model is None else "has a force that is not finite"
                yield f"{model.name} {how} on {recording.name}: it has no cost there"
        for model, text in zip(comparison.models, recording.holds, strict=False):
            if text:
                yield f"{model.name}, {text}"


def _was(names: Sequence[str]) -> str:
    return "was" if len(names) == 1 else "were"
