"""Signatures of effects: the force that an effect adds to the plant on some traces, with derivatives by its parameters.

Parameters are scaled to the unit box: 0 and 1 are the bounds on a parameter's search scale.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_gap.baseline.plant import Plant
from ces_gap.effects.effect import Composition, Effect, EffectParameter, Setting
from ces_gap.trace import F, Trace

Whiten = Callable[[int, F], F]  # index of a trace, force [N] (n,) on it -> (m,) with noise of unit variance

STEP = 1e-3  # of a parameter's range: forward differences
FAN, RERUN_FAN = 2, 1  # points of a fan besides the fitted one; of effects that rerun the simulation
NONE = Composition()


@dataclass(frozen=True)
class Signature:
    """The force that an effect adds on each trace, `forces` [N] (n,), and its derivatives, `columns` [N] (n, p).

    Unusable ticks are zero; `ticks` counts the usable ones.
    """

    setting: Setting
    forces: tuple[F, ...]
    columns: tuple[F, ...]
    ticks: int


@dataclass(frozen=True)
class Tangent:
    """A whitened signature on all traces, concatenated: `force` (m,), derivatives (m, p) = `q` (m, p) @ `r` (p, p)."""

    signature: Signature
    force: F
    q: F
    r: F

    @property
    def setting(self) -> Setting:
        """The effect and the values at the point of contact."""
        return self.signature.setting

    @property
    def size(self) -> float:
        """How visible the effect is: the norm of its whitened signature."""
        return float(np.linalg.norm(self.force))


@dataclass(frozen=True)
class Probe:
    """Computes signatures for `plant` on `traces`, together with the effects of `around`.

    `whiten` must be linear. `around` must not contain the effect itself.
    """

    plant: Plant
    traces: Sequence[Trace]
    whiten: Whiten
    around: Composition = NONE

    def forces(self, setting: Setting) -> tuple[F, ...]:
        """Return the force [N] (n,) that `setting` adds on each trace."""
        forces = self._forces(Composition((*self.around.settings, setting)))
        rows = zip(self.traces, forces, self._forces_without, strict=True)
        return tuple(np.where(t.usable, force - without, 0.0) for t, force, without in rows)

    def compute_signature(self, setting: Setting) -> Signature:
        """Return the signature at `setting`; the simulation runs 1 + p times on each trace if the effect reruns it."""
        forces, point = self.forces(setting), to_unit(setting)
        columns = [np.zeros((len(t), len(point))) for t in self.traces]
        for j in range(len(point)):
            step = STEP if point[j] + STEP <= 1.0 else -STEP
            shifted = self.forces(from_unit(setting.effect, point + step * np.eye(len(point))[j]))
            for column, f, g in zip(columns, forces, shifted, strict=True):
                column[:, j] = (g - f) / step
        return Signature(setting, forces, tuple(columns), sum(int(t.usable.sum()) for t in self.traces))

    def tangent(self, setting: Setting) -> Tangent:
        """Return the tangent at `setting`."""
        signature = self.compute_signature(setting)
        force = _whiten_forces(signature.forces, self.whiten)
        columns = [
            _whiten_forces([c[:, j] for c in signature.columns], self.whiten) for j in range(len(setting.values))
        ]
        q, r = np.linalg.qr(np.array(columns).T.reshape(len(force), -1))
        return Tangent(signature, force, q, r)

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
    def _forces_without(self) -> list[F]:
        return self._forces(self.around)


def sample_tangents(probe: Probe, fitted: Tangent, size: float) -> list[Tangent]:
    """Return tangents of an effect at its fitted values and at a few of its starts.

    At the starts, magnitudes are scaled for a signature of norm `size`, that of the gap.
    """
    effect = fitted.setting.effect
    count = min(RERUN_FAN if effect.reruns else FAN, max((len(p.starts) for p in effect.parameters), default=0))
    starts = [Setting(effect, tuple(p.starts[k % len(p.starts)] for p in effect.parameters)) for k in range(count)]
    points = dict.fromkeys(_scale_setting(s, size / max(probe.size(s), 1e-9 * size)) for s in starts)
    return [fitted, *(probe.tangent(p) for p in points if p != fitted.setting)]


def to_unit(setting: Setting) -> F:
    """Return the values (p,) as shares of their search ranges."""
    pairs = list(zip(setting.effect.parameters, setting.values, strict=True))
    return np.array([(p.to_search(v) - p.search_bounds()[0]) / _width(p) for p, v in pairs])


def from_unit(effect: Effect, point: F) -> Setting:
    """Return the setting at the shares `point` (p,) of the search ranges; the inverse of `to_unit`."""
    pairs = zip(effect.parameters, point, strict=True)
    return Setting(effect, tuple(p.to_value(p.search_bounds()[0] + float(u) * _width(p)) for p, u in pairs))


def _width(parameter: EffectParameter) -> float:
    low, high = parameter.search_bounds()
    return max(high - low, 1e-300)


def _scale_setting(setting: Setting, factor: float) -> Setting:
    """Return the setting with the distances of its magnitudes from neutral scaled by `factor`, inside the bounds."""
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
