"""The equations of the lumped dampers once more, slowly and readably, by tiny explicit steps: the kernels' twins."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from ces_rig.dampers.lookup.kernel import LEVELS, SPEEDS
from ces_rig.dampers.stepper import spline_speed

STEP = 1e-5


def driven(stroke, current, interval):
    """Yield stroke [m], speed [m/s] and current [A] at every tiny step, and True where a sample ends."""
    time = np.arange(len(stroke)) * interval
    fine = np.arange(1, round(time[-1] / STEP) + 1) * STEP
    spline = CubicHermiteSpline(time, stroke, spline_speed(time, stroke))
    each = round(interval / STEP)
    for n, values in enumerate(zip(spline(fine), spline(fine, 1), np.interp(fine, time, current), strict=True), 1):
        yield *values, n % each == 0


def lag(target, value, seconds):
    return value + STEP / seconds * (target - value) if seconds > 0 else target


def bouc_wen(d, stroke, current, interval):
    """Force [N] at the samples after the first, by Spencer's equations; no play, no hysteresis of the current."""
    zero = d.rod_m2 * (d.gas_Pa - 101_325)
    x, v, e, z, bristle, warm = stroke[0] - zero / d.mount_N_m, 0.0, 0.0, 0.0, 0.0, 0.0
    y = x
    coil = field = current[0]
    forces = []
    for s, ds, i, sample in driven(stroke, current, interval):
        coil = lag(i, coil, d.coil_s)
        field = lag(coil, field, d.field_s)
        yielding = d.yield_N + d.yield_N_A * d.saturation_A * np.tanh(field / d.saturation_A)
        yielding *= np.exp(-d.fade_yield_1_K * warm)
        c0 = (d.viscous_Ns_m + d.viscous_Ns_mA * field) * np.exp(-d.fade_viscous_1_K * warm)
        fluid = d.fluid_N_m * (e if e > 0 else d.fluid_rebound * e)
        flow = (fluid - yielding * z - d.inner_N_m * (x - e - y)) / c0  # d(x_in - y)/dt
        gamma, beta = d.unloading, 1 - d.unloading
        dz = (
            flow - gamma * abs(flow) * z * abs(z) ** (d.sharpness - 1) - beta * flow * abs(z) ** d.sharpness
        ) / d.yield_m
        level = d.seal_N * (1 + (d.seal_static - 1) * np.exp(-((v / d.stribeck_m_s) ** 2)))
        dbristle = v - d.bristle_N_m * abs(v) / level * bristle
        seal = d.bristle_N_m * bristle + d.bristle_Ns_m * dbristle
        gas = d.rod_m2 * (d.gas_Pa * (d.gas_m3 / (d.gas_m3 - d.rod_m2 * x)) ** d.gas_exponent - 101_325)
        into = max(abs(x) - d.stop_clearance_m, 0.0)
        stop = np.sign(x) * d.stop_N_m * into * (1 + d.stop_progression_1_m * into)
        mount = d.mount_N_m * (s - x) + d.mount_Ns_m * (ds - v)
        through = flow + fluid / d.series_Ns_m
        past = d.bypass_m_Ns * fluid + np.sign(fluid) * max(abs(fluid) - d.relief_N, 0.0) / d.relief_Ns_m
        v += STEP * (mount - fluid - seal - gas - stop) / d.mass_kg
        x += STEP * v
        e += STEP * (v - through - past)
        y += STEP * fluid / d.series_Ns_m
        z += STEP * dz
        bristle += STEP * dbristle
        warm += (
            STEP * (fluid * (through + past) + abs(d.bristle_N_m * bristle * v) - d.heat_loss_W_K * warm) / d.heat_J_K
        )
        if sample:
            forces.append(mount - zero)
    return np.array(forces)


def lookup(d, stroke, current, interval):
    """Force [N] at the samples after the first; no play, no groove, no foam."""
    zero = d.rod_m2 * (d.gas_Pa - 101_325)
    x, v, e, seal, warm = stroke[0] - zero / d.mount_N_m, 0.0, 0.0, 0.0, 0.0
    coil = held = acting = current[0]
    rows = np.array(d.table).reshape(LEVELS, -1)
    speeds = d.speed_m_s * np.array(SPEEDS)
    forces = []
    for s, ds, i, sample in driven(stroke, current, interval):
        coil = lag(i, coil, d.coil_s)
        held = np.clip(held, coil - d.loop_A, coil + d.loop_A)
        acting = lag(held, acting, d.rise_s if held > acting else d.fall_s)
        at = np.clip(d.authority * (acting - d.low_A) / (d.high_A - d.low_A), 0, 1) * (LEVELS - 1)
        row = np.array([np.interp(at, range(LEVELS), column) for column in rows.T])
        row *= np.where(speeds > 0, d.compression, d.rebound) * np.exp(-d.fade_1_K * warm)
        roots = np.roots([1 / d.oil_N_m, 80 / d.oil_N_m + d.air_m - abs(e), -80 * abs(e)])  # e = f / k + a f / (f + 80)
        oil = np.sign(e) * max(roots.real)
        oil = min(oil, d.void_N) + 1e-4 * max(oil - d.void_N, 0.0)
        passed = np.interp(oil, row, speeds) + d.bypass_m_Ns * oil
        passed += np.sign(oil) * max(abs(oil) - d.relief_N, 0.0) / d.relief_Ns_m
        level = d.seal_N * (1 + d.seal_rise * np.exp(-abs(v) / d.seal_m_s))
        gas = d.rod_m2 * (d.gas_Pa * (d.gas_m3 / (d.gas_m3 - d.rod_m2 * x)) ** d.gas_exponent - 101_325)
        into = max(abs(x) - d.stop_clearance_m, 0.0)
        stop = np.sign(x) * d.stop_N_m * into * (1 + d.stop_progression_1_m * into)
        mount = d.mount_N_m * (s - x) + d.mount_Ns_m * (ds - v)
        warm += STEP * (abs(oil * passed) + abs(level * v) - d.heat_loss_W_K * warm) / d.heat_J_K
        e += STEP * (v - passed)
        v += STEP * (mount - oil - gas - stop - level * seal / d.seal_m) / d.mass_kg
        x += STEP * v
        seal = np.clip(seal + STEP * v, -d.seal_m, d.seal_m)
        if sample:
            forces.append(mount - zero)
    return np.array(forces)
