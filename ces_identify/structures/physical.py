"""The report of a structure with physics inside: its quantities and curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_identify.physical import quantities
from ces_identify.prepare.series import SimulatedSeries
from ces_observer.model import Model
from ces_observer.structures.hydraulic import EDGES, Hydraulic
from ces_report.typesetting import Chart, ChartCurve, ModelTable, TableColumn, four_figures, minus

IN_95_PERCENT = 1.96  # standard errors of a normal distribution
SIGNED = ("Lead", "Gas", "Stiffness of the gas", "Flow gained")  # quantities that may be negative
ABOUT = (
    "Intervals hold for the noise of these recordings and the penalty, if the damper has this structure. A dash stands "
    "for a value at the end of its range, or for too few data."
)
NO_ERRORS = "This model was stored without standard errors."
FORCE = (
    "Steady force at mid-stroke, after a stroke at constant speed, with friction, without gas force and preload. "
    "Shaded: 95 % intervals. Dashed: speeds beyond those recorded about that current."
)
VALVES = (
    "What each valve does: pressure drop over flow, both on the annulus, positive out of the compression chamber and, "
    "for the external valve, out of the rebound chamber. What the current moves is shown at its lowest and highest."
)
SETTING = (
    "Setting of the valve, from 0 at the lowest current recorded to 1 at the highest, in the middle of the magnetic "
    "loop. Shaded: 95 % interval."
)
CURVE_SPEEDS = 61


def physical_table(body: Hydraulic, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the damper's quantities with standard errors and intervals, and charts of its curves."""
    errors = model.provenance.get("selection", {}).get(quantities.ERRORS, {})
    values = quantities.read_quantities(body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m)
    rows = tuple(_row(name, value, errors.get("quantities", {}).get(name, 0.0)) for name, value in values.items())
    columns = (
        TableColumn(Markup("Quantity"), "", ""),
        *(TableColumn(Markup(head)) for head in ("Value", "Standard error", "95&#160;% interval")),
    )
    charts = (_steady_chart(body, model, errors), _setting_chart(body, errors), _valve_chart(body))
    note = ABOUT if errors else NO_ERRORS
    return ModelTable("damper", "The damper", Markup(""), columns, rows, note, charts=charts)


def _row(name: str, value: float, error: float) -> tuple[Markup, ...]:
    if not isfinite(error) or error <= 0.0:
        return Markup("{}").format(name), four_figures(value), Markup("–"), Markup("–")
    low, high = value - IN_95_PERCENT * error, value + IN_95_PERCENT * error
    if not name.startswith(SIGNED):
        low = max(low, 0.0)
    two_figures = f"{error:.2g}" if error < 99.5 else f"{float(f'{error:.2g}'):.0f}"
    interval = Markup("{} to {}").format(four_figures(low), four_figures(high))
    return Markup("{}").format(name), four_figures(value), Markup("{}").format(two_figures), interval


def _steady_chart(body: Hydraulic, model: Model, errors: Mapping[str, Any]) -> Chart:
    slowest, fastest = model.envelope.speed_m_s
    currents = quantities.curve_currents(body.valve.characteristic.at[0], body.valve.characteristic.at[-1])
    speeds = quantities.curve_speeds(slowest, fastest, CURVE_SPEEDS // 2)
    forces = quantities.steady_force_map(
        body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m, speeds, currents
    )
    curves = []
    for n, current in enumerate(currents):
        half = np.zeros(len(speeds))
        recorded = (slowest, fastest)
        if errors:
            half = IN_95_PERCENT * np.interp(speeds, errors["speed_m_s"], errors["steady_force_N"][n])
            recorded = tuple(errors["recorded_m_s"][n])
        curves.append(ChartCurve(minus(f"{current:.3g} A"), speeds, forces[n], half, recorded))
    return Chart("Steady force", "Speed [m/s], positive in compression", "Force [N]", tuple(curves), FORCE)


def _setting_chart(body: Hydraulic, errors: Mapping[str, Any]) -> Chart:
    at, values = map(np.array, (body.valve.characteristic.at, body.valve.characteristic.values))
    half = IN_95_PERCENT * np.array(errors.get("setting", np.zeros(len(at))))
    curve = ChartCurve("", at, values, half, (at[0], at[-1]))
    return Chart("Valve", "Current [A]", "Setting of the valve", (curve,), SETTING)


def _valve_chart(body: Hydraulic) -> Chart:
    """Return the curves of piston, base and external valve, up to the largest drop of the one that carries most."""
    speeds = np.array(body.piston.at)
    shown = max(max(map(abs, row)) for row in body.piston.rows + body.external.rows if max(map(abs, row)) < body.most_N)
    curves = []
    for edge in EDGES:
        flow = getattr(body, edge)
        ends = [(flow.rows[0], ", lowest current"), (flow.rows[-1], ", highest")]
        for row, what in ends if len(flow.rows) > 1 else [(flow.rows[0], "")]:
            drop = np.clip(row, -shown, shown)
            curves.append(ChartCurve(edge + what, speeds, drop, np.zeros(len(speeds)), (speeds[0], speeds[-1])))
    return Chart("Valves", "Flow [m/s]", "Pressure drop [N]", tuple(curves), VALVES)
