"""Models with the physics inside, fitted to simulated forces: examples in, models and their predictions out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_gap.baseline.learner_kernels import low_pass
from ces_gap.baseline.plant import TraceSimulator
from ces_gap.grid import is_constant
from ces_gap.trace import Trace, TraceInputs
from ces_identify.physical.layout import read_scales
from ces_identify.physical.models import free_run
from ces_identify.physical.physical_search import PhysicalFit, PhysicalSearch
from ces_identify.physical.valve_kernels import RunData
from ces_identify.polynomial.search_limits import Limits
from ces_identify.trained.training import Training
from ces_observer.json_text import JsonObject
from ces_observer.model import Envelope
from ces_observer.structures.hydraulic import Hydraulic

LATE_S, LAG_S, YIELD = 0.004, 0.012, 0.05  # [s], [s], share of the stroke: changes of the inputs in the examples
STRONGER, WEAKER = 1.1, 0.9  # shares of the current in the examples


@dataclass(frozen=True)
class SurrogateExample:
    """Inputs on a trace's grid and the force [N] (n,) simulated for them."""

    trace: Trace
    inputs: TraceInputs
    force: F


def make_recorded_examples(traces: Sequence[Trace]) -> list[SurrogateExample]:
    """Return the recorded inputs and simulated forces of the traces as examples."""
    return [SurrogateExample(t, t.inputs, t.simulated) for t in traces]


def make_changed_examples(traces: Sequence[Trace], simulation: TraceSimulator) -> list[SurrogateExample]:
    """Return the recorded examples, and two with changed inputs for each trace, computed by `simulation`.

    Effects make the inputs late and lagging, or yielding with a weaker current.
    """
    examples = make_recorded_examples(traces)
    for trace in traces:
        plain, rate = trace.inputs, trace.rate_Hz
        lagging = STRONGER * low_pass(plain.current, trace.step_s, LAG_S)
        late = plain.with_position(_late(trace), rate).with_current(lagging)
        yielding = plain.with_position(_yielding(trace), rate).with_current(WEAKER * plain.current)
        examples += [SurrogateExample(trace, inputs, simulation.force(trace, inputs)) for inputs in (late, yielding)]
    return examples


def change_one_by_one(trace: Trace) -> list[TraceInputs]:
    """Return typical changes of the inputs by effects: late, yielding, weaker current, lagging current."""
    plain = trace.inputs
    return [
        plain.with_position(_late(trace), trace.rate_Hz),
        plain.with_position(_yielding(trace), trace.rate_Hz),
        plain.with_current(WEAKER * plain.current),
        plain.with_current(low_pass(plain.current, trace.step_s, LAG_S)),
    ]


def _late(trace: Trace) -> F:
    return np.interp(trace.time_s - LATE_S, trace.time_s, trace.inputs.position)


def _yielding(trace: Trace) -> F:
    position = trace.inputs.position
    return np.asarray(position - YIELD * float(np.ptp(position)) * trace.simulated / np.ptp(trace.simulated))


MAX_RATE_HZ = 1e5
FAR = 0.25  # of the range of recorded currents: a current this far from the nearest is far
MIN_CHANGE = 1e-3  # of that distance: a smaller change of the current is none


@dataclass(frozen=True)
class PhysicalForce:
    """A structure with physics inside; the dead time of `body` is counted in ticks at `rate_Hz`."""

    body: Hydraulic
    rate_Hz: float

    def predict(self, inputs: TraceInputs, rate_Hz: float) -> F:
        """Return the force [N] (n,) of a free run over inputs at `rate_Hz`."""
        valve = self.body.valve
        delay = valve.delay_ticks * rate_Hz / self.rate_Hz
        body = replace(self.body, valve=replace(valve, delay_ticks=delay))
        position, speed, current = map(np.ascontiguousarray, (inputs.position, inputs.speed, inputs.current))
        return free_run(body, 1.0 / rate_Hz, RunData(position, speed, current, np.array([[0, len(position)]])))

    def distance_from_currents(self, trace: Trace, inputs: TraceInputs) -> F:
        """Return how far changed currents (n,) are from those that were often recorded: 0 at them, at most 1.

        The nodes of the valve's characteristic are those currents, but for its ends.
        """
        at = np.array(self.body.valve.characteristic.at)
        known = at[1:-1]
        scale = FAR * (float(np.ptp(known)) if len(known) > 1 else float(at[-1] - at[-2]))
        distance = np.abs(inputs.current[:, None] - known).min(axis=1) / scale
        changed = np.abs(inputs.current - trace.inputs.current) > MIN_CHANGE * scale
        return np.where(changed, np.minimum(distance, 1.0), 0.0)

    def as_json(self) -> dict[str, Any]:
        """Return the model as plain values."""
        return {"structure": self.body.name, "rate_Hz": self.rate_Hz, **self.body.to_json()}

    @classmethod
    def from_json(cls, document: JsonObject) -> PhysicalForce:
        """Return the model from `as_json`; raises ModelError if the document is not one."""
        document.choice("structure", (Hydraulic.name,))
        return cls(Hydraulic.from_json(document, {}), document.number("rate_Hz", 1.0, MAX_RATE_HZ))


BLOCK_S, EVERY = 1.0, 4  # [s] length of a block; every fourth is left out
START_UP_S = 0.3  # [s] after the start of a free run that does not count
MAX_TICKS = 40_000  # of all examples together: more are thinned out to windows of WINDOW_S
WINDOW_S = 5.0
SHORT = 0.25  # work of a fit
KINDS = ("twin tube", "magneto-rheological")  # of dampers, unlike each other, whose forces are weighed
ROWS = 2  # curves of the valve
CURRENT_BINS = 6  # of the range of currents; a bin with MIN_BIN_SHARE of the ticks gets a node
MIN_BIN_SHARE, MIN_NODE_GAP = 0.02, 0.5  # the latter relative to a bin
CONSTANT_REACH = 0.5  # of a constant current, by which the characteristic reaches beyond it
MIN_REACH_A = 0.1


def left_out(example: SurrogateExample) -> Mask:
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
    search = PhysicalSearch(Limits(threads=1, work=SHORT), lambda _: None)
    best: dict[str, PhysicalFit] = {}
    for fit in search.run(training, scales, KINDS, ROWS, held=is_constant(training.inputs[2])):
        best.setdefault(fit.models.kind, fit)
    fits = list(best.values())
    return [PhysicalForce(fit.models.hold_pressures(fit.theta).body(fit.theta), rate_Hz) for fit in fits]


def _place_current_nodes(current: F) -> F:
    """Return nodes [A] of the valve's characteristic: one at each current that occurs often, one beyond either end.

    Between currents that were recorded nothing is known but that the characteristic rises: it is a straight line there.
    """
    low, high, middle = float(current.min()), float(current.max()), float(current.mean())
    if is_constant(current):
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
    rows = [np.stack([e.inputs.position, e.inputs.speed, e.inputs.current]) for e in examples]
    inputs = np.concatenate([rows[number][:, window] for number, window in windows], axis=1)
    measured = np.concatenate([examples[number].force[window] for number, window in windows])
    usable = np.concatenate([examples[number].trace.usable[window] for number, window in windows])
    out = np.concatenate([left_out(examples[number])[window] for number, window in windows])
    started = np.arange(len(usable)) - np.repeat(ends[:-1], np.diff(ends)) >= round(START_UP_S * rate_Hz)
    recordings = np.array([number for number, _ in windows], dtype=np.int64)
    of_tick = np.repeat(recordings, np.diff(ends))
    selection, estimation = usable & started & out, usable & started & ~out
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


def _weights(used: Mask, measured: F, of_tick: I) -> F:
    """Return weights (ticks,) with which the squared errors of an example on the ticks `used` sum to (J / 100)^2."""
    count = int(of_tick.max()) + 1
    ticks = np.maximum(np.bincount(of_tick, used, count), 1.0)
    mean = np.bincount(of_tick, used * measured, count) / ticks
    energy = np.bincount(of_tick, used * (measured - mean[of_tick]) ** 2, count)
    return np.asarray(used / np.maximum(energy, 1e-9)[of_tick])


def _range(values: F) -> tuple[float, float]:
    return float(values.min()), float(values.max())
