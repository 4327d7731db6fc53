"""The damper's equations once more, slowly and readably, for scipy's stiff solver: the kernel's twin."""

from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp

ATMOSPHERE = 101_325.0


class Twin:
    def __init__(self, damper):
        self.d = damper
        b = damper.body
        self.area_c, self.area_rod = np.pi * b.bore_m**2 / 4, np.pi * b.rod_m**2 / 4
        self.area_r = self.area_c - self.area_rod

    def relative_volume(self, p):
        """Aerated oil: volume over volume at atmospheric pressure."""
        oil, p = self.d.oil, max(p, 500.0)  # the solver may try less
        vapour = np.logaddexp(0.0, (oil.vapour_pressure_Pa - p) / 400.0)
        air = oil.air_fraction * (ATMOSPHERE / p) ** (1 / oil.air_exponent)
        return (1 - oil.air_fraction) * np.exp(-(p - ATMOSPHERE) / oil.bulk_modulus_Pa) + air + vapour

    def compliance(self, p):
        """-dV/dp/V, by a central difference."""
        p = max(p, 500.0)
        h = 1e-4 * p
        return -(self.relative_volume(p + h) - self.relative_volume(p - h)) / (2 * h) / self.relative_volume(p)

    def flow(self, area, drop):
        return area * np.sqrt(2 / self.d.oil.density_kg_m3) * drop / (drop**2 + 4e3**2) ** 0.25

    def check_rate(self, valve, drop, opening):
        target = smoothstep((drop - valve.cracking_Pa) / (valve.full_open_Pa - valve.cracking_Pa))
        return (target - opening) / (valve.opening_s if target > opening else valve.closing_s)

    def gas_volume(self, p):
        gas = self.d.reservoir
        return gas.gas_m3 * (gas.pressure_Pa / p) ** (1 / gas.exponent)

    def mount(self, x, v, stroke, speed):
        return self.d.mount.stiffness_N_m * (stroke - x) + self.d.mount.damping_Ns_m * (speed - v)

    def seal(self, v, bristle, p_r, thick):
        s = self.d.seal
        stribeck = s.coulomb_N + (s.static_N - s.coulomb_N) * np.exp(-((v / s.stribeck_m_s) ** 2))
        level = stribeck * (1 + s.pressure_1_Pa * (p_r - ATMOSPHERE))
        rate = v - s.bristle_N_m * abs(v) / level * bristle
        return s.bristle_N_m * bristle + s.bristle_Ns_m * rate + s.viscous_Ns_m * thick * v, rate

    def slope(self, t, y, stroke, speed, pilot):
        x, v, p_c, p_r, p_g, poppet, s_p, s_c, s_r, bristle, temperature = y
        d, piston, ces = self.d, self.d.piston, self.d.ces_valve
        thin = np.exp(d.oil.viscosity_fall_1_K * (temperature - 40))
        over = piston.blow_off_area_m2 * smoothstep((p_r - p_c - piston.blow_off_Pa) / piston.blow_off_band_Pa)
        to_rebound = (
            self.flow(piston.compression.area_m2 * s_p + piston.bleed_area_m2, p_c - p_r)
            + piston.leakage_m3_sPa * thin * (p_c - p_r)
            - self.flow(over, p_r - p_c)
        )
        fill_c = self.flow(d.top_checks.compression.area_m2 * s_c, p_g - p_c)
        fill_r = self.flow(d.top_checks.rebound.area_m2 * s_r, p_g - p_r)
        out = self.flow(ces.pilot_area_m2 + ces.area_m2 * poppet, p_r - p_g)
        friction, bristle_rate = self.seal(v, bristle, p_r, 1 / thin)
        pull = self.mount(x, v, stroke(t), speed(t))
        pressure = p_c * self.area_c - p_r * self.area_r - ATMOSPHERE * self.area_rod
        volume_c = self.area_c * (d.body.half_stroke_m - x) + d.body.compression_dead_m3
        volume_r = self.area_r * (d.body.half_stroke_m + x) + d.body.rebound_dead_m3
        gas = self.gas_volume(p_g)
        oil = d.reservoir.gas_m3 + d.reservoir.oil_m3 - gas
        heat = to_rebound * (p_c - p_r) + out * (p_r - p_g) + fill_c * (p_g - p_c) + fill_r * (p_g - p_r) + friction * v
        w = self.relative_volume
        return [
            v,
            (pull - pressure - friction) / d.body.moving_mass_kg,
            (self.area_c * v + w(p_c) * (fill_c - to_rebound)) / (volume_c * self.compliance(p_c)),
            (-self.area_r * v + w(p_r) * (to_rebound + fill_r - out)) / (volume_r * self.compliance(p_r)),
            w(p_g) * (out - fill_c - fill_r) / (oil * self.compliance(p_g) + gas / (d.reservoir.exponent * p_g)),
            (smoothstep((p_r - p_g - pilot(t)) / ces.band_Pa) - poppet) / ces.poppet_s,
            self.check_rate(piston.compression, p_c - p_r, s_p),
            self.check_rate(d.top_checks.compression, p_g - p_c, s_c),
            self.check_rate(d.top_checks.rebound, p_g - p_r, s_r),
            bristle_rate,
            (heat - d.heat.loss_W_K * (temperature - d.heat.ambient_degC)) / d.heat.capacity_J_K,
        ]

    def pilot_pressure(self, time, current):
        """The current path by small explicit steps: coil lag, play operators, magnet, asymmetric pilot lag."""
        ces = self.d.ces_valve
        halves = ces.hysteresis_A * np.array([0.25, 0.75, 1.25, 1.75])
        coil, plays = current[0], np.full(4, current[0])
        pilot = [self.cracking(current[0])]
        for before, now in pairwise(current):
            dt = time[1] - time[0]
            coil += dt * ((before + now) / 2 - coil) / ces.solenoid_s
            plays = np.clip(plays, coil - halves, coil + halves)
            target = self.cracking(plays.mean())
            lag = ces.pilot_rise_s if target > pilot[-1] else ces.pilot_fall_s
            pilot.append(pilot[-1] + dt * (target - pilot[-1]) / lag)
        return np.array(pilot)

    def cracking(self, current):
        ces = self.d.ces_valve
        w, low, high = ces.saturation_A, ces.current_low_A, ces.current_high_A

        def in_range(at):
            acting = low + w * (np.logaddexp(0, (at - low) / w) - np.logaddexp(0, (at - high) / w))
            share = (acting**2 - low**2) / (high**2 - low**2)
            return ces.cracking_low_Pa + (ces.cracking_high_Pa - ces.cracking_low_Pa) * share

        end = np.clip(current, low, high)
        slope = (in_range(end + 1e-6) - in_range(end - 1e-6)) / 2e-6
        return max(in_range(end) + slope * (np.clip(current, ces.allowed_low_A, ces.allowed_high_A) - end), 0.0)

    def force(self, start, times, stroke, speed, pilot):
        """Force [N] at `times` from the eleven unknowns `start`; `stroke`, `speed`, `pilot` are functions of time."""
        found = solve_ivp(
            self.slope, (times[0], times[-1]), start, method="Radau", t_eval=times, args=(stroke, speed, pilot),
            rtol=1e-6, max_step=1e-3, atol=[1e-9, 1e-6, 10, 10, 10, 1e-6, 1e-6, 1e-6, 1e-6, 1e-9, 1e-4],
        )  # fmt: skip
        assert found.success, found.message
        return np.array([self.mount(y[0], y[1], stroke(t), speed(t)) for t, y in zip(found.t, found.y.T, strict=True)])


def smoothstep(u):
    u = min(max(u, 0.0), 1.0)
    return u * u * (3 - 2 * u)
