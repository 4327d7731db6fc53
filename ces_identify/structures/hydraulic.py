"""Hydraulic networks at the desk: their fit, kind and what recordings leave open, what users choose, and the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import isfinite, nan
from typing import Any, NamedTuple

import numpy as np

from ces_data.arrays import F
from ces_identify.limits import EnvelopeLimits, HeldCurrentLimits
from ces_identify.numerics.search import Listener, clock_s
from ces_identify.physical import quantities
from ces_identify.physical.laws import STARTS
from ces_identify.physical.layout import read_scales
from ces_identify.physical.models import HydraulicModels
from ces_identify.physical.physical_search import SHORT_WORK, PhysicalFit, PhysicalSearch
from ces_identify.prepare.series import Series, SimulatedSeries
from ces_identify.structures.forgetting import measure_forgetting
from ces_identify.structures.kit import (
    AUTO,
    UNDETERMINED,
    Fitted,
    Fitter,
    IdentifyOptions,
    Size,
    StructureKit,
    check_whole,
    require_models,
)
from ces_identify.training import Training, build_training
from ces_observer.model import Model, Sampling
from ces_observer.options import Option
from ces_observer.structures.hydraulic import EDGES, Hydraulic
from ces_report.table import Section, text_table
from ces_report.typesetting import Chart, ChartCurve, format_number, format_within, minus

METHOD = "Levenberg-Marquardt on the free-run error, exact derivatives; kind, pull and bypass by the selection data"
CURVES = 5
SEARCH_SHARE, REFIT_SHARE = 0.85, 0.06  # of a time limit, for the search, and for each refit of the band
ERRORS_TIMES = 8.0  # that finding standard errors takes as long as finding what is undetermined (measured: 6 to 7)
BLOCK_S = 1.0


def _fitter(sizes: Mapping[str, Size]) -> Fitter:
    kinds = tuple(STARTS) if sizes[KIND.name] == AUTO else (str(sizes[KIND.name]),)
    return partial(_fit, kinds, int(sizes[CURVES_OPTION.name]))


def _fit(
    kinds: Sequence[str], rows: int, series: Sequence[Series], sampling: Sampling, how: IdentifyOptions, tell: Listener
) -> Fitted:
    """Return the best network of these kinds; raises CesError if there is none."""
    training = build_training(series, how.weight)
    scales = read_scales(training, sampling.rate_Hz, how.forget)
    held = is_held(training, sampling.rate_Hz)
    end_s = clock_s() + how.limits.time
    search = PhysicalSearch(how.limits.within(end_s, SEARCH_SHARE), tell)
    tell("fitting hydraulic networks")
    fits = search.run(training, scales, kinds, rows, held)
    require_models([fit.result for fit in fits], Hydraulic.option)
    tell("last fit of the hydraulic network")
    best = replace(fits[0], theta=search.refit(fits[0]))
    if not measure_forgetting(_build_model(best, sampling), series, how.forget).suffices:
        best = replace(best, models=replace(best.models, leaks=True))
        best = replace(best, theta=search.refit(best))
    began_s = clock_s()
    facts: dict[str, Any] = {
        "method": METHOD,
        "parameters": len(best.theta),
        "pull": best.strength,
        "kind": best.models.kind,
        "kind_reason": explain_kind(fits, sampling.rate_Hz),
        UNDETERMINED: quantities.find_undetermined(best.models, best.theta, best.strength),
    }
    if how.limits.work >= SHORT_WORK and clock_s() + ERRORS_TIMES * (clock_s() - began_s) < end_s:
        tell("finding standard errors of the hydraulic network")
        facts[quantities.ERRORS] = quantities.describe_errors(best.models, best.theta, best.strength)
    refit = partial(_refit, search, best, sampling)
    return Fitted(_build_model(best, sampling), [f.result for f in fits], facts, refit, leave_out_recordings=False)


def is_held(training: Training, rate_Hz: float) -> bool:
    """Return whether the current was held while the damper moved, as on a dyno: its path then shows nowhere."""
    current, length = training.inputs[2], max(1, round(HeldCurrentLimits.WINDOW_S * rate_Hz))
    spans = [
        float(np.ptp(current[at : at + length]))
        for start, stop in training.segments
        for at in range(start, max(start + 1, stop - length), length)
    ]
    steady = np.array(spans) <= HeldCurrentLimits.STEADY * max(float(np.ptp(current)), 1e-9)
    return bool(np.mean(steady) >= HeldCurrentLimits.SHARE)


def explain_kind(fits: Sequence[PhysicalFit], rate_Hz: float) -> str:
    """Return why this kind of damper: on how many blocks left out its first fit was lower than the next kind's."""
    first_fits: dict[str, PhysicalFit] = {}
    for fit in reversed(fits):  # a kind's first fit is its worst
        first_fits.setdefault(fit.models.kind, fit)
    chosen = fits[0].models.kind
    others = sorted((f for kind, f in first_fits.items() if kind != chosen), key=lambda fit: fit.cost)
    if not others:
        return f"{chosen}: as asked for"
    own, other = (_block_errors(fit, rate_Hz) for fit in (first_fits[chosen], others[0]))
    lower, count, name = int((own < other).sum()), len(own), others[0].models.kind
    if lower - 0.5 * count > np.sqrt(count):  # two standard errors of a coin
        return f"{chosen}: lower than {name} on {lower} of {count} blocks left out"
    return f"{chosen}: these recordings cannot tell it from {name} (lower on {lower} of {count} blocks left out)"


def _block_errors(fit: PhysicalFit, rate_Hz: float) -> F:
    training = fit.models.training
    squares = training.selection * (fit.models.force(fit.theta) - training.measured) ** 2
    blocks = np.arange(len(squares)) // max(1, round(BLOCK_S * rate_Hz))
    return np.asarray(np.bincount(blocks, squares)[np.bincount(blocks, training.selection) > 0.0])


def _refit(search: PhysicalSearch, best: PhysicalFit, sampling: Sampling, weights: F) -> Model:
    """Return the model after a few more steps on the ticks with a weight; each refit has a share of the time limit."""
    limits = replace(search.limits, time=REFIT_SHARE * search.limits.time)
    theta = PhysicalSearch(limits, lambda result: None).refit(best, weights)
    return _build_model(replace(best, theta=theta), sampling)


def _build_model(fit: PhysicalFit, sampling: Sampling) -> Model:
    """Return the model; its forces and pressures are held beyond those met."""
    models = fit.models.hold_pressures(fit.theta)
    training = models.training
    scored = training.everything > 0.0
    most = EnvelopeLimits.HELD_FORCE * float(np.abs(training.measured[scored]).max())
    model = Model(sampling, models.body(fit.theta), training.envelope, (-most, most))
    return replace(model, certificate=model.certify().to_mapping())


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


def physical_table(body: Hydraulic, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the damper's quantities with standard errors and intervals, and charts of its curves."""
    errors = model.provenance.get("selection", {}).get(quantities.ERRORS, {})
    rows = map(_row, list_quantities(body, model))
    table = text_table(("Quantity", "Value", "Standard error", "95\N{NO-BREAK SPACE}% interval"), rows)
    charts = (_steady_chart(body, model, errors), _setting_chart(body, errors), _valve_chart(body))
    return Section("damper", "The damper", table, ABOUT if errors else NO_ERRORS, charts=charts)


class FoundQuantity(NamedTuple):
    """A quantity of the damper in its `unit`, with its 95 % interval; NaN without a standard error."""

    quantity: str
    value: float
    unit: str
    standard_error: float
    low: float
    high: float


def list_quantities(body: Hydraulic, model: Model) -> list[FoundQuantity]:
    """Return the quantities of a network, with what its identification found of their errors."""
    values = quantities.read_quantities(body, 1.0 / model.sampling.rate_Hz, model.envelope.position_m)
    errors = model.provenance.get("selection", {}).get(quantities.ERRORS, {}).get("quantities", {})
    return [_as_quantity(name, value, errors.get(name, 0.0)) for name, value in values.items()]


def explain_missing_errors(model: Model) -> str:
    """Return why the quantities of a network have no intervals; '' if they have."""
    selection = model.provenance.get("selection", {})
    if selection.get(quantities.ERRORS):
        return ""
    few = quantities.ERRORS in selection
    why = (
        "the recordings were too short for them" if few else "the identification had no time for them: give more --time"
    )
    return f"no 95 % intervals of the quantities: {why}"


def _as_quantity(name: str, value: float, error: float) -> FoundQuantity:
    error = error if isfinite(error) and error > 0.0 else nan
    low, high = value - IN_95_PERCENT * error, value + IN_95_PERCENT * error
    what, _, unit = name.partition(" [")
    return FoundQuantity(what, value, unit.rstrip("]"), error, low if name.startswith(SIGNED) else max(low, 0.0), high)


def _row(of: FoundQuantity) -> tuple[str, ...]:
    name = f"{of.quantity} [{of.unit}]" if of.unit else of.quantity
    if not isfinite(of.standard_error):
        return name, format_number(of.value, 4), "–", "–"
    shown, ends = format_within(of.value, of.low, of.high)
    return name, shown, format_number(of.standard_error, 2), ends


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
    return Chart("Force of the valves", "Speed [m/s], positive in compression", "Force [N]", tuple(curves), FORCE)


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


KIND = Option("kind", AUTO, "kind of damper of a hydraulic network", choices=(AUTO, *STARTS))
CURVES_OPTION = Option(
    "curves", str(CURVES), "curves of the valve that the current moves, in a hydraulic network", form="2 to 8",
    check_text=check_whole(2, 8), metavar="N",
)  # fmt: skip
KIT: StructureKit[Hydraulic] = StructureKit(
    "hydraulic network: two chambers, a reservoir and their valves",
    Hydraulic,
    (KIND, CURVES_OPTION),
    _fitter,
    physical_table,
    models=HydraulicModels,
    auto_work=1.0,
)
