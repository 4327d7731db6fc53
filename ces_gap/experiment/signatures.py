"""What an effect looks like on given traces: the force it adds to the plant's, and how that turns with its values.

Values are searched in the unit box: 0 and 1 are a parameter's bounds on its own scale. Derivatives are by that number.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.trace import Trace

F = NDArray[np.float64]
Whiten = Callable[[int, F], F]  # index of the trace, a force [N] (n,) on it -> (m,) in which noise has unit variance

STEP = 1e-3  # of a parameter's range: forward differences
FAN, RERUN_FAN = 2, 1  # points of a fan besides the fitted one, of effects that rerun the simulation
NONE = Composition()


@dataclass(frozen=True)
class Signature:
    """An effect's added force on each trace, `forces` [N] each (n,), and its derivatives, `columns` [N] each (n, p).

    Ticks that are not usable hold zeros; `ticks` counts the others.
    """

    setting: Setting
    forces: tuple[F, ...]
    columns: tuple[F, ...]
    ticks: int


@dataclass(frozen=True)
class Tangent:
    """A signature whitened, all traces in one: `force` (m,), and the derivatives (m, p) = `q` (m, p) @ `r` (p, p)."""

    signature: Signature
    force: F
    q: F
    r: F

    @property
    def setting(self) -> Setting:
        """The effect and the values at which the tangent was taken."""
        return self.signature.setting

    @property
    def size(self) -> float:
        """How visible the effect is: the norm of its whitened signature."""
        return float(np.linalg.norm(self.force))


@dataclass(frozen=True)
class Probe:
    """Where signatures are taken: `plant` on `traces`, inside the effects of `around`, seen through `whiten`.

    `whiten` must be linear. `around` must not hold the effect that is probed.
    """

    plant: Plant
    traces: Sequence[Trace]
    whiten: Whiten
    around: Composition = NONE

    def forces(self, setting: Setting) -> tuple[F, ...]:
        """Return the force [N] (n,) that `setting` adds on each trace."""
        forces = self._forces(Composition((*self.around.settings, setting)))
        rows = zip(self.traces, forces, self._without, strict=True)
        return tuple(np.where(t.usable, with_it - without, 0.0) for t, with_it, without in rows)

    def signature(self, setting: Setting) -> Signature:
        """Return the signature at `setting`; the simulation runs 1 + p times on each trace if the effect reruns it."""
        forces, point = self.forces(setting), to_unit(setting)
        columns = [np.zeros((len(t), len(point))) for t in self.traces]
        for j in range(len(point)):
            step = STEP if point[j] + STEP <= 1.0 else -STEP
            beside = self.forces(from_unit(setting.effect, point + step * np.eye(len(point))[j]))
            for column, f, g in zip(columns, forces, beside, strict=True):
                column[:, j] = (g - f) / step
        return Signature(setting, forces, tuple(columns), sum(int(t.usable.sum()) for t in self.traces))

    def tangent(self, setting: Setting) -> Tangent:
        """Return the tangent at `setting`."""
        return whiten_signature(self.signature(setting), self.whiten)

    def size(self, setting: Setting) -> float:
        """Return the norm of the whitened signature."""
        return float(np.linalg.norm(_whiten_forces(self.forces(setting), self.whiten)))

    def _forces(self, composition: Composition) -> list[F]:
        return [p.with_effects(composition, t, alone=a) for t, (p, a) in zip(self.traces, self._plants, strict=True)]

    @cached_property
    def _plants(self) -> list[tuple[Plant, F]]:
        """The plant prepared for each trace, and its force alone [N] (n,)."""
        return [(self.plant.prepare_for(t), self.plant.alone(t)) for t in self.traces]

    @cached_property
    def _without(self) -> list[F]:
        return self._forces(self.around)


def whiten_signature(taken: Signature, whiten: Whiten) -> Tangent:
    """Return the tangent of a signature."""
    count = len(taken.setting.values)
    force = _whiten_forces(taken.forces, whiten)
    columns = np.empty((len(force), count))
    for j in range(count):
        columns[:, j] = _whiten_forces([c[:, j] for c in taken.columns], whiten)
    q, r = np.linalg.qr(columns)
    return Tangent(taken, force, q, r)


def sample_tangents(probe: Probe, fitted: Tangent, size: float) -> list[Tangent]:
    """Return tangents of an effect at its fitted values and at a few of its starts.

    There its magnitudes are scaled for a signature of norm `size`, that of the gap.
    """
    effect = fitted.setting.effect
    count = min(RERUN_FAN if effect.reruns else FAN, max((len(p.starts) for p in effect.parameters), default=0))
    starts = [Setting(effect, tuple(p.starts[k % len(p.starts)] for p in effect.parameters)) for k in range(count)]
    points = dict.fromkeys(_scale_setting(s, size / max(probe.size(s), 1e-9 * size)) for s in starts)
    return [fitted, *(probe.tangent(p) for p in points if p != fitted.setting)]


def to_unit(setting: Setting) -> F:
    """Return the values (p,) as shares of their searched ranges."""
    pairs = list(zip(setting.effect.parameters, setting.values, strict=True))
    return np.array([(p.to_search(v) - p.search_bounds()[0]) / _width(p) for p, v in pairs])


def from_unit(effect: Effect, point: F) -> Setting:
    """Return the setting at the shares `point` (p,) of the searched ranges; the opposite of `to_unit`."""
    pairs = zip(effect.parameters, point, strict=True)
    return Setting(effect, tuple(p.to_value(p.search_bounds()[0] + float(u) * _width(p)) for p, u in pairs))


def _width(parameter: EffectParameter) -> float:
    low, high = parameter.search_bounds()
    return max(high - low, 1e-300)


def _scale_setting(setting: Setting, factor: float) -> Setting:
    """Return the setting with its magnitudes moved away from their neutral values by `factor`, inside the bounds."""
    pairs = zip(setting.effect.parameters, setting.values, strict=True)
    return Setting(setting.effect, tuple(_scale_magnitude(p, v, factor) if p.magnitude else v for p, v in pairs))


def _scale_magnitude(parameter: EffectParameter, value: float, factor: float) -> float:
    if parameter.scale == "inverse":
        value /= max(factor, 1e-12)
    else:
        value = parameter.neutral + factor * (value - parameter.neutral)
    return float(min(max(value, parameter.low), parameter.high))


def _whiten_forces(forces: Sequence[F], whiten: Whiten) -> F:
    return np.concatenate([whiten(k, f) for k, f in enumerate(forces)])
