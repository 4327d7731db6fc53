"""Structures with physics inside at the desk: their fit, their kit, what their C has in common, and their report.

A model's curve becomes three tables of C: its nodes, its values and the slopes between them; physical.{c,h}.j2 and
physical_tick.c.j2 hold the C.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import chain
from math import isfinite
from typing import Any

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F
from ces_identify.physical import quantities
from ces_identify.physical.layout import read_scales
from ces_identify.physical.models import PhysicalModels, run_model
from ces_identify.physical.physical_search import PhysicalFit, PhysicalSearch
from ces_identify.polynomial.search_limits import Listener
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_identify.structures.kit import (
    ARGUMENTS,
    ConstantTable,
    CTick,
    Fitted,
    Fitter,
    IdentifyOptions,
    Size,
    StructureKit,
    find_slopes,
)
from ces_identify.trained.training import build_training
from ces_observer.errors import CesError
from ces_observer.model import Model, Sampling
from ces_observer.options import Option
from ces_observer.structures.curves import FlowMap
from ces_observer.structures.physical import PLAYS, PhysicalStructure, widen
from ces_report.typesetting import Chart, ChartCurve, ModelTable, TableColumn, four_figures, minus

Kind = type[PhysicalModels[Any]]

METHOD = "Levenberg-Marquardt on the free-run error, exact derivatives; penalty and size by the selection data"
AUTO = "auto"
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


def physical_kit(
    kind: Kind, about: str, body: type[Any], size: Option, counts: Sequence[int], c_tick: CTick[Any]
) -> StructureKit[Any]:
    """Return the kit of a structure; its fit tries the sizes `counts`, those after the first only if better."""

    def fitter(sizes: Mapping[str, Size]) -> Fitter:
        chosen = str(sizes[size.name])
        return _make_fitter(kind, body.option, counts if chosen == AUTO else (int(chosen),))

    table = partial(physical_table, kind)
    return StructureKit(about, body, (size,), fitter, partial(run_model, kind), table, c_tick, kind, quick=True)


def count_option(name: str, meaning: str, low: int, high: int) -> Option:
    """Return the option of a size that is a whole number or chosen by the fit."""

    def check(text: str) -> object:
        if text != AUTO and (not text.isdecimal() or not low <= int(text) <= high):
            raise ValueError(f"{text!r} is not {AUTO} or a whole number from {low} to {high}")
        return text

    return Option(name, AUTO, meaning, form=f"{AUTO} or {low} to {high}", check_text=check, metavar="N")


def _make_fitter(kind: Kind, option: str, counts: Sequence[int]) -> Fitter:
    """Return the fitter; with one start it is short: one size, one strength of the penalty, no standard errors."""

    def fit(series: Sequence[Series], sampling: Sampling, options: IdentifyOptions, listener: Listener) -> Fitted:
        training = build_training(series, options.weight)
        scales = read_scales(training, sampling.rate_Hz)
        smallest, *larger = [kind.sized(training, scales, count) for count in counts]
        search = PhysicalSearch(options.limits, listener)
        short = options.limits.starts == 1
        fits = search.run(smallest, larger, short)
        if not fits:
            raise CesError(f"no start of the {option} fit gave a finite cost; check signals and units")
        best = replace(fits[0], theta=search.refit(fits[0]))
        how: dict[str, Any] = {"method": METHOD, "parameters": len(best.theta), "penalty": best.penalty}
        if not short:
            how[quantities.ERRORS] = quantities.describe_errors(best.models, best.theta, best.penalty)
        results, refit = [one.result for one in fits], partial(_refit, search, best, sampling)
        return Fitted(_build_model(best, sampling), results, how, refit, leave_out_recordings=False)

    return fit


def _refit(search: PhysicalSearch, best: PhysicalFit, sampling: Sampling, weights: F) -> Model:
    """Return the model after a few more steps on the ticks with a weight; the time limit applies to each refit anew."""
    theta = PhysicalSearch(search.limits, lambda result: None).refit(best, weights)
    return _build_model(replace(best, theta=theta), sampling)


def _build_model(fit: PhysicalFit, sampling: Sampling) -> Model:
    """Return the model; its force envelope holds its proved bound, so that it never leaves it."""
    training = fit.models.training
    model = Model(sampling, fit.models.body(fit.theta), training.envelope, training.force_envelope)
    certificate: Any = model.certify()
    if not certificate.holds or not np.isfinite(certificate.force_bound_N):
        raise CesError("the force of the model could not be bounded; give other data")
    low, high = training.force_envelope
    bound = certificate.force_bound_N
    return replace(model, force_envelope_N=(min(low, -bound), max(high, bound)), certificate=certificate.to_mapping())


def physical_facts(body: PhysicalStructure, model: Model) -> dict[str, object]:
    """Return values for physical.{c,h}.j2; a structure overrides `springs` (at a start), `friction_factor` (C text)."""
    valve, side = body.valve, body.side
    interval = 1.0 / model.sampling.rate_Hz
    whole = int(valve.delay_ticks)
    inputs, wide = model.envelope.by_signal, widen(model.envelope.by_signal, body.reach)
    return {
        "inputs": [
            {"name": name, "argument": argument, "envelope": inputs[name], "reach": wide[name]}
            for name, argument in ARGUMENTS.items()
        ],
        "reach": body.reach,
        "springs": 0,
        "friction_factor": "",
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


def curve_tables(at_name: str, name: str, at: Sequence[float], values: Sequence[float]) -> list[ConstantTable]:
    """Return the tables of a curve: AT_NAME, NAME and NAME_SLOPES."""
    slopes = ConstantTable(f"{name}_SLOPES", find_slopes(at, values))
    return [ConstantTable(at_name, at), ConstantTable(name, values), slopes]


def map_tables(flow: FlowMap) -> list[ConstantTable]:
    """Return the tables of a valve's map: FLOWS, and by row FORCES and FORCES_SLOPES."""
    slopes = [find_slopes(flow.at, row) for row in flow.rows]
    return [
        ConstantTable("FLOWS", flow.at),
        ConstantTable("FORCES", list(chain(*flow.rows)), len(flow.at)),
        ConstantTable("FORCES_SLOPES", list(chain(*slopes)), len(flow.at) - 1),
    ]


def physical_table(
    kind: Kind, body: PhysicalStructure, model: Model, runs: Sequence[SimulatedSeries], role: str
) -> ModelTable:
    """Return the damper's quantities with standard errors and intervals, and charts of its curves."""
    errors = model.provenance.get("selection", {}).get(quantities.ERRORS, {})
    values = quantities.read_quantities(kind, body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m)
    rows = tuple(_row(name, value, errors.get("quantities", {}).get(name, 0.0)) for name, value in values.items())
    columns = (
        TableColumn(Markup("Quantity"), "", ""),
        *(TableColumn(Markup(head)) for head in ("Value", "Standard error", "95&#160;% interval")),
    )
    charts = (_steady_chart(kind, body, model, errors), _setting_chart(body, errors))
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


def _steady_chart(kind: Kind, body: PhysicalStructure, model: Model, errors: Mapping[str, Any]) -> Chart:
    slowest, fastest = model.envelope.speed_m_s
    currents = quantities.curve_currents(body.valve.characteristic.at[0], body.valve.characteristic.at[-1])
    speeds = quantities.curve_speeds(slowest, fastest, CURVE_SPEEDS // 2)
    forces = quantities.steady_force_map(
        kind, body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m, speeds, currents
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


def _setting_chart(body: PhysicalStructure, errors: Mapping[str, Any]) -> Chart:
    at, values = map(np.array, (body.valve.characteristic.at, body.valve.characteristic.values))
    half = IN_95_PERCENT * np.array(errors.get("setting", np.zeros(len(at))))
    curve = ChartCurve("", at, values, half, (at[0], at[-1]))
    return Chart("Valve", "Current [A]", "Setting of the valve", (curve,), SETTING)
