"""The report's section on the damper inside a model: its quantities with intervals, steady forces, and the valve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_identify.physical.models import Body
from ces_identify.physical.steady_curves import curve_currents, curve_speeds
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.structures.physical_quantities import ERRORS, read_quantities, steady_force_map
from ces_identify.typesetting import Chart, ChartCurve, ModelTable, TableColumn, four_figures, minus
from ces_observer.model import Model

IN_95_PERCENT = 1.96  # standard errors of a normal distribution
SIGNED = ("Lead", "Gas", "Stiffness of the gas")  # quantities that may be negative
ABOUT = (
    "Intervals hold for the noise of these recordings and the penalty, if the damper has this structure. A dash stands "
    "for a value at the end of its range, or for too few data."
)
NO_ERRORS = "This model was stored without standard errors."
FORCE = (
    "Steady force at mid-stroke, after a stroke at constant speed, with friction, without gas force and preload. "
    "Shaded: 95 % intervals. Dashed: speeds beyond those recorded about that current."
)
SETTING = (
    "Setting of the valve, from 0 at the lowest current recorded to 1 at the highest, in the middle of the magnetic "
    "loop. Shaded: 95 % interval."
)
CURVE_SPEEDS = 61


def physical_table(body: Body, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the damper's quantities with standard errors and intervals, and charts of its curves."""
    errors = model.provenance.get("selection", {}).get(ERRORS, {})
    values = read_quantities(body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m)
    rows = tuple(_row(name, value, errors.get("quantities", {}).get(name, 0.0)) for name, value in values.items())
    columns = (
        TableColumn(Markup("Quantity"), "", ""),
        *(TableColumn(Markup(head)) for head in ("Value", "Standard error", "95&#160;% interval")),
    )
    charts = (_steady_chart(body, model, errors), _setting_chart(body, errors))
    note = ABOUT if errors else NO_ERRORS
    return ModelTable("damper", "The damper", Markup(""), columns, rows, note, charts=charts)


def _row(name: str, value: float, error: float) -> tuple[Markup, ...]:
    if not isfinite(error) or error <= 0.0:
        return Markup("{}").format(name), four_figures(value), Markup("–"), Markup("–")
    low, high = value - IN_95_PERCENT * error, value + IN_95_PERCENT * error
    if not name.startswith(SIGNED):
        low = max(low, 0.0)
    interval = Markup("{} to {}").format(four_figures(low), four_figures(high))
    return Markup("{}").format(name), four_figures(value), _two_figures(error), interval


def _two_figures(error: float) -> Markup:
    return Markup("{}").format(f"{error:.2g}" if error < 99.5 else f"{float(f'{error:.2g}'):.0f}")


def _steady_chart(body: Body, model: Model, errors: Mapping[str, Any]) -> Chart:
    slowest, fastest = model.envelope.speed_m_s
    currents = curve_currents(body.valve.characteristic.at[0], body.valve.characteristic.at[-1])
    speeds = curve_speeds(slowest, fastest, CURVE_SPEEDS // 2)
    forces = steady_force_map(body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m, speeds, currents)
    curves = []
    for n, current in enumerate(currents):
        half = np.zeros(len(speeds))
        recorded = (slowest, fastest)
        if errors:
            half = IN_95_PERCENT * np.interp(speeds, errors["speed_m_s"], errors["steady_force_N"][n])
            recorded = tuple(errors["recorded_m_s"][n])
        curves.append(ChartCurve(minus(f"{current:.3g} A"), speeds, forces[n], half, recorded))
    return Chart("Steady force", "Speed [m/s], positive in compression", "Force [N]", tuple(curves), FORCE)


def _setting_chart(body: Body, errors: Mapping[str, Any]) -> Chart:
    at, values = map(np.array, (body.valve.characteristic.at, body.valve.characteristic.values))
    half = IN_95_PERCENT * np.array(errors.get("setting", np.zeros(len(at))))
    return Chart(
        "Valve", "Current [A]", "Setting of the valve", (ChartCurve("", at, values, half, (at[0], at[-1])),), SETTING
    )
