"""The fit of a twin: traces with their simulated force in, the kind and the numbers of a hydraulic network out.

Kinds of damper are compared at the position's rate. The best is then fitted at the steps of the twin, with weaker pulls
towards usual values: there is no noise in a simulated force. Blocks left out decide.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ces_data.arrays import F, I, Mask
from ces_gap.baseline.twin import Twin, count_steps, sample_inputs
from ces_gap.effects.effect import column_response
from ces_gap.grid import apply_response, derivative, is_constant, rms
from ces_gap.limits import TwinLimits
from ces_gap.progress import Progress, ignore_progress
from ces_gap.trace import Trace, usable_values
from ces_identify.numerics.search import Limits
from ces_identify.physical.layout import read_scales
from ces_identify.physical.physical_search import PhysicalFit, PhysicalSearch
from ces_identify.schema_files import cache_folder
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.training import Training
from ces_observer.errors import ModelError
from ces_observer.json_text import write_atomically
from ces_observer.model import Envelope
from ces_observer.structures.hydraulic import NEVER_S, Hydraulic

FITTED_BY = ("ces_observer", "ces_data", "ces_identify", "ces_gap")
KINDS = ("uniflow", "twin tube", "magneto-rheological")
GROOVED_KINDS = ("monotube",)  # fitted to the end, too, where the force follows the stroke: most with a groove are
WORK, ROWS = 0.25, 4  # of the comparison of kinds: work of a fit, and curves of the valve
STRENGTHS = (0.03, 0.003)  # of the pulls of the last fit
CLOSE = 1.15  # times the lowest cost: a second kind that is also fitted to the end
MAX_TICKS, MAX_STEPS = 24_000, 60_000  # of both fits: more are thinned out to windows
WINDOW_S, BLOCK_S, EVERY = 4.0, 1.0, 4  # [s], [s] length of a window and of a block; every fourth block is left out
START_UP_S = 0.3  # [s] after the start of a window that does not count
CURRENT_BINS = 6  # of the range of currents; a bin with MIN_BIN_SHARE of the ticks gets a node
MIN_BIN_SHARE, MIN_NODE_GAP = 0.02, 0.5  # the latter relative to a bin
CONSTANT_REACH = 0.5  # of a constant current, by which the characteristic reaches beyond it
MIN_REACH_A = 0.1
MAX_UNDONE = 4.0  # gain by which a column's low-pass is undone at most: faster parts of a force are small


def find_own_twin(simulation: Simulation, traces: Sequence[Trace]) -> Twin | None:
    """Return the simulation itself as its twin, if it is a hydraulic model that is close to the traces on the grid."""
    inside = simulation.innermost
    if not isinstance(inside, ModelSimulation) or not isinstance(inside.model.body, Hydraulic):
        return None
    twin = _with_cost(Twin(inside.model.body, 1.0 / inside.model.sampling.rate_Hz, 0.0), traces)
    return twin if twin.cost_J < TwinLimits.MAX_OWN_COST_J else None


def _with_cost(twin: Twin, traces: Sequence[Trace]) -> Twin:
    """Return the twin with its cost on all ticks of the traces."""
    force = usable_values(traces, [t.simulated for t in traces])
    error = force - usable_values(traces, [twin.prepare_for(t).recorded_force for t in traces])
    return replace(twin, cost_J=100.0 * rms(error) / max(float(force.std()), 1e-9))


def find_twin(traces: Sequence[Trace], threads: int = 1, progress: Progress = ignore_progress) -> Twin | None:
    """Return the twin of the simulation behind the traces, as stored if it was fitted before; None without motion."""
    path = cache_folder() / "twins" / f"{_hash(traces)}.json"
    try:
        return Twin.from_json(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, ModelError):
        pass
    twin = fit_twin(traces, threads, progress)
    if twin is not None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, json.dumps(twin.as_json()))
        except OSError:
            pass  # it is fitted again next time
    return twin


@cache
def _code_digest() -> str:
    digest, here = hashlib.sha256(), Path(__file__).resolve().parents[2]
    for path in sorted(path for package in FITTED_BY for path in (here / package).rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def _hash(traces: Sequence[Trace]) -> str:
    """Return the key of the twin of these traces: they, the kinds, and the code of all packages that the fit uses."""
    digest = hashlib.sha256(f"{KINDS} {_code_digest()}".encode())
    for trace in traces:
        for values in (trace.inputs.position, trace.inputs.current, trace.simulated):
            digest.update(np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()


def fit_twin(traces: Sequence[Trace], threads: int = 1, progress: Progress = ignore_progress) -> Twin | None:
    """Return the twin fitted to the simulated force of the traces; None if they are too short or hold no motion.

    Where its error asks for a column of oil that rings, a network of the same kind is fitted to the valve's force.
    """

    def listen(what: str) -> None:
        progress(f"fitting a twin of the simulation: {what}", 0.0)

    def as_twin(network: tuple[PhysicalFit, float], column_s2: float = 0.0) -> Twin:
        fit, step_s = network
        return Twin(fit.models.hold_pressures(fit.theta).body(fit.theta), step_s, fit.cost, column_s2)

    plain = fit_network(traces, STRENGTHS, threads, listen)
    if plain is None:
        return None
    twin = as_twin(plain)
    column_s2 = find_column(twin, traces)
    if column_s2 == 0.0:
        return twin
    valves = [_with_valve_force(trace, column_s2) for trace in traces]
    again = fit_network(valves, STRENGTHS, threads, listen, (twin.body.kind,))
    ringing = twin if again is None else _with_cost(as_twin(again, column_s2), traces)
    return ringing if ringing.cost_J < _with_cost(twin, traces).cost_J else twin


def find_column(twin: Twin, traces: Sequence[Trace]) -> float:
    """Return mass over stiffness [s²] of a column of oil that the error of a twin without one asks for, 0 if none.

    The error is then a sum of the force's derivatives and of the acceleration (`column_response`).
    """
    parts, errors = [], []
    for trace in traces:
        rate = derivative(trace.simulated, trace.rate_Hz)
        columns = rate, derivative(rate, trace.rate_Hz), trace.acceleration
        parts.append(np.stack(columns, axis=1)[trace.usable])
        errors.append((trace.simulated - twin.prepare_for(trace).recorded_force)[trace.usable])
    matrix, error = np.concatenate(parts), np.concatenate(errors)
    size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-9)
    weights = np.linalg.lstsq(matrix / size, error, rcond=None)[0] / size
    rest = error - matrix @ weights
    column_s2 = -float(weights[1])
    asks = rest @ rest < (1.0 - TwinLimits.MIN_RINGING) * (error @ error)
    return column_s2 if asks and column_s2 * (np.pi * traces[0].rate_Hz) ** 2 > 1.0 else 0.0


def _with_valve_force(trace: Trace, column_s2: float) -> Trace:
    """Return the trace with the force of the valve behind a column in place of the simulated one."""

    def response(frequency: F) -> NDArray[np.complex128]:
        undone = column_response(column_s2, frequency)
        return undone / np.maximum(np.abs(undone) / MAX_UNDONE, 1.0)

    _, base, _ = trace.base_grid
    force = apply_response(trace.simulated_at_base, 1.0 / float(base[1] - base[0]), response)
    return replace(trace, simulated_at_base=force)


def fit_network(
    traces: Sequence[Trace],
    strengths: Sequence[float],
    threads: int,
    progress: Callable[[str], None],
    kinds: Sequence[str] | None = None,
) -> tuple[PhysicalFit, float] | None:
    """Return the network fitted to the simulated force of the traces, with weaker pulls in turn, and its steps [s].

    All `kinds` of a twin are compared if none are given.
    """
    rate_Hz = traces[0].rate_Hz
    alike = [t for t in traces if t.rate_Hz == rate_Hz]
    coarse, tick_s = build_training(alike, 1, MAX_TICKS)
    if not (coarse.estimation.any() and coarse.selection.any()) or np.ptp(coarse.inputs[1]) == 0.0:
        return None
    progress("kinds of damper")
    scales = replace(
        read_scales(coarse, 1.0 / tick_s), relax_s=NEVER_S, currents_A=place_current_nodes(coarse.inputs[2])
    )
    search = PhysicalSearch(Limits(threads=threads, work=WORK), lambda _: None)
    fits = search.run(coarse, scales, kinds or KINDS, ROWS, held=is_constant(coarse.inputs[2]))
    grooved: list[PhysicalFit] = []
    if fits and not kinds and len(fits[0].models.bypassed):
        another = PhysicalSearch(replace(search.limits, stop=search.stop), search.listener)
        grooved = another.run(coarse, scales, GROOVED_KINDS, ROWS, held=is_constant(coarse.inputs[2]))[:1]
    if search.stop.is_set():
        raise KeyboardInterrupt  # the search keeps its best so far, which is no twin
    if not fits:
        return None
    progress(fits[0].models.kind)
    fine, step_s = build_training(alike, max(count_steps(t) for t in alike), MAX_STEPS)
    close = [*[fit for fit in fits if fit.cost < CLOSE * fits[0].cost][:2], *grooved]
    with ThreadPoolExecutor(max(1, threads)) as pool:
        polished = list(pool.map(lambda fit: search.polish(fit, fine, step_s, strengths), close))
    return min(polished, key=lambda fit: fit.cost), step_s


def place_current_nodes(current: F) -> F:
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


def build_training(traces: Sequence[Trace], count: int, max_ticks: int) -> tuple[Training, float]:
    """Return windows of the traces as data of a fit, and the time [s] between ticks; blocks left out choose.

    There are `count` ticks to each tick of a base grid, at which the simulated force is known.
    """
    inputs, measured, usable, out, lengths, owners, step_s = [], [], [], [], [], [], 0.0
    for number, trace in enumerate(traces):
        *rows, step_s = sample_inputs(trace, count)
        force = np.repeat(trace.simulated_at_base, count)[: len(rows[0])]
        ticks = np.arange(len(force))
        usable_steps = np.interp(ticks * step_s, trace.time_s, trace.usable) > 0.99
        for window in _windows(len(force), max_ticks // len(traces), round(WINDOW_S / step_s / count) * count, count):
            at = ticks[window]
            good = usable_steps[window] & (at % count == 0) & (at - at[0] >= START_UP_S / step_s)
            inputs.append(np.stack([row[window] for row in rows]))
            measured.append(force[window])
            usable.append(good)
            out.append((at * step_s / BLOCK_S).astype(np.int64) % EVERY == EVERY - 1)
            lengths.append(len(at))
            owners.append(number)
    ends, of_tick = np.cumsum([0, *lengths]), np.repeat(owners, lengths)
    whole, used, left = np.concatenate(measured), np.concatenate(usable), np.concatenate(out)
    driven = np.concatenate(inputs, axis=1)
    training = Training(
        driven,
        whole,
        np.column_stack([ends[:-1], ends[1:]]),
        np.array(owners, dtype=np.int64),
        _weights(used & ~left, whole, of_tick),
        _weights(used & left, whole, of_tick),
        Envelope(*(_range(row) for row in driven)),
        _range(whole),
        float(whole.std()),
    )
    return training, step_s


def _windows(ticks: int, share: int, length: int, steps: int) -> list[slice]:
    """Return all ticks, or windows of a `length`, evenly spread, if they are more than their share."""
    if ticks <= max(share, length):
        return [slice(0, ticks)]
    starts = np.linspace(0, ticks - length, max(1, share // length)).astype(np.int64) // steps * steps
    return [slice(int(start), int(start) + length) for start in starts]


def _weights(used: Mask, measured: F, of_tick: I) -> F:
    """Return weights (ticks,) with which the squared errors of a trace on the ticks `used` sum to (J / 100)^2."""
    count = int(of_tick.max()) + 1
    ticks = np.maximum(np.bincount(of_tick, used, count), 1.0)
    mean = np.bincount(of_tick, used * measured, count) / ticks
    energy = np.bincount(of_tick, used * (measured - mean[of_tick]) ** 2, count)
    return np.asarray(used / np.maximum(energy, 1e-9)[of_tick])


def _range(values: F) -> tuple[float, float]:
    return float(values.min()), float(values.max())
