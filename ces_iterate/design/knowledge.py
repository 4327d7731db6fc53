"""What a model does not know: where models fitted without each recording disagree, and where its band is wide.

Both are taken at the targets of the design, relative to the force of the motion that a target belongs to, since the
cost J is relative, too. The disagreement is what the parameters still vary by (query by committee: Seung, Opper and
Sompolinsky, COLT 1992), and it weighs the targets. The band also holds what no recording can lower, noise and errors of
the structure; a design weighted by it spends its time where the force is small. So the band is only reported.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from ces_identify.preparation.series import Series
from ces_identify.simulations.band_run import band_half_width
from ces_identify.simulations.simulate import simulate_series
from ces_iterate.commands import INTERVAL_S, Commands
from ces_iterate.design.pool import Pool
from ces_observer.model import Model

F = NDArray[np.float64]

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


def nothing_known(pool: Pool) -> Knowledge:
    """Return the knowledge before there is a model."""
    count = len(pool.state)
    return Knowledge(np.ones(count), np.zeros(count))


def ask_models(model: Model, ensemble: Sequence[Model], pool: Pool) -> Knowledge:
    """Return what `model` and the models of the `ensemble` do not know about the pool's targets."""
    series = [series_of(motion, model.sampling.rate_Hz) for motion in pool.motions]
    runs = [[simulate_series(one, s).force for s in series] for one in (model, *ensemble)]
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


def series_of(commands: Commands, rate_Hz: float) -> Series:
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
