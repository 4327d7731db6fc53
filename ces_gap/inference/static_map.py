"""The static map: a smooth function of stroke, speed and current that a recalibration of the simulation could absorb.

Without references it is projected out of the residuals. Effects that it could replace are reported as not separable
from calibration.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ces_gap.baseline.dictionary import SAME_CURRENT
from ces_gap.inference.evidence import Evidence
from ces_gap.inference.fit import EffectFit
from ces_gap.trace import F, Trace

MIN_ABSORBED_SHARE = 0.8  # share of a signature's energy inside the map that makes the effect not separable


def static_features(traces: Sequence[Trace]) -> list[F]:
    """Return the map's features (n, q) on each trace: low powers of stroke, speed and current."""
    x, v, i = (
        np.concatenate([getattr(t.inputs, n)[t.usable] for t in traces]) for n in ("position", "speed", "current")
    )
    centre, spread = float(x.mean()), max(float(x.std()), 1e-9)
    fast, mean, swing = max(float(v.std()), 1e-9), float(i.mean()), float(i.std())
    varies = swing > SAME_CURRENT * max(abs(mean), 1e-9)
    return [
        _powers(
            (t.inputs.position - centre) / spread,
            t.inputs.speed / fast,
            (t.inputs.current - mean) / swing if varies else None,
        )
        for t in traces
    ]


def _powers(x: F, v: F, i: F | None) -> F:
    soft = v / np.sqrt(0.04 + v * v)
    columns = [np.ones_like(x), x, x * x, v, v * np.abs(v), v * v, soft, x * v]
    if i is not None:
        columns += [i, i * i, i * v, i * v * np.abs(v), i * soft, i * x]
    return np.stack(columns, axis=1)


def find_absorbed_effects(evidence: Evidence, fits: Sequence[EffectFit]) -> tuple[str, ...]:
    """Return the effects whose signatures lie mostly inside the map."""
    absorbed = []
    for fit in fits:
        forces = evidence.forces(fit.composition)
        added = [f - a for f, a in zip(forces, evidence.alone, strict=True)]
        whole = np.concatenate([evidence.noise.whiten(added[u.trace])[u.ticks] for u in evidence.units])
        outside = evidence.whiten(added)
        if outside @ outside < (1.0 - MIN_ABSORBED_SHARE) * (whole @ whole):
            absorbed.append(fit.names[0])
    return tuple(absorbed)
