"""The generic learner: ridge regression on a dictionary of fading-memory functions, with autocorrelated noise.

It learns the correction of the simulation's error from references, and the ceiling: what of a gap can be explained
without physics. Cross-validation over blocks chooses the penalty.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, solve_toeplitz

from ces_data.arrays import F, Mask
from ces_gap.baseline.learner_kernels import fill_features
from ces_gap.errors import GapError
from ces_gap.grid import count_through, is_constant
from ces_gap.trace import Trace, TraceInputs, usable_inputs, usable_values
from ces_observer.records import part

ORDER = 6


@dataclass(frozen=True)
class NoiseModel:
    """`rms_N` of the noise, standard deviation `innovation_N` of the innovation, coefficients `ar` (p,)."""

    rms_N: float
    innovation_N: float
    ar: F

    def whiten(self, values: F) -> F:
        """Return columns (n, …) whitened along the first axis; the first p rows are transient."""
        out = values / self.innovation_N
        for k, weight in enumerate(self.ar / self.innovation_N, 1):
            out[k:] -= weight * values[:-k]
        return np.asarray(out)

    def usable_after_whitening(self, usable: Mask) -> Mask:
        """Return the mask (n,) of the ticks whose whitened value depends on usable ticks only."""
        window = np.ones(len(self.ar) + 1)
        return np.asarray(np.convolve(~usable, window)[: len(usable)] < 0.5) & (np.arange(len(usable)) >= len(self.ar))


def make_white_noise(rms_N: float) -> NoiseModel:
    """Return white noise of RMS `rms_N`."""
    return NoiseModel(rms_N, rms_N, np.zeros(0))


def noise_of(residuals: Sequence[F], usable: Sequence[Mask], order: int = ORDER) -> NoiseModel:
    """Return the noise model of the usable parts of residuals [N] (Yule-Walker equations)."""
    lags = autocovariance(residuals, usable, order)
    lags[0] = max(lags[0] * (1.0 + 1e-6), 1e-12)
    ar = solve_toeplitz(lags[:-1], lags[1:])
    return NoiseModel(float(np.sqrt(lags[0])), float(np.sqrt(max(lags[0] - ar @ lags[1:], 1e-4 * lags[0]))), ar)


def autocovariance(values: Sequence[F], usable: Sequence[Mask], order: int) -> F:
    """Return the autocovariance (order + 1,) [N2] about zero of the usable parts of `values` [N]."""
    masked = [np.where(u, r, 0.0) for r, u in zip(values, usable, strict=True)]
    count = max(sum(int(u.sum()) for u in usable), 1)
    return np.array([sum(float(r[: len(r) - k] @ r[k:]) for r in masked) for k in range(order + 1)]) / count


PENALTIES = 10.0 ** np.arange(-7.0, 3.5, 0.75)  # over the mean square of a feature
BLOCK_S = 1.0  # [s] length of a block
FOLDS = 5


@dataclass(frozen=True)
class LearnerResult:
    """Weights (q,), their posterior covariance (q, q), the noise, and cross-fitted predictions [N] of each trace."""

    weights: F
    covariance: F
    noise: NoiseModel
    crossfitted: tuple[F, ...]


def learn(
    features: Sequence[F], targets: Sequence[F], usable: Sequence[Mask], rate_Hz: float, passes: int = 2
) -> LearnerResult:
    """Fit `targets` [N] (n,) by `features` (n, q) on the usable ticks of each trace.

    Each pass whitens by the autoregression of the cross-fitted residuals of the pass before. The folds are therefore
    not fully independent: the coefficients of the noise, and the penalty, come from all of them.
    """
    folds = _folds(features, rate_Hz)
    noise = make_white_noise(1.0)
    for _ in range(passes):
        gram, moment, penalty = _normal_equations(features, targets, usable, folds, noise)
        by_fold = [_solve(gram.sum(0) - gram[k], moment.sum(0) - moment[k], penalty) for k in range(len(gram))]
        weights = np.stack(by_fold)
        crossfitted = tuple(np.einsum("nq,nq->n", x, weights[f]) for x, f in zip(features, folds, strict=True))
        residuals = [y - p for y, p in zip(targets, crossfitted, strict=True)]
        noise = noise_of(residuals, usable)
    gram, moment, penalty = _normal_equations(features, targets, usable, folds, noise)
    total = gram.sum(0) + penalty * np.eye(gram.shape[1])
    factor = cho_factor(total)
    return LearnerResult(cho_solve(factor, moment.sum(0)), cho_solve(factor, np.eye(len(total))), noise, crossfitted)


def _folds(features: Sequence[F], rate_Hz: float) -> list[NDArray[np.int64]]:
    """Return the fold of every tick (n,) of each trace; blocks are numbered through all traces."""
    length = max(1, round(BLOCK_S * rate_Hz))
    return [block % FOLDS for block in count_through([np.arange(len(x)) // length for x in features])]


def _normal_equations(
    features: Sequence[F],
    targets: Sequence[F],
    usable: Sequence[Mask],
    folds: Sequence[NDArray[np.int64]],
    noise: NoiseModel,
) -> tuple[F, F, float]:
    """Return Gram matrix (k, q, q) and moments (k, q) of the whitened rows of each of k folds, and the best penalty."""
    keep = [noise.usable_after_whitening(u) for u in usable]
    x = np.concatenate([noise.whiten(v)[k] for v, k in zip(features, keep, strict=True)])
    y = np.concatenate([noise.whiten(v)[k] for v, k in zip(targets, keep, strict=True)])
    fold = np.concatenate([v[k] for v, k in zip(folds, keep, strict=True)])
    parts = [fold == k for k in range(FOLDS)]
    gram, moment = np.stack([x[p].T @ x[p] for p in parts]), np.stack([x[p].T @ y[p] for p in parts])
    return gram, moment, _choose_penalty(gram, moment, [float(y[p] @ y[p]) for p in parts])


def _choose_penalty(gram: F, moment: F, whole: Sequence[float]) -> float:
    """Return the penalty with the smallest squared error on the folds left out; `whole` is each fold's energy."""
    scale = max(float(np.trace(gram.sum(0))) / gram.shape[1], 1e-12)
    costs = []
    for penalty in PENALTIES * scale:
        cost = 0.0
        for k in range(FOLDS):
            w = _solve(gram.sum(0) - gram[k], moment.sum(0) - moment[k], penalty)
            cost += whole[k] - 2.0 * float(w @ moment[k]) + float(w @ gram[k] @ w)
        costs.append(cost)
    return float(PENALTIES[int(np.argmin(costs))] * scale)


def _solve(gram: F, moment: F, penalty: float) -> F:
    return np.asarray(cho_solve(cho_factor(gram + penalty * np.eye(len(gram))), moment))


MEMORIES_S = np.array([0.003, 0.010, 0.030])  # [s] fading memories of force and speed
VALVE_S = np.array([0.006, 0.025])  # [s] fading memories of the current
TURNS = np.array([0.01, 0.05, 0.2])  # radii of the stop operators over the stroke's scale
SPEED_KNOTS = np.array([-3.0, -2.2, -1.4, -0.7, 0.0, 0.7, 1.4, 2.2, 3.0])  # of asinh(speed over a tenth of its RMS)
FORCE_KNOTS = np.array([-2.0, -1.2, -0.6, -0.2, 0.2, 0.6, 1.2, 2.0])  # of force over its RMS
COARSE_KNOTS = np.array([-3.0, -1.0, 1.0, 3.0])


def _pair() -> Any:
    """Declare a centre and a spread."""
    return part(kind=float, many=True, min_count=2, max_count=2, make=tuple)


@dataclass(frozen=True)
class Scales:
    """Scales of the features: centres and spreads of the training inputs, SI."""

    position: tuple[float, float] = _pair()
    speed: float = part()
    current: tuple[float, float] = _pair()
    force: tuple[float, float] = _pair()
    varies: bool = part()  # whether the current varies

    @classmethod
    def of(cls, traces: Sequence[Trace], forces: Sequence[F]) -> Scales:
        """Return the scales of the usable ticks of the traces and their forces."""
        x, v, i = (usable_inputs(traces, name) for name in ("position", "speed", "current"))
        f, varies = usable_values(traces, forces), not is_constant(i)
        return cls(
            (float(x.mean()), max(float(x.std()), 1e-9)),
            max(float(np.sqrt((v**2).mean())), 1e-9),
            (float(i.mean()), float(i.std()) if varies else 1.0),
            (float(f.mean()), max(float(f.std()), 1e-9)),
            varies,
        )


@dataclass(frozen=True)
class Dictionary:
    """Features of a trace. `by_force` adds those of the simulated force, `by_time` those of elapsed time and heat."""

    scales: Scales
    by_force: bool = True
    by_time: bool = False

    def features(self, trace: Trace, inputs: TraceInputs, force: F) -> F:
        """Return the features (n, q), each of order 1, of the inputs and their simulated `force` [N] (n,)."""
        timed = self._time_features(trace, inputs, force) if self.by_time else np.empty((len(force), 0))
        out = np.zeros((len(force), self.size + timed.shape[1]))
        self._fill(trace, inputs, force, np.empty(0), out)
        out[:, self.size :] = timed
        return out

    def predict(self, trace: Trace, inputs: TraceInputs, force: F, weights: F) -> F:
        """Return the weighted sum (n,) of the features without storing them."""
        out = np.zeros((len(force), 1))
        self._fill(trace, inputs, force, np.ascontiguousarray(weights[: self.size]), out)
        if not self.by_time:
            return out[:, 0]
        return np.asarray(out[:, 0] + self._time_features(trace, inputs, force) @ weights[self.size :])

    def _fill(self, trace: Trace, inputs: TraceInputs, force: F, weights: F, out: F) -> None:
        s = self.scales
        x = (inputs.position - s.position[0]) / s.position[1]
        i = np.clip((inputs.current - s.current[0]) / s.current[1], -4.0, 4.0)
        f = (force - s.force[0]) / s.force[1]
        knots = (SPEED_KNOTS, COARSE_KNOTS, FORCE_KNOTS, TURNS, MEMORIES_S, VALVE_S)
        fill_features(x, inputs.speed / s.speed, i, f, trace.rate_Hz, s.varies, self.by_force, *knots, weights, out)

    @property
    def size(self) -> int:
        """The number of features without those of time."""
        each, sided = (2, 3) if self.scales.varies else (1, 2)
        fine, coarse = len(SPEED_KNOTS), len(COARSE_KNOTS)
        count = fine * (3 if self.scales.varies else 1) + 2 + each + coarse + sided * len(TURNS)
        count += coarse * len(VALVE_S) if self.scales.varies else 0
        if not self.by_force:
            return count + each * fine * len(MEMORIES_S)
        return count + each * fine + each * (len(FORCE_KNOTS) + 1) + sided * len(MEMORIES_S)

    def _time_features(self, trace: Trace, inputs: TraceInputs, force: F) -> F:
        f = (force - self.scales.force[0]) / self.scales.force[1]
        t = trace.time_s / max(float(trace.time_s[-1]), 1.0)
        heat = np.cumsum(np.abs(force * inputs.speed))
        heat = heat / max(float(heat[-1]), 1e-9)
        return np.stack([t, t * t, t * f, heat * f, heat], axis=1)


@dataclass(frozen=True)
class LearnedCorrection:
    """A correction of the simulated force: weights (q,) of the features of `dictionary`."""

    dictionary: Dictionary = part()
    weights: F = part(kind=float, many=True, make=np.array, text=np.ndarray.tolist)

    def checked(self) -> Self:
        """Return it; raises GapError unless there is a weight for each feature."""
        if self.dictionary.by_time or len(self.weights) != self.dictionary.size:
            raise GapError(f"weights are {len(self.weights)} numbers; expected {self.dictionary.size}")
        return self

    def force(self, trace: Trace, inputs: TraceInputs, simulated: F) -> F:
        """Return the force [N] (n,) to be added to the simulated one."""
        return self.dictionary.predict(trace, inputs, simulated, self.weights)


def learn_correction(references: Sequence[Trace]) -> tuple[LearnedCorrection, LearnerResult]:
    """Return the correction learnt from the references, and the full result of the learner.

    Noise and covariance are those of errors on references that neither simulation nor correction has seen, if these
    are larger: a simulation fitted to the references is closer to them than to other recordings, and so is its
    correction. Of a single reference, segments are left out of the simulation's fit and blocks of that of the
    correction.
    """
    correction, learnt = _learn(references)
    if all(t.simulated_left_out is None for t in references):
        return correction, learnt
    errors = []
    for k, trace in enumerate(references):
        force = trace.simulated if trace.simulated_left_out is None else trace.simulated_left_out
        others = [t for i, t in enumerate(references) if i != k]
        added = _learn(others)[0].force(trace, trace.inputs, force) if others else learnt.crossfitted[k]
        errors.append(trace.force - force - added)
    noise = noise_of(errors, [t.usable for t in references])
    if noise.rms_N <= learnt.noise.rms_N:
        return correction, learnt
    growth = (noise.rms_N / learnt.noise.rms_N) ** 2
    return correction, replace(learnt, noise=noise, covariance=learnt.covariance * growth)


def _learn(references: Sequence[Trace]) -> tuple[LearnedCorrection, LearnerResult]:
    dictionary = Dictionary(Scales.of(references, [t.simulated for t in references]))
    features = [dictionary.features(t, t.inputs, t.simulated) for t in references]
    targets = [t.force - t.simulated for t in references]
    learnt = learn(features, targets, [t.usable for t in references], references[0].rate_Hz)
    return LearnedCorrection(dictionary, learnt.weights), learnt


@dataclass(frozen=True)
class Ceiling:
    """The generic learner, fitted to measured minus modelled force."""

    dictionary: Dictionary
    learnt: LearnerResult

    def add_to(self, traces: Sequence[Trace], forces: Sequence[F]) -> list[F]:
        """Return the modelled forces [N] (n,) of the traces plus the learner's prediction."""
        rows = zip(traces, forces, strict=True)
        return [f + self.dictionary.features(t, t.inputs, f) @ self.learnt.weights for t, f in rows]


def learn_ceiling(traces: Sequence[Trace], forces: Sequence[F]) -> Ceiling:
    """Fit the learner to measured minus modelled force [N] on the traces."""
    dictionary = Dictionary(Scales.of(traces, forces), by_time=True)
    features = [dictionary.features(t, t.inputs, f) for t, f in zip(traces, forces, strict=True)]
    targets = [t.force - f for t, f in zip(traces, forces, strict=True)]
    return Ceiling(dictionary, learn(features, targets, [t.usable for t in traces], traces[0].rate_Hz))
