"""The tables of docs/speed.md: causal differentiators compared by the error that they leave in the damping force.

    python bench/bench_differentiators.py peers     # the rig's own plant driven by the speed of each differentiator
    python bench/bench_differentiators.py adaptive  # one bandwidth beside the adaptive one, at three noise levels

Each peer has its one number set to the least RMS error of the speed over all of the rig's recordings, knowing the true
speed; the package's own has only its rule.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import blas_one_thread  # noqa: F401 - before NumPy
import numpy as np
from differentiator_peers import PEERS, F, Peer
from markdown import markdown
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

from ces_data.recording import Channel, Recording
from ces_identify.prepare.sampling import choose_sampling
from ces_identify.prepare.series import prepare, usable_samples
from ces_observer.model import ADAPTIVE, KALMAN, Sampling
from ces_rig.dampers.hydraulic.parameters import Hydraulic
from ces_rig.dampers.stepper import simulate
from ces_rig.experiment import Experiment, find_experiment, load_experiment, measure, simulate_truth
from ces_rig.sensors import GRID_S, Truth, measure_signals

RIG = ("sine_4hz", "sine_12hz", "sweep", "noise", "road")
RATE = 1000.0
WARM_UP_S = 1.0
OWN = "**ours, by its rule**"
NOISE_SCALES = (0.3, 1.0, 3.0)


@dataclass(frozen=True)
class RigRun:
    """A rig recording with its truth: true time, position and speed at each logged position sample."""

    experiment: Experiment
    true: Truth
    recording: Recording
    at: F
    stroke: F
    speed: F

    @property
    def positions(self) -> F:
        return self.recording.channel("position").values


def rig_run(name: str) -> RigRun:
    experiment = load_experiment(find_experiment(name))
    true = simulate_truth(experiment)
    recording = measure(experiment, true)
    at = experiment.sensors.position.phase_s + np.arange(len(recording.channel("position"))) / RATE
    stroke = CubicSpline(true.time_s, true.stroke_m)
    return RigRun(experiment, true, recording, at, stroke(at), stroke(at, 1))


def delay_ms(estimate: F, speed: F, frequency: float) -> float:
    """Return the phase delay [ms] of the estimate relative to the true speed at one frequency."""
    late = slice(round(WARM_UP_S * RATE), None)
    turn = np.exp(-2j * np.pi * frequency * np.arange(len(speed)) / RATE)[late]
    lag = -np.angle((estimate[late] @ turn) / (speed[late] @ turn))
    return float(1e3 * lag / (2.0 * np.pi * frequency))


def plant_cost(estimate: F, run: RigRun, seconds: float = 12.0) -> float:
    """Return J [%] between the rig's plant driven by the estimated and by the true speed.

    The error of the speed is integrated to a stroke, less what lies below 0.5 Hz, which would be a drift.
    """
    time = run.true.time_s
    kept = time <= seconds
    true_speed = CubicSpline(time, run.true.stroke_m)(time, 1)
    error = np.interp(time, run.at, estimate) - true_speed
    error[time < 0.1] = 0.0
    drift = sosfilt(butter(1, 0.5, "high", fs=1.0 / GRID_S, output="sos"), np.cumsum(error) * GRID_S)
    damper = run.experiment.damper
    driven = simulate(Hydraulic(damper), GRID_S, (run.true.stroke_m + drift)[kept], run.true.commanded_A[kept])
    late = time[kept] > WARM_UP_S
    wanted = run.true.force_N[kept][late]
    error_N = driven.tared_N[late] - wanted
    return float(100.0 * np.linalg.norm(error_N) / np.linalg.norm(wanted - wanted.mean()))


def own_estimate(sampling: Sampling, recording: Recording) -> F:
    """Return the package's own speed at the position samples, with its preparation and the logged stamps."""
    series = prepare(recording, sampling)
    return np.asarray(np.interp(sample_times(recording), series.time_s, series.speed))


def sample_times(recording: Recording) -> F:
    """Return the times [s] of all position samples from the first with a current, like `Series.time_s`."""
    stamps = recording.channel("position").stamps_ns
    return np.asarray((stamps - usable_samples(recording, 1e6).stamps_ns[0]) * 1e-9)


def tune(peer: Peer, positions: Sequence[F], speeds: Sequence[F], rate: float) -> float:
    """Return the peer's setting with the smallest mean relative error; frequencies scale with the rate."""
    grid = [g * (rate / RATE if peer.unit == "Hz" else 1.0) for g in peer.grid]
    pairs = list(zip(positions, speeds, strict=True))
    late = slice(round(WARM_UP_S * rate), None)

    def error(number: float) -> float:
        return float(np.mean([np.std((peer.speeds(x, rate, number) - v)[late]) / np.std(v[late]) for x, v in pairs]))

    return min(grid, key=error)


def peers_table(runs: Mapping[str, RigRun]) -> list[list[str]]:
    """Return the noise, the delay and the force error of each differentiator."""
    rows = [["differentiator", "its number", "noise %", "delay at 4 Hz [ms]", *RIG]]
    for peer in PEERS:
        number = tune(peer, [r.positions for r in runs.values()], [r.speed for r in runs.values()], RATE)
        estimates = {n: peer.speeds(r.positions, RATE, number) for n, r in runs.items()}
        clean = peer.speeds(runs["noise"].stroke, RATE, number)  # distortion alone
        rows.append([peer.name, f"{number:.3g} {peer.unit}", *peer_row(estimates, clean, runs)])
    sampling = choose_sampling([runs["noise"].recording, runs["sweep"].recording])
    estimates = {n: own_estimate(sampling, r.recording) for n, r in runs.items()}
    quiet = Recording("quiet", dict(runs["noise"].recording.channels) | {"position": quiet_position(runs["noise"])})
    clean = own_estimate(sampling, quiet)
    rows.append([OWN, f"order {sampling.order}, {sampling.bandwidth_Hz:.0f} Hz", *peer_row(estimates, clean, runs)])
    return rows


def peer_row(estimates: Mapping[str, F], clean: F, runs: Mapping[str, RigRun]) -> list[str]:
    noise = noise_share(estimates["noise"], clean, runs["noise"].speed)
    delay = delay_ms(estimates["sine_4hz"], runs["sine_4hz"].speed, 4.0)
    forces = [f"{plant_cost(estimates[n], runs[n]):.1f}" for n in RIG]
    return [f"{noise:.1f}", f"{delay:+.2f}", *forces]


def quiet_position(run: RigRun) -> Channel:
    """Return the position channel without noise, jitter and quantisation."""
    channel = run.recording.channel("position")
    stamps = channel.stamps_ns[0] + np.arange(len(channel)) * round(1e9 / RATE)
    return Channel("position", "m", stamps, run.stroke)


def adaptive_table(runs: Mapping[str, RigRun]) -> list[list[str]]:
    """Return the force error behind the single and the adaptive filter, their parameters from noise and sweep."""
    rows = [["position noise", "speed", *RIG]]
    for scale in NOISE_SCALES:
        noisy = {name: with_noise(run, scale) for name, run in runs.items()}
        training = [noisy["noise"].recording, noisy["sweep"].recording]
        for kind in (KALMAN, ADAPTIVE):
            sampling = choose_sampling(training, differentiator=kind)
            costs = (plant_cost(own_estimate(sampling, noisy[n].recording), noisy[n]) for n in RIG)
            rows.append([f"x {scale:g}", f"`{kind}`", *(f"{cost:.2f}" for cost in costs)])
    return rows


def with_noise(run: RigRun, scale: float) -> RigRun:
    """Return the same experiment with `scale` times the noise and resolution of its position sensor."""
    sensors, settings = run.experiment.sensors, run.experiment.settings
    position = replace(sensors.position, noise=scale * sensors.position.noise, quantum=scale * sensors.position.quantum)
    noisy = replace(sensors, position=position)
    return replace(run, recording=measure_signals(run.true, noisy, settings.seed, settings.name))


def noise_share(estimate: F, clean: F, speed: F) -> float:
    """Return the RMS difference of two estimates in % of the RMS speed."""
    late = slice(round(WARM_UP_S * RATE), None)
    return float(100.0 * np.std((estimate - clean)[late]) / np.std(speed))


TABLES: dict[str, Callable[[Mapping[str, RigRun]], list[list[str]]]] = {
    "peers": peers_table,
    "adaptive": adaptive_table,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "tables", nargs="*", choices=[[], *TABLES], metavar="TABLE", help=f"one or more of {', '.join(TABLES)}"
    )
    names = parser.parse_args().tables or list(TABLES)
    runs = {name: rig_run(name) for name in RIG}
    print("\n\n".join(markdown(TABLES[name](runs)) for name in names))


if __name__ == "__main__":
    main()
