"""Made errors of models of known true cost: autoregressive, modulated, heavy-tailed, and switched.

The errors of several models share a common part and have one of their own, as those of models of one damper do. The own
parts are modulated by what each family names. All models have the same true cost; a `ratio` above 1 enlarges the first
one's own part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.numerics.arrays import F

RATE_HZ = 100.0


@dataclass(frozen=True)
class ErrorFamily:
    """How errors are made: their correlation time, the modulation, its time or period [s], and whether tails are heavy.

    Modulations: none, periodic (a sine of each model's own phase), slow (log-normal), opposite (two models take turns),
    switched (four levels, each held for an exponential time), cycled (the same levels in order), bursts, scales (slow
    changes on four scales, up to 6.4 s).
    """

    modulation: str
    tau_s: float
    slow_s: float = 0.0
    heavy: bool = False

    def __str__(self) -> str:
        return f"{self.modulation}{', heavy tails' if self.heavy else ''} | {self.tau_s:g} | {self.slow_s or '–'}"


CHOOSING = (
    ErrorFamily("none", 0.002),
    ErrorFamily("none", 0.1),
    ErrorFamily("none", 0.5),
    ErrorFamily("none", 0.05, heavy=True),
    ErrorFamily("periodic", 0.1, 0.5),
    ErrorFamily("periodic", 0.1, 3.3),
    ErrorFamily("slow", 0.1, 0.3),
    ErrorFamily("slow", 0.1, 1.0),
    ErrorFamily("slow", 0.1, 3.0),
    ErrorFamily("slow", 0.1, 10.0),
    ErrorFamily("slow", 0.1, 1.0, heavy=True),
    ErrorFamily("switched", 0.1, 1.0),
    ErrorFamily("switched", 0.1, 3.0),
    ErrorFamily("cycled", 0.1, 2.5),
)
FRESH = (
    ErrorFamily("opposite", 0.05, 0.5),
    ErrorFamily("opposite", 0.05, 2.0),
    ErrorFamily("scales", 0.05, 6.4),
    ErrorFamily("bursts", 0.05, 0.7),
    ErrorFamily("bursts", 0.2, 2.0),
    ErrorFamily("none", 0.3, heavy=True),
    ErrorFamily("slow", 0.02, 2.5, heavy=True),
    ErrorFamily("switched", 0.02, 2.0),
    ErrorFamily("cycled", 0.05, 0.6),
    ErrorFamily("periodic", 0.05, 3.0),
)


def make_recording(
    family: ErrorFamily, seconds: float, models: int, random: np.random.Generator, ratio: float = 1.0
) -> AlignedRecording:
    """Return a recording with the errors of `models` models."""
    n = round(seconds * RATE_HZ)
    common, *own = (draw_correlated(n, family.tau_s, random, heavy=family.heavy) for _ in range(models + 1))
    sizes = draw_sizes(family, n, models, random) * np.array([ratio, *np.ones(models - 1)])[:, None]
    return recording_of(20.0 * draw_correlated(n, 0.1, random), common + sizes * np.array(own))


def recording_of(measured: F, errors: F) -> AlignedRecording:
    """Return a recording with this `measured` force (n,) and these errors (models, n)."""
    models, n = errors.shape
    time_s, still, lost = np.arange(n) / RATE_HZ, np.zeros(n), (False,) * models
    return AlignedRecording(
        "made", "", "", RATE_HZ, time_s, still, still, measured, measured - errors, np.ones(n, bool),
        lost, ((),) * models, {},
    )  # fmt: skip


def draw_correlated(n: int, tau_s: float, random: np.random.Generator, *, heavy: bool = False) -> F:
    """Return a first-order process (n,) of variance 1 and correlation time `tau_s`; `heavy`: driven by t(3) noise."""
    pole, settling = float(np.exp(-1.0 / (tau_s * RATE_HZ))), round(10.0 * tau_s * RATE_HZ)
    noise = random.standard_t(3, size=n + settling) / np.sqrt(3.0) if heavy else random.normal(size=n + settling)
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], noise)[settling:])


def draw_sizes(family: ErrorFamily, n: int, models: int, random: np.random.Generator) -> F:
    """Return the sizes (models, n) of the models' own errors."""
    slow, time_s = family.slow_s, np.arange(n) / RATE_HZ

    def draws(tau_s: float) -> F:
        return np.stack([draw_correlated(n, tau_s, random) for _ in range(models)])

    signs = (-1.0) ** np.arange(models)
    phases = 2.0 * np.pi * (random.random() + np.arange(models) / max(models, 4))
    makers: dict[str, Callable[[], F]] = {
        "none": lambda: np.ones((models, n)),
        "periodic": lambda: 1.0 + np.sin(2.0 * np.pi * time_s / slow + phases[:, None]),
        "slow": lambda: np.exp(0.5 * draws(slow)),
        "opposite": lambda: np.exp(0.5 * np.outer(signs, draw_correlated(n, slow, random))),
        "bursts": lambda: 0.3 + 1.5 * (draws(slow) > 1.0),
        "scales": lambda: np.exp(0.35 * np.sum([draws(slow / 4.0**k) for k in range(4)], axis=0)),
        "switched": lambda: _levels(models)[:, _steps(n, slow, random, in_order=False)],
        "cycled": lambda: _levels(models)[:, _steps(n, slow, random, in_order=True)],
    }
    return np.asarray(makers[family.modulation]())


def _levels(models: int) -> F:
    """Return the sizes (models, 4) at four currents: every second model is good where the others are not."""
    return np.asarray(np.exp(0.6 * np.outer((-1.0) ** np.arange(models), np.linspace(-1.0, 1.0, 4))))


def _steps(n: int, hold_s: float, random: np.random.Generator, *, in_order: bool) -> F:
    """Return which of the four levels (n,) holds."""
    if in_order:
        return np.asarray((np.arange(n) / (hold_s * RATE_HZ) + 4.0 * random.random()).astype(int) % 4)
    count = round(4.0 * n / (hold_s * RATE_HZ)) + 50
    ends = np.cumsum(random.exponential(hold_s, count))
    return np.asarray(random.integers(0, 4, count)[np.searchsorted(ends, np.arange(n) / RATE_HZ)])
