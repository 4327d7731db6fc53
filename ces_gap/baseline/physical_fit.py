"""The fit of structures with the physics inside to simulated forces: examples in, models and their ticks left out.

The predictions of a simulation are free of noise, and what it simulates is a damper: the identification's own physical
structures describe it better than a dictionary of features. One start of each, by free run; every fourth block is left
out for the choice of the penalty, and to weigh models against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ces_gap.baseline.dictionary import SAME_CURRENT
from ces_gap.baseline.physical_force import PhysicalForce
from ces_gap.baseline.surrogate_examples import SurrogateExample
from ces_gap.trace import B, F
from ces_identify.numerics.arrays import I
from ces_identify.physical.chambers_models import ChambersModels
from ces_identify.physical.common_groups import read_scales
from ces_identify.physical.models import PhysicalModels
from ces_identify.physical.physical_search import PhysicalSearch
from ces_identify.physical.relaxation_models import RelaxationModels
from ces_identify.polynomial.search_limits import Limits
from ces_identify.trained.training import Training
from ces_observer.model import Envelope

BLOCK_S, EVERY = 1.0, 4  # [s] length of a block; every fourth is left out
SETTLE_S = 0.3  # [s] after the start of a free run that does not count
MAX_TICKS = 40_000  # of all examples together: more are thinned out to windows of WINDOW_S
WINDOW_S = 5.0
MAX_SECONDS = 60.0  # of one fit: a fit ends by itself long before
SPRINGS, ROWS = 2, 2  # yielding springs, force-speed curves
CURRENT_BINS = 6  # of the range of currents; a bin with MIN_BIN_SHARE of the ticks gets a node
MIN_BIN_SHARE, MIN_NODE_GAP = 0.02, 0.5  # the latter relative to a bin
CONSTANT_REACH = 0.5  # of a constant current, by which the characteristic reaches beyond it
MIN_REACH_A = 0.1


def left_out(example: SurrogateExample) -> B:
    """Return the usable ticks (n,) of the blocks left out of the fit."""
    block = (example.trace.time_s / BLOCK_S).astype(np.int64)
    return np.asarray(example.trace.usable & (block % EVERY == EVERY - 1))


def fit_physical_forces(examples: Sequence[SurrogateExample]) -> list[PhysicalForce]:
    """Return the physical models that could be fitted; none if the examples are too short or hold no motion."""
    rate_Hz = examples[0].trace.rate_Hz
    alike = [e for e in examples if e.trace.rate_Hz == rate_Hz]
    training = _build_training(alike, rate_Hz)
    if not (training.estimation.any() and training.selection.any()) or np.ptp(training.inputs[1]) == 0.0:
        return []
    scales = replace(read_scales(training, rate_Hz), currents_A=_place_current_nodes(training.inputs[2]))
    candidates: list[PhysicalModels] = [
        RelaxationModels(training, scales, springs=SPRINGS, rows=ROWS),
        ChambersModels(training, scales, rows=ROWS),
    ]
    fitted = (_fit(models, rate_Hz) for models in candidates)
    return [one for one in fitted if one is not None]


def _fit(models: PhysicalModels, rate_Hz: float) -> PhysicalForce | None:
    search = PhysicalSearch(Limits(seconds=MAX_SECONDS, starts=1, threads=1), lambda _: None)
    fits = search.run(models, ())
    return PhysicalForce(models.body(fits[0].theta), rate_Hz) if fits else None


def _place_current_nodes(current: F) -> F:
    """Return nodes [A] of the valve's characteristic: one at each current that occurs often, one beyond either end.

    Between currents that were recorded nothing is known but that the characteristic rises: it is a straight line there.
    """
    low, high, middle = float(current.min()), float(current.max()), float(current.mean())
    if current.std() <= SAME_CURRENT * max(abs(middle), 1e-9):
        reach = max(CONSTANT_REACH * abs(middle), MIN_REACH_A)
        return np.array([middle - reach, middle, middle + reach])
    width = (high - low) / CURRENT_BINS
    levels: list[float] = []
    for k in range(CURRENT_BINS):
        inside = current[(current >= low + k * width) & (current <= low + (k + 1) * width)]
        if len(inside) < MIN_BIN_SHARE * len(current):
            continue
        level = float(np.median(inside))
        if levels and level - levels[-1] < MIN_NODE_GAP * width:
            levels[-1] = 0.5 * (levels[-1] + level)
        else:
            levels.append(level)
    gaps = np.diff(levels) if len(levels) > 1 else np.array([high - low])
    return np.array([levels[0] - gaps[0], *levels, levels[-1] + gaps[-1]])


def _build_training(examples: Sequence[SurrogateExample], rate_Hz: float) -> Training:
    """Return the windows of the examples as data of a fit; the left-out blocks serve the selection."""
    windows = [(number, window) for number, e in enumerate(examples) for window in _windows(e, len(examples), rate_Hz)]
    ends = np.cumsum([0, *(window.stop - window.start for _, window in windows)])
    inputs = np.concatenate([_inputs(examples[number])[:, window] for number, window in windows], axis=1)
    measured = np.concatenate([examples[number].force[window] for number, window in windows])
    used = [
        (_find_settled_ticks(examples[number], window, rate_Hz), left_out(examples[number])[window])
        for number, window in windows
    ]
    recordings = np.array([number for number, _ in windows], dtype=np.int64)
    of_tick = np.repeat(recordings, np.diff(ends))
    selection = np.concatenate([settled & out for settled, out in used])
    estimation = np.concatenate([settled & ~out for settled, out in used])
    return Training(
        inputs,
        measured,
        np.column_stack([ends[:-1], ends[1:]]),
        recordings,
        _weights(estimation, measured, of_tick),
        _weights(selection, measured, of_tick),
        Envelope(*(_range(row) for row in inputs)),
        _range(measured),
        float(measured.std()),
    )


def _windows(example: SurrogateExample, count: int, rate_Hz: float) -> list[slice]:
    """Return the whole example, or windows of it, evenly spread, if it is longer than its share of `MAX_TICKS`."""
    ticks, length = len(example.trace), round(WINDOW_S * rate_Hz)
    share = MAX_TICKS // count
    if ticks <= max(share, length):
        return [slice(0, ticks)]
    starts = np.linspace(0, ticks - length, max(1, share // length)).astype(np.int64)
    return [slice(int(start), int(start) + length) for start in starts]


def _inputs(example: SurrogateExample) -> F:
    return np.stack([example.inputs.position, example.inputs.speed, example.inputs.current])


def _find_settled_ticks(example: SurrogateExample, window: slice, rate_Hz: float) -> B:
    """Return the usable ticks of the window behind the settling of its free run."""
    settled = example.trace.usable[window].copy()
    settled[: round(SETTLE_S * rate_Hz)] = False
    return settled


def _weights(used: B, measured: F, of_tick: I) -> F:
    """Return weights (ticks,) with which the squared errors of an example on the ticks `used` sum to (J / 100)^2."""
    count = int(of_tick.max()) + 1
    ticks = np.maximum(np.bincount(of_tick, used, count), 1.0)
    mean = np.bincount(of_tick, used * measured, count) / ticks
    energy = np.bincount(of_tick, used * (measured - mean[of_tick]) ** 2, count)
    return np.asarray(used / np.maximum(energy, 1e-9)[of_tick])


def _range(values: F) -> tuple[float, float]:
    return float(values.min()), float(values.max())
