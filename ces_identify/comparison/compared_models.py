"""What is compared: models with the recordings that they know, their forces at the same stamps, and every two of them.

Each model runs freely at its own rate and delay over the whole recording. Its force at a position sample is the one
that the observer would publish for it, so all forces have the recording's own position stamps; the measured force is
interpolated to them. Only stamps count at which every model has a force. Of every two models, the difference of their
costs has an error; all pairs that can be tested are tested together, with Holm's correction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from ces_data.arrays import F, Mask
from ces_data.checks.content import find_known_recording, identification_rows
from ces_data.recording import Recording
from ces_identify.limits import ComparisonLimits, ErrorLimits, TickLimits
from ces_identify.numerics.correlation import (
    SumError,
    add_errors,
    adjusted_p_values,
    estimate_sum_error,
    step_levels,
    sum_bins,
)
from ces_identify.prepare.series import force_at
from ces_identify.simulations.simulate import SampleRun, sample_run
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.validation.evaluate import UNITS as SIGNAL_UNITS
from ces_identify.validation.evaluate import RangeUse, describe_held, find_outside
from ces_observer.errors import RecordingError
from ces_observer.model import Model

TRAINED, TEST, UNKNOWN = "identified on", "test", "not known"
FITTED_ROLES = ("identification", "real", "reference")  # of recordings in a model's and an augmented.json's provenance

TrainingRow = Mapping[str, Any]  # a recording in a provenance: name, hash, share and marks


@dataclass(frozen=True)
class ComparedModel:
    """A simulation with the name that tables and charts show, and its `source` (a path or the like).

    `trained_on` describes the recordings that it was identified on; `training_known` is False if there may be others,
    because no file says so.
    """

    name: str
    simulation: Simulation
    source: str = ""
    trained_on: tuple[TrainingRow, ...] = ()
    training_known: bool = False

    @property
    def model(self) -> Model | None:
        """The model if it is one, None for any other simulation."""
        return self.simulation.model if isinstance(self.simulation, ModelSimulation) else None

    def use_of(self, recording: Recording) -> str:
        """Return TRAINED if the model was identified on some of the recording, TEST, or UNKNOWN."""
        if find_known_recording(recording, {"identification": list(self.trained_on)}):
            return TRAINED
        return TEST if self.training_known and recording.source else UNKNOWN


def make_compared_model(name: str, simulation: Simulation, source: str = "") -> ComparedModel:
    """Return the simulation with the recordings that the provenance of its file names."""
    inside = simulation.innermost
    provenances = [getattr(simulation, "provenance", {})] if inside is not simulation else []
    provenances += [inside.model.provenance] if isinstance(inside, ModelSimulation) else [{}]
    listed = [{"identification": provenance.get(role)} for provenance in provenances for role in FITTED_ROLES]
    rows = tuple(row for entry in listed for row in identification_rows(entry))
    is_known = all(provenances) and all(row.get("sha256") or row.get("marks") for row in rows)
    return ComparedModel(name, simulation, source, rows, is_known)


@dataclass(frozen=True)
class AlignedRecording:
    """Forces of all models on one recording, at its position samples (n,).

    `time_s` counts from the first sample; `position` [m] and `speed` [m/s] are shown only. `measured` (n,) and `forces`
    (models, n) [N] are NaN where there is none; `scored` (n,) is true where all of them count. `diverged` says which
    models have a force that is not finite or, of those without an envelope, exceeds MAX_RATIO times the measured force.
    `exits` lists the signals outside each model's input envelope, `holds` tells of forces held at its force envelope
    (empty if none was).
    """

    name: str
    sha256: str
    source: str
    rate_Hz: float
    time_s: F
    position: F
    speed: F
    measured: F
    forces: F
    scored: Mask
    diverged: tuple[bool, ...]
    exits: tuple[tuple[RangeUse, ...], ...]
    holds: tuple[str, ...] = ()

    @property
    def seconds(self) -> float:
        """Scored time [s]."""
        return float(self.scored.sum()) / self.rate_Hz

    @property
    def errors(self) -> F:
        """Measured minus simulated force [N] at the scored samples (models, m), NaN for a model that diverged."""
        return np.asarray(self.measured[self.scored] - self.forces[:, self.scored])


def align(models: Sequence[ComparedModel], recording: Recording) -> AlignedRecording:
    """Run all models over `recording`.

    Raises RecordingError if there are too few stamps at which all models and the measurement have a force.
    """
    if "force" not in recording.channels:
        raise RecordingError(f"{recording.name}: no measured force to compare with; describe it in the signals file")
    position = recording.channel("position")
    stamps = position.stamps_ns
    measured, time_s = force_at(recording, stamps, TickLimits.MIN_GAP_S), (stamps - stamps[0]) * 1e-9
    runs = [_run(model, recording, measured) for model in models]
    forces, diverged = np.stack([force for force, _, _ in runs]), tuple(lost for _, _, lost in runs)
    counted = np.isfinite(measured) & np.isfinite(position.values) & _past_warm_up(time_s)
    counted &= (np.isfinite(forces) | np.array(diverged)[:, None]).all(axis=0)
    if counted.sum() < TickLimits.MIN_SCORED:
        raise RecordingError(
            f"{recording.name}: {counted.sum()} samples at which all models and the measurement have a force past "
            f"warm-up; expected at least {TickLimits.MIN_SCORED}: compare on a longer recording, or leave out the "
            "model that has no force there"
        )
    if np.ptp(measured[counted]) == 0.0:
        what = "measured force is constant; check its topic and field in the signals file"
        raise RecordingError(f"{recording.name}: {what}")
    speeds = (np.append(run.series.speed, np.nan)[run.newest] for _, run, _ in runs if run is not None)
    speed = next(speeds, None)  # of the first model, for charts
    speed = np.asarray(np.gradient(position.values, time_s)) if speed is None else speed
    return AlignedRecording(
        name=recording.name,
        sha256=recording.sha256,
        source=recording.source,
        rate_Hz=1.0 / float(np.median(np.diff(time_s))),
        time_s=time_s,
        position=position.values,
        speed=speed,
        measured=measured,
        forces=forces,
        scored=counted,
        diverged=diverged,
        exits=tuple(_find_exits(model, run, counted) for model, (_, run, _) in zip(models, runs, strict=True)),
        holds=tuple("" if run is None else describe_held(recording.name, *run.held_at(counted)) for _, run, _ in runs),
    )


def _run(model: ComparedModel, recording: Recording, measured: F) -> tuple[F, SampleRun | None, bool]:
    """Return the force, the run if it is a model, and whether it diverged; others do far beyond the measured force."""
    if model.model is not None:
        run = sample_run(model.model, recording)
        return run.force, run, not np.isfinite(run.run.force).all()
    force = model.simulation.force(recording)
    limit = ComparisonLimits.MAX_RATIO * float(np.nanmax(np.abs(measured), initial=0.0))
    diverged = limit > 0.0 and bool(np.nanmax(np.abs(force), initial=0.0) > limit)
    return np.full(len(force), np.nan) if diverged else force, None, diverged


def _past_warm_up(time_s: F) -> Mask:
    """Return where the last start or gap is at least WARM_UP_S ago."""
    starts = np.flatnonzero(np.diff(time_s, prepend=-np.inf) > TickLimits.MIN_GAP_S)
    began = time_s[starts[np.searchsorted(starts, np.arange(len(time_s)), side="right") - 1]]
    return np.asarray(time_s - began >= ComparisonLimits.WARM_UP_S)


def _find_exits(model: ComparedModel, run: SampleRun | None, counted: Mask) -> tuple[RangeUse, ...]:
    if model.model is None or run is None:
        return ()
    ticks = np.unique(run.newest[counted & (run.newest >= 0)])
    return find_outside(model.model, {name: getattr(run.series, name)[ticks] for name in SIGNAL_UNITS})


BETTER, SAME, SHORT = "better", "cannot be told apart", "too short to know"
NO_TEST, DIVERGED = "not a test", "diverged"


Pair = tuple[int, int]


@dataclass(frozen=True)
class DifferenceErrors:
    """A difference of J [%], first minus second model, over `seconds`; `error` is None with a recording too short.

    A difference up to `rounding` [%] is none.
    """

    value: float
    error: SumError | None
    seconds: float
    rounding: float

    @property
    def is_rounding(self) -> bool:
        """Whether the difference is no more than rounding, as that of a model and its own FMU."""
        return abs(self.value) <= self.rounding

    def p_value(self) -> float:
        """Return the p-value that the true difference is zero; 1 without an error, or for rounding."""
        return 1.0 if self.error is None or self.is_rounding else self.error.p_value(self.value)

    def interval(self, level: float) -> tuple[float, float]:
        """Return the interval [%] that holds the true value by `level` (0 to 1); endless without an error."""
        half = np.inf if self.error is None else self.error.half_width(level)
        half = max(half, abs(self.value)) if self.is_rounding else half
        return float(self.value - half), float(self.value + half)

    def is_too_short(self, alpha: float) -> bool:
        """Return whether a longer recording may find a difference at the level `alpha` that this one cannot show.

        So it is if there are fewer than MIN_SECONDS, or if the difference would count, were nothing slow possible.
        """
        if self.error is None:
            return True
        if self.is_rounding or self.p_value() < alpha:
            return False
        return self.seconds < ComparisonLimits.MIN_SECONDS or self.error.fast_p_value(self.value) < alpha


def pooled_costs(recordings: Sequence[AlignedRecording]) -> F:
    """Return J [%] of each model (models,) over all recordings, each force relative to its recording's mean."""
    squares = sum((r.errors**2).sum(axis=1) for r in recordings)
    return np.asarray(100.0 * np.sqrt(squares / sum(map(_spread, recordings))))


def find_differences(recordings: Sequence[AlignedRecording], pairs: Sequence[Pair]) -> list[DifferenceErrors]:
    """Return the difference of pooled J, with its error, for each pair of models; none of them may have diverged."""
    costs, seconds = pooled_costs(recordings), sum(r.seconds for r in recordings)
    influences = [influence_of_bins(r, costs, sum(map(_spread, recordings))) for r in recordings]
    enough = all(influence.shape[1] >= ErrorLimits.MIN_BINS for influence in influences)
    differences = []
    for first, second in pairs:
        sums = (
            estimate_sum_error(x[first] - x[second], r.seconds) for x, r in zip(influences, recordings, strict=True)
        )
        error = add_errors(list(sums)) if enough else None
        rounding = ErrorLimits.ROUNDING * float(max(costs[first], costs[second]))
        differences.append(DifferenceErrors(float(costs[first] - costs[second]), error, seconds, rounding))
    return differences


def _spread(recording: AlignedRecording) -> float:
    force = recording.measured[recording.scored]
    return float(((force - force.mean()) ** 2).sum())


def influence_of_bins(recording: AlignedRecording, costs: F, spread: float) -> F:
    """Return the influence [%] of each bin of BIN_S on the pooled cost of each model (models, bins).

    J = 100 sqrt(S / Y) with the sums S of squared errors and Y = `spread`: dJ = J / 2 (dS / S - dY / Y).
    """
    force = recording.measured[recording.scored]
    squares = sum_bins(recording.errors**2, recording.rate_Hz)
    of_force = sum_bins((force - force.mean()) ** 2, recording.rate_Hz)
    per_square = 0.5 * 100.0**2 / np.maximum(costs, 1e-300) / spread  # J / (2 S)
    return np.asarray(per_square[:, None] * squares - 0.5 * costs[:, None] * of_force / spread)


@dataclass(frozen=True)
class Difference:
    """J of the first model minus J of the second [%], on `recordings`.

    The value is NaN if a model diverged; `low` and `high` are None where the recordings are too short to know.
    """

    recordings: tuple[str, ...]
    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, repr=False)
class PairResult:
    """Two models compared: `first` and `second` are their indices, `names` their names.

    `pooled` is over the recordings on which no model of the comparison was identified; without any, over those on which
    neither of the two was, else over all. Its interval is at the level of its step in Holm's procedure. `each` holds
    the difference on each recording, with plain 95 % intervals. `verdict` is one of BETTER, SAME, SHORT, NO_TEST and
    DIVERGED; `better` is the index of the better model, None if neither is. `p_value` is Holm's adjusted one, None
    without a test. `text` says it in a sentence.
    """

    first: int
    second: int
    pooled: Difference
    each: tuple[Difference, ...]
    p_value: float | None
    verdict: str
    better: int | None
    text: str
    names: tuple[str, str]

    def __repr__(self) -> str:
        return f"PairResult: {self.text}"

    def minus(self, model: int) -> Difference:
        """Return the pooled difference as J of the other model minus J of `model`, one of the two."""
        if model == self.second:
            return self.pooled
        low, high = (None if end is None else -end for end in (self.pooled.high, self.pooled.low))
        return Difference(self.pooled.recordings, -self.pooled.value, low, high)


def compare_pairs(
    names: Sequence[str], recordings: Sequence[AlignedRecording], uses: Sequence[Sequence[str]]
) -> list[PairResult]:
    """Return every pair of the models `names`; `uses` says what each model did with each recording.

    The pairs that can be tested are tested together, by Holm's procedure.
    """
    pairs, alpha = list(combinations(range(len(names)), 2)), 1.0 - ErrorLimits.LEVEL
    common = _find_tests(uses, range(len(names)))
    tests = {pair: common or _find_tests(uses, pair) for pair in pairs}
    used = {pair: [recordings[i] for i in tests[pair] or range(len(recordings))] for pair in pairs}
    errors = _find_errors(used)
    tested = [pair for pair, difference in errors.items() if tests[pair] and difference.error is not None]
    p_values = [errors[pair].p_value() for pair in tested]
    levels = dict(zip(tested, step_levels(p_values, alpha), strict=True))
    adjusted = dict(zip(tested, adjusted_p_values(p_values), strict=True))
    single = [_find_errors({pair: [recording] for pair in pairs}) for recording in recordings]
    return [
        _pair_result(
            pair,
            names,
            _difference(used[pair], errors.get(pair), levels.get(pair, alpha)),
            tuple(
                _difference([r], errors_there.get(pair), alpha)
                for r, errors_there in zip(recordings, single, strict=True)
            ),
            adjusted.get(pair),
            bool(tests[pair]),
        )
        for pair in pairs
    ]


def _find_tests(uses: Sequence[Sequence[str]], models: Sequence[int]) -> list[int]:
    """Return the recordings on which none of these models was identified."""
    return [i for i in range(len(uses[0])) if all(uses[model][i] != TRAINED for model in models)]


def _find_errors(used: dict[Pair, list[AlignedRecording]]) -> dict[Pair, DifferenceErrors]:
    """Return the errors of every pair that has not diverged on its recordings."""
    groups: dict[tuple[int, ...], list[Pair]] = {}
    for pair, recordings in used.items():
        if not any(r.diverged[model] for r in recordings for model in pair):
            groups.setdefault(tuple(map(id, recordings)), []).append(pair)
    return {
        pair: difference
        for pairs in groups.values()
        for pair, difference in zip(pairs, find_differences(used[pairs[0]], pairs), strict=True)
    }


def _difference(recordings: Sequence[AlignedRecording], errors: DifferenceErrors | None, level: float) -> Difference:
    names = tuple(r.name for r in recordings)
    if errors is None:
        return Difference(names, float("nan"), None, None)
    low, high = (None, None) if errors.is_too_short(level) else errors.interval(1.0 - level)
    return Difference(names, errors.value, low, high)


def _pair_result(
    pair: Pair,
    names: Sequence[str],
    pooled: Difference,
    each: tuple[Difference, ...],
    p_value: float | None,
    is_test: bool,
) -> PairResult:
    first, second = (names[model] for model in pair)
    better, worse = pair[::-1] if pooled.value > 0.0 else pair
    if np.isnan(pooled.value):
        verdict, text = DIVERGED, "no difference: a free run diverged"
    elif not is_test:
        verdict, text = NO_TEST, "not a test: one of them was identified on each recording"
    elif pooled.low is None or pooled.high is None:
        verdict, text = SHORT, f"too short to know whether {first} and {second} differ"
    elif pooled.low > 0.0 or pooled.high < 0.0:
        verdict, text = BETTER, f"{names[better]} is better than {names[worse]}"
    else:
        verdict, text = SAME, f"{first} and {second} cannot be told apart"
    return PairResult(
        *pair, pooled, each, p_value, verdict, better if verdict == BETTER else None, text, (first, second)
    )
