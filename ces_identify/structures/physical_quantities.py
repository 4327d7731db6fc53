"""What an engineer knows a damper by, read off a model with physics inside; names with units, and their errors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F
from ces_identify.physical.chambers_kernels import run_chambers
from ces_identify.physical.chambers_models import chamber_arrays
from ces_identify.physical.models import Body, Kernel, PhysicalModels
from ces_identify.physical.relaxation_kernels import run_relaxation
from ces_identify.physical.relaxation_models import relaxation_arrays
from ces_identify.physical.standard_errors import parameter_errors
from ces_identify.physical.steady_curves import curve_currents, curve_speeds, recorded_speeds, steady_forces
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.relaxation import Relaxation
from ces_observer.structures.structure import Range

ERRORS = "standard_errors"  # key of `describe_errors` in a model's provenance, under `selection`


def read_quantities(body: Body, interval_s: float, position_m: Range) -> dict[str, float]:
    """Return the damper's quantities by their names, which hold the units; some depend on the range of positions."""
    path, side = body.valve, body.side
    low, high = position_m
    stroke = high - low
    slow = body.springs[-1].stiffness_N_m if isinstance(body, Relaxation) else 0.0  # acts as a gas spring
    return {
        **(_read_relaxation(body) if isinstance(body, Relaxation) else _read_chambers(body, stroke)),
        "Valve lag, rising current [ms]": 1e3 * path.rise_s,
        "Valve lag, falling current [ms]": 1e3 * path.fall_s,
        "Dead time of the valve [ms]": 1e3 * path.delay_ticks * interval_s,
        "Magnetic loop, half width [mA]": 1e3 * path.hysteresis_A,
        "Viscous friction [N s/m]": side.viscous_Ns_m,
        "Stiffness of the gas spring [N/mm]": 1e-3 * ((side.gas(high) - side.gas(low)) / stroke + slow),
        "Gas force and preload at mid-stroke [N]": side.gas(0.5 * (low + high)),
        "Moving mass [kg]": side.mass_kg,
        "Lead of the drive [ms]": 1e3 * side.lead_s,
    }


def _read_relaxation(body: Relaxation) -> dict[str, float]:
    *springs, _ = body.springs
    return {
        "Stiffness of oil and mounts [N/mm]": 1e-3 / body.compliance_m_N,
        **{f"Yielding spring {n}, stiffness [N/mm]": 1e-3 * s.stiffness_N_m for n, s in enumerate(springs, 1)},
        **{f"Yielding spring {n}, largest force [N]": max(s.yield_N) for n, s in enumerate(springs, 1)},
    }


def _read_chambers(body: Chambers, stroke_m: float) -> dict[str, float]:
    ratio = 1.0 + body.area_ratio
    mount = {"Stiffness of mounts and rod [N/mm]": 1e-3 / body.mount_m_N} if body.mount_m_N > 0.0 else {}
    return {
        "Stiffness of the compression chamber [N/mm]": 1e-3 * ratio**2 / body.compression_m_N,
        "Stiffness of the rebound chamber [N/mm]": 1e-3 / body.rebound_m_N,
        **mount,
        "Rod area over annulus area": body.area_ratio,
        "Friction of the seals [N]": sum(min(e.yield_N, e.stiffness_N_m * stroke_m) for e in body.side.friction),
    }


def steady_force_map(body: Body, interval_s: float, position_m: Range, speeds: F, currents: F) -> F:
    """Return the steady forces (currents, speeds) [N] without gas force and preload."""
    kernel, arrays = _pick_kernel(body, interval_s)
    forces = steady_forces(kernel, arrays, position_m, speeds, currents)
    return forces - body.side.gas(0.5 * sum(position_m))


def _pick_kernel(body: Body, interval_s: float) -> tuple[Kernel, Any]:
    if isinstance(body, Relaxation):
        return run_relaxation, relaxation_arrays(body, interval_s)
    return run_chambers, chamber_arrays(body, interval_s)


def describe_errors(models: PhysicalModels, theta: F, penalty: float) -> Mapping[str, Any]:
    """Return the standard errors of quantities, valve characteristic and steady forces, for a model's provenance.

    Empty if the data are too few for them.
    """
    errors = parameter_errors(models, theta, penalty)
    if errors is None:
        return {}
    scales, data = models.scales, models.training
    envelope = data.envelope
    speeds = curve_speeds(*envelope.speed_m_s)
    currents = curve_currents(scales.currents_A[0], scales.currents_A[-1])
    stroke, interval = envelope.position_m, scales.interval_s
    names = list(read_quantities(models.body(theta), interval, stroke))

    def quantities(at: F) -> F:
        values = read_quantities(models.body(at), interval, stroke)
        return np.array([values[name] for name in names])

    def forces(at: F) -> F:
        return steady_force_map(models.body(at), interval, stroke, speeds, currents).ravel()

    return {
        "quantities": dict(zip(names, _short(errors.of(quantities)), strict=True)),
        "setting": _short(errors.of(lambda at: models.layout.part(models.layout.k(at), "setting"))),
        "speed_m_s": _short(speeds, 4),
        "current_A": _short(currents, 4),
        "steady_force_N": [_short(row) for row in errors.of(forces).reshape(len(currents), len(speeds))],
        "recorded_m_s": recorded_speeds(data.inputs[1], data.inputs[2], currents),
    }


def _short(values: F, figures: int = 3) -> list[float]:
    return [float(f"{value:.{figures}g}") for value in values]
