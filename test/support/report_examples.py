"""A polynomial model and recordings of a damper much like it, for reports."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from samplings import make_sampling

from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import Series, prepare
from ces_identify.simulations.simulate import simulate_series
from ces_observer.model import Envelope, Model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

SAMPLING = make_sampling(500.0, 0.01)
WIDE = Envelope((-0.1, 0.1), (-3.0, 3.0), (0.0, 2.0))
TERMS = (
    Term(0.8, (Factor("force", 1),)),
    Term(240.0, (Factor("speed", 0, 0.5), Factor("current", 5, 2.0, signed=False))),
    Term(90.0, (Factor("speed", 2, 1.0),)),
    Term(-60.0, (Factor("speed", 0, 1.5, signed=False),)),
    Term(0.02, (Factor("current", 0, 1.0, signed=False), Factor("force", 1))),
    Term(-4.5, ()),
)


def damper(
    name: str, ticks: int = 3000, current_A: float | None = None, gaps: int = 0, seed: int = 1, rate_Hz: float = 500.0
) -> Series:
    """A damper of the same structure as the model, with one more effect and noise, stroked by two sines."""
    sampling = replace(SAMPLING, rate_Hz=rate_Hz)
    rng = np.random.default_rng(seed)
    time = np.arange(ticks) / rate_Hz
    position = 0.02 * np.sin(2 * np.pi * 3.0 * time) + 0.004 * np.sin(2 * np.pi * 7.3 * time + seed)
    current = 0.5 + 0.2 * np.sin(2 * np.pi * 0.4 * time + seed) if current_A is None else np.full(ticks, current_A)
    stamps = np.rint(time * 1e9).astype(np.int64)
    kept = np.ones(ticks, bool)
    for start in np.linspace(0, ticks, gaps + 2, dtype=int)[1:-1]:
        kept[start : start + 150] = False
    values = {"position": position, "current": current, "force": np.zeros(ticks)}
    units = {"position": "m", "current": "A", "force": "N"}
    channels = {key: Channel(key, units[key], stamps[kept], v[kept]) for key, v in values.items()}
    series = prepare(Recording(name, channels), sampling)
    force = simulate_series(model(sampling=sampling), series).force + 30.0 * np.tanh(series.speed / 0.05)
    return replace(series, force=force + 5.0 * rng.normal(size=len(series)))


def model(**changes: object) -> Model:
    first = Model(SAMPLING, Polynomial(TERMS), WIDE, (-9000.0, 9000.0), provenance={"tool": "ces_observer"})
    return replace(first, **changes)
