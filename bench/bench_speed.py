"""The tables of docs/speed.md: the error that an estimate of the speed leaves in the force of a damper.

    python bench/bench_speed.py delay      # the bank at stated delays, on the rig's four kinds of damper
    python bench/bench_speed.py peers      # beside other filters
    python bench/bench_speed.py elsewhere  # with strokes, noise and rates that nothing was tuned to

The damper's own equations run with the estimated speed; J compares their force with that of the true speed. The bank
has only its rule, on the noise and sweep recordings and their jittered stamps. Each peer has the setting of the least
J there, knowing the truth, and exact times. EARLIER is the filter of version 0.1.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import blas_one_thread  # noqa: F401 - before NumPy
import numpy as np
from markdown import markdown
from scipy.signal import butter, sosfilt
from speed_peers import PEERS, F, Filter, grid, observer

from ces_data.recording import Recording
from ces_data.waveforms.strokes import Sine, Sweep, road_stroke
from ces_identify.prepare.cost import cost
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import prepare, select_samples
from ces_observer.model import Sampling
from ces_rig.dampers.stepper import HYDRAULIC, KINDS, simulate, spline_speed
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import Experiment, find_experiment, load_experiment, make_rng
from ces_rig.sensors import EPOCH_NS, GRID_S, Sensors

TUNED, JUDGED = ("noise", "sweep"), ("sine_4hz", "sine_12hz", "road")
TIME_S = np.arange(0.0, 14.0, GRID_S)
SETTLED = (TIME_S > 1.0) & (TIME_S < 13.95)  # the last speeds are not known after a delay
SENSORS = Sensors()
DELAYS_MS = (0, 1, 3, 5)
EARLIER = "Kalman, white jerk (0.1)"
FLOOR = 0.5  # [%] of J, in quadrature: what no load cell resolves
OTHER_SINES = {"sine 1 Hz": (0.02, 1.0), "sine 7 Hz": (0.01, 7.0), "sine 20 Hz": (0.003, 20.0)}  # [m, Hz]
Estimate = Callable[["Motion"], tuple[F, F]]  # -> times [s] and speeds [m/s]
Make = Callable[[float], Estimate]  # from a setting


@dataclass(frozen=True)
class Conditions:
    """Rate [Hz] of the positions, their noise and resolution over the rig's; order and bandwidth [Hz] of EARLIER."""

    rate_Hz: float = 1000.0
    noise: float = 1.0
    earlier: tuple[int, float] = (3, 119.11)  # by its rule on noise and sweep


USUAL = Conditions()
OTHER_CONDITIONS = {
    "noise x 0.3": Conditions(noise=0.3, earlier=(3, 150.0)),
    "noise x 3": Conditions(noise=3.0, earlier=(3, 89.28)),
    "200 Hz": Conditions(200.0, earlier=(2, 66.67)),
    "5 kHz": Conditions(5000.0, earlier=(3, 149.3)),
}


@dataclass(frozen=True)
class Motion:
    """A stroke [m] and a current [A] of the hydraulic damper on the rig's grid, and the sensor of the position."""

    stroke_m: F
    current_A: F
    conditions: Conditions
    seed: int

    @cached_property
    def speed_m_s(self) -> F:
        return spline_speed(TIME_S, self.stroke_m)

    @cached_property
    def recording(self) -> Recording:
        own, made = SENSORS.position, self.conditions
        sensor = replace(own, noise=made.noise * own.noise, quantum=made.noise * own.quantum, rate_Hz=made.rate_Hz)
        rng = make_rng(self.seed, "position")
        position = sensor.measure("position", "m", TIME_S, self.stroke_m, EPOCH_NS, rng)
        return Recording("motion", {"position": position}, {"current": 0.0})

    def force(self, kind: str, error_m_s: F | float = 0.0, drift_m: F | float = 0.0) -> F:
        """Return the force [N] of a kind of damper, its current in the same place of its own range."""
        design = KINDS[kind].design
        current = np.interp(self.current_A, KINDS[HYDRAULIC].design.current_A, design.current_A)
        run = simulate(design, GRID_S, self.stroke_m + drift_m, current, self.speed_m_s + error_m_s)
        return run.tared_N[SETTLED]

    @cached_property
    def forces(self) -> Mapping[str, F]:
        return {kind: self.force(kind) for kind in KINDS}


def load_packaged(names: Iterable[str], conditions: Conditions = USUAL) -> list[Motion]:
    """Return the motions of packaged experiments."""
    return [motion_of(load_experiment(find_experiment(name)), conditions) for name in names]


def motion_of(experiment: Experiment, conditions: Conditions = USUAL, stroke_m: F | None = None) -> Motion:
    """Return the motion of an experiment, or of another stroke with its current."""
    seed = experiment.settings.seed
    stroke = experiment.stroke.samples(TIME_S, make_rng(seed, "stroke")) if stroke_m is None else stroke_m
    return Motion(stroke, experiment.current.samples(TIME_S, stroke, make_rng(seed, "current")), conditions, seed)


def other_motions() -> dict[str, list[Motion]]:
    """Return motions unlike those that anything was tuned on."""
    rng, corners = make_rng(1, "stroke"), (0.1, 0.11, 0.13, 0.14, 0.35, 0.36, 0.38, 0.39)
    jumps = np.cumsum(np.interp(TIME_S % 0.5, corners, (0, 1, 1, 0, 0, -1, -1, 0))) * 0.5 * GRID_S
    strokes = {name: Sine(*numbers).samples(TIME_S, rng) for name, numbers in OTHER_SINES.items()}
    strokes |= {
        "sweep to 30 Hz": Sweep(to_Hz=30.0).samples(TIME_S, rng),
        "road, class E": 2.0 * road_stroke("D", 5.0, TIME_S, rng),  # twice the heights of class D
        "trapezoid": jumps - jumps.mean(),  # 15 mm in 40 ms
    }
    road = load_experiment(find_experiment("road"))
    return {name: [motion_of(road, stroke_m=stroke)] for name, stroke in strokes.items()}


def bank(sampling: Sampling, motion: Motion) -> tuple[F, F]:
    """Return the speed as the package prepares it."""
    series = prepare(motion.recording, sampling)
    begin = select_samples(motion.recording, sampling).stamps_ns[0] - EPOCH_NS
    return series.time_s + 1e-9 * begin, series.speed


def peer(speeds: Filter, number: float, motion: Motion) -> tuple[F, F]:
    """Return the speed by a peer, at the true times of the samples."""
    x, rate = motion.recording.channel("position").values, motion.conditions.rate_Hz
    return SENSORS.position.phase_s + np.arange(len(x)) / rate, speeds(x, rate, number)


def earlier(motion: Motion) -> tuple[F, F]:
    return peer(observer(motion.conditions.earlier[0]), motion.conditions.earlier[1], motion)


def costs(motions: Iterable[Motion], estimate: Estimate, noise_N: float = 0.0) -> F:
    """Return J [%] (motions, kinds) at the estimated speed, against a force with the load cell's noise.

    The error of the speed is integrated to a stroke, less what lies below 0.5 Hz, which would be a drift.
    """
    rows = []
    for motion in motions:
        error = np.interp(TIME_S, *estimate(motion)) - motion.speed_m_s
        error[TIME_S < 0.3] = 0.0
        drift = sosfilt(butter(1, 0.5, "high", fs=1.0 / GRID_S, output="sos"), np.cumsum(error) * GRID_S)
        noise = noise_N * make_rng(motion.seed, "force").standard_normal(SETTLED.sum())
        rows.append([cost(motion.forces[kind] + noise, motion.force(kind, error, drift)) for kind in KINDS])
    return np.array(rows)


def ratios(found: F, base: F, floor: float = FLOOR) -> str:
    """Return median and largest J over another, both with a floor."""
    shares = np.hypot(found, floor) / np.hypot(base, floor)
    return f"{np.median(shares):.2f}/{shares.max():.2f}"


def banks(conditions: Conditions) -> dict[int, Estimate]:
    """Return the bank by its rule with each delay [ms] that is whole ticks."""
    sampling = choose_sampling([motion.recording for motion in load_packaged(TUNED, conditions)])
    delays = [ms for ms in DELAYS_MS if (1e-3 * ms * sampling.rate_Hz).is_integer()]
    return {ms: partial(bank, replace(sampling, delay_s=1e-3 * ms)) for ms in delays}


def delay_table() -> list[list[str]]:
    """Return the range of the dampers' mean J, and J over that of EARLIER, without and with the load cell's noise."""
    motions, noise = load_packaged((*JUDGED, "noise")), SENSORS.force.noise
    base, noisy = costs(motions, earlier), costs(motions, earlier, noise)
    rows = [["speed from", "J of the dampers %", "J over the first", f"with {noise:g} N of noise"]]
    estimates = {f"bank, {ms} ms": estimate for ms, estimate in banks(USUAL).items()}
    for name, estimate in ({EARLIER: earlier} | estimates | {"true speed": lambda m: (TIME_S, m.speed_m_s)}).items():
        clean = costs(motions, estimate)
        means, over = clean.mean(axis=0), ratios(costs(motions, estimate, noise), noisy, 0.0)
        rows.append([name, f"{means.min():.2f}–{means.max():.2f}", ratios(clean, base), over])
    return rows


def peers_table() -> list[list[str]]:
    """Return J of each filter on strokes that its setting was not found on: means of the dampers."""
    tuning, motions = load_packaged(TUNED), load_packaged(JUDGED)
    base = costs(motions, earlier)
    sampling = choose_sampling([motion.recording for motion in tuning])
    found: dict[str, tuple[str, Estimate]] = {EARLIER: ("by its rule", earlier)}
    for one in PEERS:
        found[one.name] = tune(one.grid, one.unit, partial(partial, peer, one.speeds), tuning)
    for ms in (0, 3):
        late = replace(sampling, delay_s=1e-3 * ms)
        make = lambda f, late=late: partial(bank, replace(late, frequencies_Hz=(f,), outlier_m=1.0))  # noqa: E731
        found[f"one mode of the bank, {ms} ms"] = tune(grid(3, 100), "Hz", make, tuning)
        found[f"**the bank, {ms} ms**"] = "by its rule", partial(bank, late)
    rows = [["filter", "setting", *JUDGED, "J over the first"]]
    for name, (setting, estimate) in found.items():
        clean = costs(motions, estimate)
        rows.append([name, setting, *(f"{j:.2f}" for j in clean.mean(axis=1)), ratios(clean, base)])
    return rows


def tune(numbers: Sequence[float], unit: str, make: Make, tuning: Sequence[Motion]) -> tuple[str, Estimate]:
    """Return the setting, as text, and the estimate with the least geometric mean of J."""

    def error(number: float) -> float:
        try:
            return float(np.log(costs(tuning, make(number))).mean())
        except RigError:  # a speed that leads out of the damper
            return np.inf

    best = min(numbers, key=error)
    return f"{best:.3g} {unit}", make(best)


def elsewhere_table() -> list[list[str]]:
    """Return J over that of EARLIER where nothing was tuned: median and worst of the dampers."""
    usual = banks(USUAL)
    cases = {name: (motions, usual) for name, motions in other_motions().items()}
    cases |= {name: (load_packaged((*JUDGED, "noise"), how), banks(how)) for name, how in OTHER_CONDITIONS.items()}
    rows = [["stroke or sensor", "0 ms", "3 ms"]]
    for name, (motions, estimates) in cases.items():
        base = costs(motions, earlier)
        found = {ms: ratios(costs(motions, one), base) for ms, one in estimates.items()}
        rows.append([name, found[0], found.get(3, "-")])
    return rows


TABLES = {"delay": delay_table, "peers": peers_table, "elsewhere": elsewhere_table}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], *TABLES], metavar="TABLE", help="default: all")
    names = parser.parse_args().tables or list(TABLES)
    print("\n\n".join(markdown(TABLES[name]()) for name in names))


if __name__ == "__main__":
    main()
