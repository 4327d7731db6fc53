"""The tables of docs/speed.md: the error that an estimate of the speed leaves in the force of a damper.

    python bench/bench_speed.py delay      # the bank at stated delays, on the rig's four kinds of damper
    python bench/bench_speed.py peers      # beside other filters

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
EARLIER_ORDER, EARLIER_HZ = 3, 119.11  # its bandwidth, by its rule on noise and sweep
RATE_HZ = 1000.0  # of the positions
FLOOR = 0.5  # [%] of J, in quadrature: what no load cell resolves
Estimate = Callable[["Motion"], tuple[F, F]]  # -> times [s] and speeds [m/s]
Make = Callable[[float], Estimate]  # from a setting


@dataclass(frozen=True)
class Motion:
    """A stroke [m] and a current [A] of the hydraulic damper on the rig's grid, and the sensor of the position."""

    stroke_m: F
    current_A: F
    seed: int

    @cached_property
    def speed_m_s(self) -> F:
        return spline_speed(TIME_S, self.stroke_m)

    @cached_property
    def recording(self) -> Recording:
        sensor = replace(SENSORS.position, rate_Hz=RATE_HZ)
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


def load_packaged(names: Iterable[str]) -> list[Motion]:
    """Return the motions of packaged experiments."""
    return [motion_of(load_experiment(find_experiment(name))) for name in names]


def motion_of(experiment: Experiment) -> Motion:
    """Return the motion of an experiment."""
    seed = experiment.settings.seed
    stroke = experiment.stroke.samples(TIME_S, make_rng(seed, "stroke"))
    return Motion(stroke, experiment.current.samples(TIME_S, stroke, make_rng(seed, "current")), seed)


def bank(sampling: Sampling, motion: Motion) -> tuple[F, F]:
    """Return the speed as the package prepares it."""
    series = prepare(motion.recording, sampling)
    begin = select_samples(motion.recording, sampling).stamps_ns[0] - EPOCH_NS
    return series.time_s + 1e-9 * begin, series.speed


def peer(speeds: Filter, number: float, motion: Motion) -> tuple[F, F]:
    """Return the speed by a peer, at the true times of the samples."""
    x = motion.recording.channel("position").values
    return SENSORS.position.phase_s + np.arange(len(x)) / RATE_HZ, speeds(x, RATE_HZ, number)


def earlier(motion: Motion) -> tuple[F, F]:
    return peer(observer(EARLIER_ORDER), EARLIER_HZ, motion)


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


def delay_table() -> list[list[str]]:
    """Return the range of the dampers' mean J, and J over that of EARLIER, without and with the load cell's noise."""
    motions, noise = load_packaged((*JUDGED, "noise")), SENSORS.force.noise
    base, noisy = costs(motions, earlier), costs(motions, earlier, noise)
    sampling = choose_sampling([motion.recording for motion in load_packaged(TUNED)])
    rows = [["speed from", "J of the dampers %", "J over the first", f"with {noise:g} N of noise"]]
    banks = {ms: partial(bank, replace(sampling, delay_s=1e-3 * ms)) for ms in DELAYS_MS}
    estimates: dict[str, Estimate] = {f"bank, {ms} ms": estimate for ms, estimate in banks.items()}
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


TABLES = {"delay": delay_table, "peers": peers_table}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", choices=[[], *TABLES], metavar="TABLE", help="default: all")
    names = parser.parse_args().tables or list(TABLES)
    print("\n\n".join(markdown(TABLES[name]()) for name in names))


if __name__ == "__main__":
    main()
