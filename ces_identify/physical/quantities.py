"""What an engineer knows a damper by, read off a model with physics inside, and how uncertain it is.

With A the Gauss-Newton matrix, P the weights of the pull towards usual values, H = A + P, and g_b the gradient of half
the squared error of block b, the mean squared error of the parameters is  H^-1 (c sum_b g_b g_b' + P P + g g') H^-1.
The first part is noise (sandwich estimate: White, Econometrica 50, 1982). Errors that are alike from tick to tick do
not count as independent, as the blocks are longer than their correlation. For n blocks and k parameters, c = n / (n -
k/2) lies in the middle between parameters that all blocks determine together and those that have blocks of their own.
The second part is the pull if true parameters lie a factor of e from usual ones: what the data leave open is then as
uncertain as that. The third is the way to the optimum that is left where the descent stopped, g being the gradient.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_data.arrays import F, I
from ces_identify.limits import ResultLimits
from ces_identify.physical.models import HydraulicModels, free_run
from ces_observer.structures.hydraulic import Hydraulic
from ces_observer.structures.structure import Range

BLOCK_S = 0.25
STEP = 1e-3  # of a parameter's standard error, to differentiate what follows from it


@dataclass(frozen=True)
class ParameterErrors:
    """Parameters `theta` (n,); their mean squared error is root root', `root` (n, m)."""

    theta: F
    root: F

    def of(self, values: Callable[[F], F]) -> F:
        """Return the standard errors of `values(theta)` (v,), linear in the errors of the parameters (delta method)."""
        at, sizes = values(self.theta), np.sqrt((self.root**2).sum(axis=1))
        spread = np.zeros((len(at), self.root.shape[1]))
        for n in np.flatnonzero(sizes > 0.0):
            moved = self.theta.copy()
            moved[n] += STEP * sizes[n]
            spread += np.outer((values(moved) - at) / (moved[n] - self.theta[n]), self.root[n])
        return np.asarray(np.sqrt((spread**2).sum(axis=1)))


def parameter_errors(models: HydraulicModels, theta: F, strength: float) -> ParameterErrors | None:
    """Return the errors of parameters fitted with a strength of the pull; None if there are too few blocks of data."""
    training, layout = models.training, models.layout
    weights = training.everything
    blocks = _number_blocks(training.segments, len(weights), round(BLOCK_S / models.scales.interval_s))
    _, matrix, gradients = models.sensitivities(theta, weights, blocks)
    pull = strength * layout.weight
    inverse = np.linalg.inv(matrix + np.diag(pull))
    used = gradients[(gradients != 0.0).any(axis=1)]
    determined = float(np.trace(inverse @ matrix))
    if len(used) < ResultLimits.MIN_BLOCKS * determined:
        return None
    slope = gradients.sum(axis=0) + pull * (theta - layout.centre)
    parts = [used.T * np.sqrt(len(used) / (len(used) - 0.5 * determined)), np.diag(pull), slope]
    return ParameterErrors(theta, inverse @ np.column_stack(parts))


def find_undetermined(models: HydraulicModels, theta: F, strength: float) -> list[str]:
    """Return a sentence on each quantity that the recordings say less of than the pull towards its usual value."""
    matrix = models.normal_equations(theta, models.training.everything).matrix
    determined = np.diag(matrix) >= strength * models.layout.weight
    values, owners = models.layout.values(theta), np.array(models.layout.owners)
    texts = []
    for name, (what, unit, factor, remedy) in ASKED.items():
        if not determined[owners == name].any():
            texts.append(f"{what} is not determined: {factor * values[name][0]:.3g} {unit} assumed; {remedy}")
    return texts


ASKED = {
    "rise_s": ("the valve's lag while the current rises", "ms", 1e3, "record steps of the current"),
    "fall_s": ("the valve's lag while the current falls", "ms", 1e3, "record steps of the current"),
    "mass_kg": ("the moving mass", "kg", 1.0, "record fast strokes at the softest current"),
}


def _number_blocks(segments: I, ticks: int, length: int) -> I:
    """Return the number of each tick's block; blocks do not cross segments."""
    numbers = np.zeros(ticks, np.int64)
    count = 0
    for start, stop in segments:
        numbers[start:stop] = count + np.arange(stop - start) // length
        count = int(numbers[stop - 1]) + 1 if stop > start else count
    return numbers


APPROACH_S = 0.3
MIN_TICKS = 10
SPEEDS = 10
CURRENTS = 4
SLOWEST = 0.01  # relative to the fastest speed
MIN_SPEED_M_S = 1e-3  # of a direction in which nothing was recorded
RECORDED = (0.5, 99.5)  # percentiles of the speeds at about a current


def curve_speeds(slowest: float, fastest: float, count: int = SPEEDS) -> F:
    """Return 2 `count` speeds [m/s] of a curve from `slowest` < 0 to `fastest` > 0, denser towards zero."""
    shares = np.linspace(np.sqrt(SLOWEST), 1.0, count) ** 2
    return np.concatenate([min(slowest, -MIN_SPEED_M_S) * shares[::-1], max(fastest, MIN_SPEED_M_S) * shares])


def curve_currents(low: float, high: float) -> F:
    """Return the currents [A] of the curves; only one if the current was constant."""
    return np.linspace(low, high, CURRENTS) if high > low else np.array([low])


def steady_force_map(body: Hydraulic, interval_s: float, position_m: Range, speeds: F, currents: F) -> F:
    """Return the steady forces (currents, speeds) [N] without gas force and preload.

    Each is read at mid-stroke on a triangular stroke: from mid-stroke to one end of what was recorded (for at most
    APPROACH_S) and back, at constant speed and current. What depends on the stroke alone is then that of mid-stroke.
    """
    middle, half = 0.5 * sum(position_m), 0.5 * (position_m[1] - position_m[0])
    seconds = np.minimum(half / np.abs(speeds), APPROACH_S)
    there = np.maximum(np.ceil(seconds / interval_s).astype(np.int64), MIN_TICKS)
    strokes = [v * np.append(-np.ones(n), np.ones(n)) for v, n in zip(speeds, there, strict=True)]
    ends = np.cumsum(np.tile(2 * there, len(currents)))
    speed = np.tile(np.concatenate(strokes), len(currents))
    position = np.tile(np.concatenate([middle + interval_s * np.cumsum(stroke) for stroke in strokes]), len(currents))
    current = np.repeat(currents, 2 * there.sum())
    segments = np.column_stack([ends - np.tile(2 * there, len(currents)), ends])
    force = free_run(body, interval_s, np.stack([position, speed, current]), segments)
    return np.reshape(force[ends - 1], (len(currents), len(speeds))) - body.side.gas(middle)


def recorded_speeds(speed: F, current: F, currents: F) -> list[list[float]]:
    """Return the range of the speeds (ticks,) [m/s] recorded nearest to each of the currents [A]."""
    nearest = np.abs(current[:, None] - currents).argmin(axis=1)
    about = [speed[nearest == n] for n in range(len(currents))]
    return [_short(np.percentile(of_current, RECORDED), 4) if len(of_current) else [0.0, 0.0] for of_current in about]


ERRORS = "standard_errors"  # key of `describe_errors` in a model's provenance, under `selection`


def read_quantities(body: Hydraulic, interval_s: float, position_m: Range) -> dict[str, float]:
    """Return the damper's quantities by their names, which hold the units; some depend on the range of positions."""
    path, side = body.valve, body.side
    low, high = position_m
    stroke, middle = high - low, 0.5 * (low + high)
    compression = body.compression_m_N * np.exp(body.compression_growth_1_m * middle)
    rebound = body.rebound_m_N * np.exp(body.rebound_growth_1_m * middle)
    return {
        "Stiffness of the compression chamber [kN/mm]": 1e-6 * (1.0 + body.area_ratio) ** 2 / float(compression),
        "Stiffness of the rebound chamber [kN/mm]": 1e-6 / float(rebound),
        "Stiffness of mounts and rod [kN/mm]": 1e-6 / body.mount_m_N if body.mount_m_N > 0.0 else np.inf,
        "Softer by air at the reservoir's pressure [times]": 1.0 + body.air,
        "Absolute pressure of the reservoir, on the annulus [N]": body.reservoir_N,
        "Rod area over annulus area": body.area_ratio,
        "Closing lag of the piston's valve [ms]": 1e3 * body.piston_s,
        "Closing lag of the base valve [ms]": 1e3 * body.base_s,
        "Closing lag of the external valve [ms]": 1e3 * body.external_s,
        "Friction of the seals [N]": sum(min(e.yield_N, e.stiffness_N_m * stroke) for e in side.friction),
        "Friction that the current adds [N]": sum(e.moved_N for e in side.friction),
        "Valve lag, rising current [ms]": 1e3 * path.rise_s,
        "Valve lag, falling current [ms]": 1e3 * path.fall_s,
        "Dead time of the valve [ms]": 1e3 * path.delay_ticks * interval_s,
        "Magnetic loop, half width [mA]": 1e3 * path.hysteresis_A,
        "Viscous friction [N s/m]": side.viscous_Ns_m,
        "Stiffness of the gas spring [N/mm]": 1e-3 * (side.gas(high) - side.gas(low)) / stroke,
        "Gas force and preload at mid-stroke [N]": side.gas(middle),
        "Moving mass [kg]": side.mass_kg,
        "Lead of the drive [ms]": 1e3 * side.lead_s,
    }


def describe_errors(models: HydraulicModels, theta: F, strength: float) -> Mapping[str, Any]:
    """Return standard errors of quantities, valve and steady forces for the provenance; empty for too few data."""
    errors = parameter_errors(models, theta, strength)
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
        "setting": _short(errors.of(lambda at: models.layout.values(at)["setting"])),
        "speed_m_s": _short(speeds, 4),
        "current_A": _short(currents, 4),
        "steady_force_N": [_short(row) for row in errors.of(forces).reshape(len(currents), len(speeds))],
        "recorded_m_s": recorded_speeds(data.inputs[1], data.inputs[2], currents),
    }


def _short(values: F, figures: int = 3) -> list[float]:
    return [float(f"{value:.{figures}g}") for value in values]
