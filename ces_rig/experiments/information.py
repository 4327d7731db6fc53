"""The state of a damper as a design sees it, and smooth random features of that state.

The state is what decides the force: stroke, speed, current, and the recent past as the distance of speed and current
from their own low-passes (the same five that the band of a model uses). A Gaussian process over that state stands for
any model: its posterior variance says where the force is still unknown, whatever structure is fitted later (Liu, Kiss,
Tóth and Schoukens, IEEE Control Systems Letters 9, 2025). Its kernel is approximated by random Fourier features (Rahimi
and Recht, NIPS 2007), so that what many experiments have shown is one matrix of fixed size.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import cho_factor, cho_solve
from scipy.signal import lfilter

from ces_data.arrays import F, I
from ces_identify.prepare.series import Series
from ces_identify.simulations.simulate import simulate_series
from ces_identify.validation.band import band_half_width
from ces_observer.model import Model
from ces_rig.experiments.commands import INTERVAL_S, RigCommands, RigLimits
from ces_rig.experiments.random_motions import draw_current, draw_motion
from ces_rig.limits import DesignLimits

STATE = ("stroke", "speed", "current", "change of speed", "change of current")
SCALES = np.array([1.2, 0.45, 0.7, 0.6, 0.9])  # of the kernel, in units of the scaled state
KNEE = 0.08  # share of the largest speed at which a damper's force typically bends
PAST_S = 0.02  # time constant of the low-passes
COUNT = 240  # features


def scaled_state(stroke_m: F, speed_m_s: F, current_A: F, limits: RigLimits) -> F:
    """Return the state (n, 5), each component about -1 to 1 within the limits; speeds are stretched around zero."""
    half = max(0.5 * (limits.high_A - limits.low_A), 1e-9)
    current = (current_A - 0.5 * (limits.high_A + limits.low_A)) / half
    speed = stretch(speed_m_s / limits.speed_m_s)
    changes = [2.0 * _change(signal) for signal in (speed, current)]
    return np.column_stack([(stroke_m - limits.centre_m) / limits.stroke_m, speed, current, *changes])


def stretch(share: F) -> F:
    """Return a speed, as a share of the largest, on a scale that is linear below `KNEE` and logarithmic above."""
    return np.asarray(np.arcsinh(share / KNEE) / np.arcsinh(1.0 / KNEE))


def _change(signal: F) -> F:
    decay = np.exp(-INTERVAL_S / PAST_S)
    return np.asarray(signal - lfilter([1.0 - decay], [1.0, -decay], signal, zi=[decay * signal[0]])[0])


@dataclass(frozen=True)
class Features:
    """Random Fourier features of a Gaussian kernel of unit variance: `frequencies` (5, COUNT), `phases` (COUNT,)."""

    frequencies: F
    phases: F

    def at(self, state: F) -> F:
        """Return the features (n, COUNT) at states (n, 5)."""
        return np.asarray(np.sqrt(2.0 / len(self.phases)) * np.cos(state @ self.frequencies + self.phases))


def draw_features(seed: int) -> Features:
    """Return the features that belong to a seed."""
    rng = np.random.default_rng([seed, 11])
    return Features(rng.standard_normal((len(STATE), COUNT)) / SCALES[:, None], rng.uniform(0.0, 2.0 * np.pi, COUNT))


POOL_SIZE = 96
LENGTH_S = 2.0  # of a motion
LEAD_S = 0.5  # of a motion that does not count, while models settle
PER_MOTION = 24  # states


@dataclass(frozen=True)
class Pool:
    """`motions`, the `ticks` (m,) of each that are targets, and the targets' `state` (motions * m, 5)."""

    motions: tuple[RigCommands, ...]
    ticks: I
    state: F
    speed_m_s: F
    current_A: F
    stroke_m: F


def draw_pool(limits: RigLimits, seed: int) -> Pool:
    """Return the pool that belongs to a seed."""
    rng = np.random.default_rng([seed, 13])
    count = round(LENGTH_S / INTERVAL_S) + 1
    ticks = np.linspace(LEAD_S / INTERVAL_S, count - 1, PER_MOTION).astype(np.int64)
    motions = tuple(
        RigCommands(f"pool {k}", limits.centre_m + draw_motion(limits, count, rng), draw_current(limits, count, rng))
        for k in range(POOL_SIZE)
    )
    speeds = [motion.motion()[0] for motion in motions]
    states = [scaled_state(m.stroke_m, v, m.current_A, limits)[ticks] for m, v in zip(motions, speeds, strict=True)]
    at = [np.concatenate([signal[ticks] for signal in signals]) for signals in (
        speeds, [m.current_A for m in motions], [m.stroke_m for m in motions])]  # fmt: skip
    return Pool(motions, ticks, np.concatenate(states), *at)


EVERY_S = 0.02  # [s] between the rows of an experiment that count as independent
ERROR_VARIANCE = 0.15  # s²: of the error of one row, relative to the prior variance of the force


@dataclass(frozen=True)
class Information:
    """The posterior covariance (features, features) of the force's weights."""

    covariance: F

    @staticmethod
    def none(count: int) -> Information:
        """Return the prior: nothing is known."""
        return Information(np.eye(count))

    def add(self, rows: F) -> Information:
        """Return the information after rows (n, features)."""
        reach = rows @ self.covariance
        solved = cho_solve(self._factor(rows, reach), reach)
        covariance = self.covariance - reach.T @ solved
        return Information(0.5 * (covariance + covariance.T))

    def variance(self, rows: F) -> F:
        """Return the posterior variance (n,) at rows (n, features), 1 where nothing is known."""
        return np.asarray(np.einsum("ij,jk,ik->i", rows, self.covariance, rows, optimize=True))

    def coverage(self, rows: F) -> float:
        """Return the share of the states with these rows (n, features) that count as covered."""
        return float(np.mean(self.variance(rows) <= DesignLimits.KNOWN_VARIANCE))

    def weigh(self, targets: F, weights: F) -> F:
        """Return C T C, which `gain` needs, for targets (m, features) with weights (m,)."""
        reach = targets @ self.covariance
        return np.asarray((reach * (weights / weights.sum())[:, None]).T @ reach)

    def gain(self, rows: F, weighed: F) -> float:
        """Return by how much rows (n, features) lower the weighted mean variance of the targets."""
        factor = self._factor(rows, rows @ self.covariance)
        return float(np.trace(cho_solve(factor, rows @ weighed @ rows.T)))

    @staticmethod
    def _factor(rows: F, reach: F) -> tuple[F, bool]:
        factor: tuple[F, bool] = cho_factor(reach @ rows.T + ERROR_VARIANCE * np.eye(len(rows)), lower=True)
        return factor


MAX_RELATIVE = 1.0  # largest relative error that counts: a diverged run says no more than that it is unknown
FLOOR = 0.5  # share of the weight that all targets have alike, so that a confident mistake is still found
BAND_LEVEL = 1.645  # half-widths of 90 % in standard deviations


@dataclass(frozen=True)
class Knowledge:
    """Relative standard deviations (targets,): `disagreement` of the models, `band` from the half-width."""

    disagreement: F
    band: F

    def weights(self) -> F:
        """Return the weights (targets,) of the design, their mean 1."""
        square = self.disagreement**2
        mean = float(square.mean())
        return FLOOR + (1.0 - FLOOR) * square / mean if mean > 0.0 else np.ones(len(square))


def compare_models(model: Model, ensemble: Sequence[Model], pool: Pool) -> Knowledge:
    """Return what `model` and the models of the `ensemble` do not know about the pool's targets."""
    series = [series_of(motion, model.sampling.rate_Hz) for motion in pool.motions]
    runs = [[simulate_series(compared, s).force for s in series] for compared in (model, *ensemble)]
    at = [np.clip(pool.ticks * INTERVAL_S * s.rate_Hz, 0, len(s) - 1).astype(int) for s in series]
    scale = np.array([_rms(force) for force in runs[0]])
    forces = np.array([[f[ticks] for f, ticks in zip(run, at, strict=True)] for run in runs])
    spread = np.sqrt(np.mean((forces[1:] - forces[1:].mean(axis=0)) ** 2, axis=0)) if ensemble else 0.0 * forces[0]
    widths = np.zeros_like(forces[0])
    if model.band is not None:
        band = model.band
        widths = np.array([
            band_half_width(band, s, f)[ticks] for s, f, ticks in zip(series, runs[0], at, strict=True)
        ])  # fmt: skip
    return Knowledge(_relative(spread, scale), _relative(widths / BAND_LEVEL, scale))


def series_of(commands: RigCommands, rate_Hz: float) -> Series:
    """Return the commands as a prepared series without noise and force, as a model of this rate would see them."""
    time = np.arange(int(commands.duration_s * rate_Hz) + 1) / rate_Hz
    spline = CubicSpline(commands.time_s, commands.stroke_m)
    held = np.floor(time / INTERVAL_S + 1e-6).astype(int)
    nothing = np.full(len(time), np.nan)
    whole = np.array([[0, len(time)]])
    return Series(
        commands.name, rate_Hz, time, np.asarray(spline(time)), np.asarray(spline(time, 1)), commands.current_A[held],
        nothing, whole, np.zeros(len(time), np.bool_), 0, {},
    )  # fmt: skip


def _rms(force: F) -> float:
    finite = force[np.isfinite(force)]
    return float(np.sqrt(np.mean(finite**2))) if len(finite) else 0.0


def _relative(error: F, scale: F) -> F:
    smallest = 0.1 * float(np.median(scale)) or 1.0
    share = error / np.maximum(scale, smallest)[:, None]
    return np.asarray(np.minimum(np.nan_to_num(share, nan=MAX_RELATIVE, posinf=MAX_RELATIVE), MAX_RELATIVE).ravel())


PARTS = 6  # of each axis, with equally many targets
HISTORY = {"change of speed": "speed against its last 20 ms", "change of current": "current against its last 20 ms"}


@dataclass(frozen=True)
class LeastKnownRegion:
    """The least known range of an axis, `low` to `high` in `unit`.

    `unknown` is the share of the force relative to the mean of all targets, `coverage` the share of covered states.
    """

    axis: str
    unit: str
    low: float
    high: float
    unknown: float
    coverage: float


def find_least_known(pool: Pool, unknown: F, variance: F) -> tuple[LeastKnownRegion, ...]:
    """Return the least known range of each axis.

    The given `unknown` (targets,) is the relative variance that the design lowers, `variance` (targets,) that of the
    features.
    """
    axes = {
        "stroke": ("m", pool.stroke_m), "speed": ("m/s", pool.speed_m_s), "current": ("A", pool.current_A),
        **{name: ("of the range", pool.state[:, STATE.index(key)]) for key, name in HISTORY.items()},
    }  # fmt: skip
    regions = []
    for axis, (unit, values) in axes.items():
        edges = np.quantile(values, np.linspace(0.0, 1.0, PARTS + 1))
        part = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, PARTS - 1)
        means = np.array([unknown[part == k].mean() if (part == k).any() else 0.0 for k in range(PARTS)])
        least = int(np.argmax(means))
        ends = float(edges[least]), float(edges[least + 1])
        relative = float(means[least] / max(float(unknown.mean()), 1e-300))
        known = float(np.mean(variance[part == least] <= DesignLimits.KNOWN_VARIANCE))
        regions.append(LeastKnownRegion(axis, unit, *ends, relative, known))
    return tuple(regions)
