"""The generic learner's dictionary: fading-memory functions of motion, current and simulated force.

It is linear in its weights, its memory fades, and the learnt force is not fed back: it is stable for any weights. It
learns the baseline error from references, is the surrogate of recorded predictions, and computes the ceiling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ces_gap.baseline.learner_kernels import fill_features
from ces_gap.trace import F, Trace, TraceInputs

MEMORIES_S = np.array([0.003, 0.010, 0.030])  # [s] fading memories of force and speed
VALVE_S = np.array([0.006, 0.025])  # [s] fading memories of the current
TURNS = np.array([0.01, 0.05, 0.2])  # radii of the stop operators over the stroke's scale
SPEED_KNOTS = np.array([-3.0, -2.2, -1.4, -0.7, 0.0, 0.7, 1.4, 2.2, 3.0])  # of asinh(speed over a tenth of its RMS)
FORCE_KNOTS = np.array([-2.0, -1.2, -0.6, -0.2, 0.2, 0.6, 1.2, 2.0])  # of force over its RMS
COARSE_KNOTS = np.array([-3.0, -1.0, 1.0, 3.0])
SAME_CURRENT = 0.02  # relative spread below which a current counts as constant


@dataclass(frozen=True)
class Scales:
    """Scales of the features: centres and spreads of the training inputs, SI."""

    position: tuple[float, float]
    speed: float
    current: tuple[float, float]
    force: tuple[float, float]
    varies: bool  # whether the current varies

    @classmethod
    def of(cls, traces: Sequence[Trace], forces: Sequence[F]) -> Scales:
        """Return the scales of the usable ticks of the traces and their forces."""
        keep = [t.usable for t in traces]
        x, v, i = (
            np.concatenate([getattr(t.inputs, name)[k] for t, k in zip(traces, keep, strict=True)])
            for name in ("position", "speed", "current")
        )
        f = np.concatenate([force[k] for force, k in zip(forces, keep, strict=True)])
        spread = float(i.std())
        varies = spread > SAME_CURRENT * max(abs(float(i.mean())), 1e-9)
        return cls(
            (float(x.mean()), max(float(x.std()), 1e-9)),
            max(float(np.sqrt((v**2).mean())), 1e-9),
            (float(i.mean()), spread if varies else 1.0),
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

    def require_weights(self, weights: F) -> None:
        """Raise ValueError unless each feature has a finite weight: compiled code does not check."""
        if self.by_time or weights.shape != (self.size,) or not np.isfinite(weights).all():
            raise ValueError(f"weights of shape {weights.shape}; expected {self.size} finite ones")

    def _time_features(self, trace: Trace, inputs: TraceInputs, force: F) -> F:
        f = (force - self.scales.force[0]) / self.scales.force[1]
        t = trace.time_s / max(float(trace.time_s[-1]), 1.0)
        heat = np.cumsum(np.abs(force * inputs.speed))
        heat = heat / max(float(heat[-1]), 1e-9)
        return np.stack([t, t * t, t * f, heat * f, heat], axis=1)

    def as_json(self) -> dict[str, Any]:
        """Return the dictionary as plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> Dictionary:
        """Return the dictionary from `as_json`; raises KeyError, TypeError or ValueError if the document is not one."""
        s = document["scales"]
        pair = {k: (float(s[k][0]), float(s[k][1])) for k in ("position", "current", "force")}
        scales = Scales(pair["position"], float(s["speed"]), pair["current"], pair["force"], bool(s["varies"]))
        return cls(scales, bool(document["by_force"]), bool(document["by_time"]))
