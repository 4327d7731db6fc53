"""What the exported C of relaxation models and chambers has in common: limits of the inputs, valve path, side forces.

templates/physical.{c,h}.j2 hold the C. A curve becomes three tables: its nodes, its values and the slopes between them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ces_identify.export.c_text import ConstantTable
from ces_observer.model import Model
from ces_observer.structures.flow_map import FlowMap
from ces_observer.structures.reach import widen
from ces_observer.structures.side_forces import SideForces
from ces_observer.structures.structure import Range
from ces_observer.structures.valve_path import PLAYS, ValvePath


@dataclass(frozen=True)
class InputLimits:
    """An input's range in the envelope, and that beyond which it is clamped."""

    name: str
    argument: str
    envelope: Range
    reach: Range


def physical_facts(valve: ValvePath, side: SideForces, reach: float, model: Model) -> dict[str, object]:
    """Return the values for templates/physical.{c,h}.j2; the tick has them beside those of its own core."""
    interval = 1.0 / model.sampling.rate_Hz
    whole = int(valve.delay_ticks)
    return {
        "inputs": _limits(model, reach),
        "reach": reach,
        "interval_s": interval,
        "per_s": 1.0 / interval,
        "rise": interval / (valve.rise_s + interval),
        "fall": interval / (valve.fall_s + interval),
        "delay": whole,
        "share": valve.delay_ticks - whole,
        "ring": 1 << (whole + 1).bit_length() if valve.delay_ticks > 0.0 else 0,
        "halves": [valve.hysteresis_A * play for play in PLAYS] if valve.hysteresis_A > 0.0 else [],
        "side": side,
        "frictions": [(one.stiffness_N_m * interval, one.yield_N) for one in side.friction],
        "curve_tables": [
            *curve_tables("CURRENTS", "SETTINGS", valve.characteristic.at, valve.characteristic.values),
            *curve_tables("POSITIONS", "GAS", side.position_m, side.gas_N),
        ],
    }


def _limits(model: Model, reach: float) -> list[InputLimits]:
    inputs = model.envelope.by_signal
    wide = widen(inputs, reach)
    arguments = {"position": "position_m", "speed": "speed_m_s", "current": "current_A"}
    return [InputLimits(name, argument, inputs[name], wide[name]) for name, argument in arguments.items()]


def curve_tables(at_name: str, name: str, at: Sequence[float], values: Sequence[float]) -> list[ConstantTable]:
    """Return the tables of a curve: AT_NAME, NAME and NAME_SLOPES."""
    return [
        ConstantTable(at_name, at),
        ConstantTable(name, values),
        ConstantTable(f"{name}_SLOPES", find_slopes(at, values)),
    ]


def map_tables(flow: FlowMap) -> list[ConstantTable]:
    """Return the tables of a valve's map: FLOWS, and by row FORCES and FORCES_SLOPES."""
    slopes = [find_slopes(flow.at, row) for row in flow.rows]
    return [
        ConstantTable("FLOWS", flow.at),
        ConstantTable("FORCES", _join(flow.rows), len(flow.at)),
        ConstantTable("FORCES_SLOPES", _join(slopes), len(flow.at) - 1),
    ]


def find_slopes(at: Sequence[float], values: Sequence[float]) -> list[float]:
    """Return the slopes of a curve's pieces."""
    return [(y1 - y0) / (x1 - x0) for (x0, x1), (y0, y1) in zip(pairwise(at), pairwise(values), strict=True)]


def _join(rows: Iterable[Sequence[float]]) -> list[float]:
    return [value for row in rows for value in row]
