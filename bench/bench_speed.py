"""The tables of docs/speed.md: the error that an estimate of the speed leaves in the force of a damper.

    python bench/bench_speed.py delay      # the bank at stated delays, on the rig's four kinds of damper
    python bench/bench_speed.py peers      # beside other filters
    python bench/bench_speed.py elsewhere  # with strokes, noise and rates that nothing was tuned to
    python bench/bench_speed.py measured   # models of measured dampers (CES_DATA=FOLDER), by delay

The damper's own equations run with the estimated speed; J compares their force with that of the true speed. The bank
has only its rule, on the noise and sweep recordings and their jittered stamps. Each peer has the setting with the least
error of the force there, knowing the truth, and exact times. EARLIER is the filter of version 0.1.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import blas_one_thread  # noqa: F401 - before NumPy
import numpy as np
from markdown import markdown
from recorded_cases import MEASURED_CASES, is_present, mean_cost
from recorded_peers import fit_ours
from scipy.signal import butter, sosfilt
from speed_peers import PEERS, F, Filter, grid, observer

from ces_data.recording import Recording
from ces_identify.prepare.cost import cost
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import prepare, select_samples
from ces_observer.model import Sampling
from ces_rig.dampers.kinds import HYDRAULIC, KINDS
from ces_rig.dampers.stepper import simulate, spline_speed
from ces_rig.drive.strokes import road_stroke
from ces_rig.errors import RigError
from ces_rig.experiment import Experiment, find_experiment, load_experiment, make_rng, parse_experiment
from ces_rig.sensors import EPOCH_NS, GRID_S, Sensors

TUNED, JUDGED = ("noise", "sweep"), ("sine_4hz", "sine_12hz", "road")
TIME_S = np.arange(0.0, 14.0, GRID_S)
SETTLED = (TIME_S > 1.0) & (TIME_S < 13.95)  # the last speeds are not known after a delay
SENSORS = Sensors()
DELAYS_MS = (0, 1, 3, 5)
EARLIER = "Kalman, white jerk (0.1)"
FLOOR = 0.5  # [%] of J, in quadrature: what no load cell resolves
SEARCH_S = 40.0
OTHER_STROKES: Mapping[str, Mapping[str, object]] = {
    "sine 1 Hz": {"kind": "sine", "amplitude_m": 0.02, "frequency_Hz": 1.0},
    "sine 7 Hz": {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 7.0},
    "sine 20 Hz": {"kind": "sine", "amplitude_m": 0.003, "frequency_Hz": 20.0},
    "sweep to 30 Hz": {"kind": "sweep", "to_Hz": 30.0},
}
Estimate = Callable[["Motion"], tuple[F, F]]  # -> times [s] and speeds [m/s]


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
        """The positions as logged."""
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
        """The force of each kind at the true speed."""
        return {kind: self.force(kind) for kind in KINDS}


def packaged(names: Iterable[str], conditions: Conditions = USUAL) -> list[Motion]:
    """Return the motions of packaged experiments."""
    return [motion_of(load_experiment(find_experiment(name)), conditions) for name in names]


def motion_of(experiment: Experiment, conditions: Conditions = USUAL, stroke_m: F | None = None) -> Motion:
    """Return the motion of an experiment, or of another stroke with its current."""
    seed = experiment.settings.seed
    stroke = experiment.stroke.samples(TIME_S, make_rng(seed, "stroke")) if stroke_m is None else stroke_m
    return Motion(stroke, experiment.current.samples(TIME_S, stroke, make_rng(seed, "current")), conditions, seed)


def other_motions() -> dict[str, list[Motion]]:
    """Return motions unlike those that anything was tuned on."""
    current = {"kind": "filtered_noise"}
    described = {name: {"stroke": stroke, "current": current} for name, stroke in OTHER_STROKES.items()}
    motions = {name: motion_of(parse_experiment(words, name)) for name, words in described.items()}
    road, corners = load_experiment(find_experiment("road")), (0.1, 0.11, 0.13, 0.14, 0.35, 0.36, 0.38, 0.39)
    rough = 2.0 * road_stroke("D", 5.0, TIME_S, make_rng(1, "stroke"))  # class E has twice the heights of class D
    jumps = np.cumsum(np.interp(TIME_S % 0.5, corners, (0, 1, 1, 0, 0, -1, -1, 0))) * 0.5 * GRID_S
    motions |= {"road, class E": motion_of(road, stroke_m=rough)}
    motions |= {"trapezoid, 15 mm in 40 ms": motion_of(road, stroke_m=jumps - jumps.mean())}
    return {name: [motion] for name, motion in motions.items()}


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
    """Return the speed by the filter of version 0.1."""
    return peer(observer(motion.conditions.earlier[0]), motion.conditions.earlier[1], motion)


def true_speed(motion: Motion) -> tuple[F, F]:
    """Return the true speed."""
    return TIME_S, motion.speed_m_s


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


def ratios(found: F, base: F) -> tuple[float, float]:
    """Return median and largest J over another, both with FLOOR."""
    all_ratios = np.hypot(found, FLOOR) / np.hypot(base, FLOOR)
    return float(np.median(all_ratios)), float(all_ratios.max())


def banks(conditions: Conditions) -> dict[int, Estimate]:
    """Return the bank by its rule with each delay [ms] that is whole ticks."""
    sampling = choose_sampling([motion.recording for motion in packaged(TUNED, conditions)])
    delays = [ms for ms in DELAYS_MS if (1e-3 * ms * sampling.rate_Hz).is_integer()]
    return {ms: partial(bank, replace(sampling, delay_s=1e-3 * ms)) for ms in delays}


def delay_table() -> list[list[str]]:
    """Return the mean J of each damper, and J over that of EARLIER, without and with the load cell's noise."""
    motions, noise = packaged((*JUDGED, "noise")), SENSORS.force.noise
    base, noisy = costs(motions, earlier), costs(motions, earlier, noise)
    rows = [["speed from", *KINDS, "ratio: median", "worst", f"with {noise:g} N of noise: median", "worst"]]
    estimates = {f"bank, {ms} ms": estimate for ms, estimate in banks(USUAL).items()}
    for name, estimate in {EARLIER: earlier, **estimates, "the true speed": true_speed}.items():
        clean, over = costs(motions, estimate), costs(motions, estimate, noise) / noisy
        shown = (*clean.mean(axis=0), *ratios(clean, base), np.median(over), over.max())
        rows.append([name, *(f"{x:.2f}" for x in shown)])
    return rows


def peers_table() -> list[list[str]]:
    """Return J of each filter on strokes that its setting was not found on: means of the dampers."""
    tuning, motions = packaged(TUNED), packaged(JUDGED)
    base = costs(motions, earlier)
    sampling = replace(choose_sampling([motion.recording for motion in tuning]), outlier_m=1.0)
    found = {EARLIER: ("by its rule", earlier)}
    for one in PEERS:
        found[one.name] = tune(one.grid, one.unit, partial(partial, peer, one.speeds), tuning)
    for ms in (0, 3):
        late = replace(sampling, delay_s=1e-3 * ms)
        make = lambda f, late=late: partial(bank, replace(late, frequencies_Hz=(f,)))  # noqa: E731
        found[f"one mode of the bank, {ms} ms"] = tune(grid(3, 100), "Hz", make, tuning)
        found[f"**the bank, {ms} ms**"] = "by its rule", partial(bank, late)
    rows = [["filter", "setting", *JUDGED, "ratio: median", "worst"]]
    for name, (setting, estimate) in found.items():
        clean = costs(motions, estimate)
        rows.append([name, setting, *(f"{x:.2f}" for x in (*clean.mean(axis=1), *ratios(clean, base)))])
    return rows


def tune(
    numbers: Sequence[float], unit: str, make: Callable[[float], Estimate], tuning: Sequence[Motion]
) -> tuple[str, Estimate]:
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
    cases |= {name: (packaged((*JUDGED, "noise"), how), banks(how)) for name, how in OTHER_CONDITIONS.items()}
    rows = [["stroke or sensor", *(f"{ms} ms" for ms in DELAYS_MS)]]
    for name, (motions, estimates) in cases.items():
        base = costs(motions, earlier)
        found = {ms: "{:.2f} / {:.2f}".format(*ratios(costs(motions, one), base)) for ms, one in estimates.items()}
        rows.append([name, *(found.get(ms, "-") for ms in DELAYS_MS)])
    return rows


def measured_table() -> list[list[str]]:
    """Return J of models of measured dampers on data held out, by the delay of the speed."""
    rows = [["damper, held-out part", "structure", *(f"{ms} ms" for ms in DELAYS_MS)]]
    for name in filter(is_present, MEASURED_CASES):
        cases = [MEASURED_CASES[name](1e-3 * ms) for ms in DELAYS_MS]
        for structure in ("polynomial", "chambers"):
            models = [fit_ours(structure, case, SEARCH_S) for case in cases]
            for row in cases[0].tests:
                found = (mean_cost(case.tests[row], one.simulate) for case, one in zip(cases, models, strict=True))
                rows.append([row, structure, *(f"{j:.1f}" for j in found)])
    return rows


TABLES: dict[str, Callable[[], list[list[str]]]] = {
    "delay": delay_table,
    "peers": peers_table,
    "elsewhere": elsewhere_table,
    "measured": measured_table,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "tables", nargs="*", choices=[[], *TABLES], metavar="TABLE", help=f"one or more of {', '.join(TABLES)}"
    )
    names = parser.parse_args().tables or list(TABLES)
    print("\n\n".join(markdown(TABLES[name]()) for name in names))


if __name__ == "__main__":
    main()
