"""Models compared on the same recordings: costs, differences between them, and what each model is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ces_identify.comparison.aligned_recording import MAX_RATIO, AlignedRecording, align
from ces_identify.comparison.compared_model import TRAINED, UNKNOWN, ComparedModel
from ces_identify.comparison.difference_errors import pooled_costs
from ces_identify.comparison.pair_results import PairResult, compare_pairs
from ces_identify.comparison.tick_time import TickTime, describe_machine, measure_tick_times
from ces_identify.recordings.recording import Recording
from ces_identify.sense.content import require_once
from ces_identify.validation.cost_interval import CostInterval, ScoredTicks, interval_of_ticks
from ces_observer.errors import CesError

MAX_MODELS = 40
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
    """One model's costs on each recording and over `pooled_over` recordings on which no model was identified.

    If there are none, `pooled` is the cost over all recordings and `pooled_over` is empty. `tick` and `force_bound_N`
    are None for a simulation that is not a model, and the bound where stability is not proved.
    """

    name: str
    model: ComparedModel
    costs: tuple[RecordingCost, ...]
    pooled: float
    pooled_interval: CostInterval | None
    tick: TickTime | None
    force_bound_N: float | None


@dataclass(frozen=True)
class Comparison:
    """Models on the same recordings. `pairs` holds every two models once; `machine` is where ticks were timed."""

    models: tuple[ModelResult, ...]
    recordings: tuple[AlignedRecording, ...]
    pairs: tuple[PairResult, ...]
    part: tuple[float, float]
    machine: str

    @property
    def test_names(self) -> tuple[str, ...]:
        """Recordings on which no model was identified."""
        return tuple(
            r.name for i, r in enumerate(self.recordings) if all(model.costs[i].use != TRAINED for model in self.models)
        )

    @property
    def drawn(self) -> tuple[int, ...]:
        """Models that charts show: all of up to MAX_DRAWN, else those of the lowest pooled cost, in their order."""
        lowest = sorted(range(len(self.models)), key=lambda i: self.models[i].pooled)
        return tuple(sorted(lowest[:MAX_DRAWN]))

    @property
    def drawn_recordings(self) -> tuple[int, ...]:
        """Recordings that charts show: as many as MAX_LINES allow, at least one, tests first, in their order."""
        count = max(1, MAX_LINES // (2 + 4 * len(self.drawn)))
        numbers = range(len(self.recordings))
        first = sorted(numbers, key=lambda n: self.recordings[n].name not in self.test_names)
        return tuple(sorted(first[:count]))

    def pair(self, first: int, second: int) -> PairResult:
        """Return the comparison of two models, whichever comes first."""
        return next(p for p in self.pairs if {p.first, p.second} == {first, second})

    def notes(self) -> list[str]:
        """Return what a reader must know before believing the costs, one sentence each."""
        return [*_training_notes(self), *_exit_notes(self), *_divergence_notes(self)]

    def notes_on_charts(self) -> list[str]:
        """Return which models and recordings the charts leave out."""
        models = [model.name for i, model in enumerate(self.models) if i not in self.drawn]
        recordings = [one.name for n, one in enumerate(self.recordings) if n not in self.drawn_recordings]
        notes = []
        if models:
            notes.append(
                f"charts show the {MAX_DRAWN} models of the lowest cost, the tables all {len(self.models)}; not in the "
                f"charts: {join(models)}"
            )
        if recordings:
            notes.append(
                f"charts show {len(self.drawn_recordings)} of {len(self.recordings)} recordings, the tables all; "
                f"not in the charts: {join(recordings)}"
            )
        return notes


def compare(
    models: Sequence[ComparedModel],
    recordings: Sequence[Recording],
    part: tuple[float, float] = (0.0, 1.0),
    *,
    timing: bool = True,
    announce: Callable[[str], None] = lambda step: None,
) -> Comparison:
    """Run all models over all recordings and compare them; `timing` measures the time of a tick, too.

    `announce` is called with each step before it begins.

    Raises CesError for fewer than two models, equal names, or recordings without a force.
    """
    _require_comparable(models, recordings)
    aligned = []
    for n, recording in enumerate(recordings, 1):
        announce(f"simulating {recording.name} with {len(models)} models ({n} of {len(recordings)} recordings)")
        aligned.append(align(models, recording, part))
    announce("timing and comparing")
    uses = [[model.use_of(recording, part) for recording in recordings] for model in models]
    results = _model_results(models, aligned, uses, _measure(models, recordings[0]) if timing else {})
    pairs = compare_pairs([model.name for model in models], aligned, uses)
    return Comparison(tuple(results), tuple(aligned), tuple(pairs), part, describe_machine() if timing else "")


def _require_comparable(models: Sequence[ComparedModel], recordings: Sequence[Recording]) -> None:
    if not 2 <= len(models) <= MAX_MODELS:
        raise CesError(f"{len(models)} models to compare; expected 2 to {MAX_MODELS}")
    names = [model.name for model in models]
    if len(set(names)) < len(names):
        raise CesError(f"two models are named '{max(names, key=names.count)}'; give each a name of its own")
    if not recordings:
        raise CesError("no recording to compare on")
    require_once(recordings)


def _measure(models: Sequence[ComparedModel], recording: Recording) -> dict[int, TickTime]:
    timed = {i: model.model for i, model in enumerate(models) if model.model is not None}
    return dict(zip(timed, measure_tick_times(list(timed.values()), recording), strict=True))


def _model_results(
    models: Sequence[ComparedModel],
    aligned: Sequence[AlignedRecording],
    uses: Sequence[Sequence[str]],
    ticks: dict[int, TickTime],
) -> list[ModelResult]:
    tests = [r for i, r in enumerate(aligned) if all(use[i] != TRAINED for use in uses)] or list(aligned)
    pooled = pooled_costs(tests)
    return [
        ModelResult(
            name=model.name,
            model=model,
            costs=tuple(_cost(i, r, use) for r, use in zip(aligned, uses[i], strict=True)),
            pooled=_finite_cost(pooled[i]),
            pooled_interval=_interval(i, tests),
            tick=ticks.get(i),
            force_bound_N=_force_bound(model),
        )
        for i, model in enumerate(models)
    ]


def _cost(i: int, recording: AlignedRecording, use: str) -> RecordingCost:
    cost = _finite_cost(pooled_costs([recording])[i])
    rms = float(np.sqrt(np.mean(recording.errors[i] ** 2)))
    return RecordingCost(recording.name, cost, rms, _interval(i, [recording]), use)


def _finite_cost(cost: float) -> float:
    return float(cost) if np.isfinite(cost) else float("inf")


def _interval(i: int, recordings: Sequence[AlignedRecording]) -> CostInterval | None:
    """Return the interval of the model's pooled J, None if it diverged or a recording is too short."""
    if any(r.diverged[i] for r in recordings):
        return None
    return interval_of_ticks([_ticks(i, r) for r in recordings])


def _ticks(i: int, recording: AlignedRecording) -> ScoredTicks:
    return ScoredTicks(recording.errors[i] ** 2, recording.measured[recording.scored], recording.rate_Hz)


def _force_bound(model: ComparedModel) -> float | None:
    certificate = None if model.model is None else model.model.certificate
    bound = None if certificate is None else certificate.get("force_bound_N")
    return float(bound) if isinstance(bound, int | float) else None


def _training_notes(comparison: Comparison) -> list[str]:
    """Return where a cost is not a test, and for which models that is not known."""
    by_recording: dict[str, list[str]] = {}
    for model in comparison.models:
        for cost in model.costs:
            if cost.use == TRAINED:
                by_recording.setdefault(cost.recording, []).append(model.name)
    notes = [
        f"{join(names)} {_was(names)} identified on {recording}; {'its' if len(names) == 1 else 'their'} cost there is "
        "not a test"
        for recording, names in by_recording.items()
    ]
    unknown = [m.name for m in comparison.models if any(cost.use == UNKNOWN for cost in m.costs)]
    if unknown:
        notes.append(
            f"no file says what {join(unknown)} {_was(unknown)} identified on; whether these recordings are a test is "
            "not known"
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
        models = "all models" if len(names) == len(comparison.models) > 2 else join(names)
        groups.setdefault((models, ranges), []).append(recording_name)
    return [
        f"{join(names)} {'leaves' if len(names) == 1 else 'leave'} the envelope of {models} {ranges}"
        for (models, ranges), names in groups.items()
    ]


def _divergence_notes(comparison: Comparison) -> list[str]:
    return [
        f"{model.name} {_describe_divergence(model)} on {recording.name}: it has no cost there"
        for recording in comparison.recordings
        for model, lost in zip(comparison.models, recording.diverged, strict=True)
        if lost
    ]


def _describe_divergence(model: ModelResult) -> str:
    if model.model.model is not None:
        return "left its force envelope"
    return f"diverged, to more than {MAX_RATIO:g} times the measured force,"


def join(names: Sequence[str]) -> str:
    """Return names as text: a, b and c."""
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else names[0]


def _was(names: Sequence[str]) -> str:
    return "was" if len(names) == 1 else "were"
