"""Comparison of causal differentiators: delay and noise, and error in the damping force.

Two tables, printed as Markdown: the rig's recordings, with true speed and with the rig's own plant driven by each
estimate; and what the package's rule for its own differentiator picks. Measured data join in if the folder in CES_DATA
(default ../shared/data beside the checkout) is there. Each peer has its one number set to the least RMS error over all
of the rig's recordings, knowing the true speed; the package's own has only its rule.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import blas_one_thread  # noqa: F401 - before NumPy
import numpy as np
from differentiator_peers import PEERS, F, Peer
from recorded_cases import load_dyke, load_utfsm
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt

from ces_data.recording import Channel, Recording
from ces_identify.prepare.sampling import best_differentiator, choose_sampling, position_spectrum, sample_rate
from ces_identify.prepare.series import Series, prepare, usable_samples
from ces_observer.model import Sampling
from ces_rig.dampers.hydraulic.parameters import Hydraulic
from ces_rig.dampers.stepper import simulate
from ces_rig.experiment import Experiment, find_experiment, load_experiment, measure, simulate_truth
from ces_rig.sensors import GRID_S, Truth

RIG = ("sine_4hz", "sine_12hz", "sweep", "noise", "road")
RATE = 1000.0
WARM_UP_S = 1.0
OWN = "**ours, by its rule**"


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


def relative_error(estimate: F, speed: F) -> float:
    """Return the RMS error in % of the RMS speed, after the warm-up."""
    late = slice(round(WARM_UP_S * RATE), None)
    return float(100.0 * np.std((estimate - speed)[late]) / np.std(speed[late]))


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


def rig_table(runs: dict[str, RigRun]) -> list[str]:
    head = ["differentiator", "its number", *(f"{n} v" for n in RIG), "noise", "delay 4 Hz", "delay 12 Hz"]
    rows = [[*head, *(f"{n} F" for n in RIG)]]
    for peer in PEERS:
        number = tune(peer, [r.positions for r in runs.values()], [r.speed for r in runs.values()], RATE)
        estimates = {n: peer.speeds(r.positions, RATE, number) for n, r in runs.items()}
        clean = peer.speeds(runs["noise"].stroke, RATE, number)  # distortion alone
        noise = noise_share(estimates["noise"], clean, runs["noise"].speed)
        rows.append([peer.name, f"{number:.3g} {peer.unit}", *rig_row(estimates, runs, f"{noise:.1f}")])
    sampling = choose_sampling([runs["noise"].recording, runs["sweep"].recording])
    estimates = {n: own_estimate(sampling, r.recording) for n, r in runs.items()}
    quiet = Recording("quiet", dict(runs["noise"].recording.channels) | {"position": quiet_position(runs["noise"])})
    noise = noise_share(estimates["noise"], own_estimate(sampling, quiet), runs["noise"].speed)
    number = f"order {sampling.order}, {sampling.bandwidth_Hz:.0f} Hz"
    rows.append([OWN, number, *rig_row(estimates, runs, f"{noise:.1f}")])
    return markdown(rows)


def rig_row(estimates: dict[str, F], runs: dict[str, RigRun], noise: str) -> list[str]:
    errors = [f"{relative_error(estimates[n], runs[n].speed):.1f}" for n in RIG]
    delays = [delay_ms(estimates[n], runs[n].speed, f) for n, f in (("sine_4hz", 4.0), ("sine_12hz", 12.0))]
    forces = [f"{plant_cost(estimates[n], runs[n]):.1f}" for n in RIG]
    return [*errors, noise, *(f"{d:+.2f}" for d in delays), *forces]


def quiet_position(run: RigRun) -> Channel:
    """Return the position channel without noise, jitter and quantisation."""
    channel = run.recording.channel("position")
    stamps = channel.stamps_ns[0] + np.arange(len(channel)) * round(1e9 / RATE)
    return Channel("position", "m", stamps, run.stroke)


def load_measured_sets(data: Path) -> dict[str, list[Recording]]:
    if not data.is_dir():
        return {}
    return {
        "Dyke ranran_50": [load_dyke(data / "dyke_mr" / "ranran_50.csv")],
        "UTFSM sweeps": [load_utfsm(p) for p in sorted((data / "utfsm_mr").glob("sweep_15Hz_*A.csv"))],
        "UTFSM sines": [load_utfsm(p) for p in sorted((data / "utfsm_mr").glob("sine_10mm2Hz_*A.csv"))],
    }


def with_speed(prepared: list[Series], recordings: list[Recording], speeds: list[F]) -> list[Series]:
    out = []
    for series, recording, speed in zip(prepared, recordings, speeds, strict=True):
        out.append(replace(series, speed=np.interp(series.time_s, sample_times(recording), speed)))
    return out


def rule_table(runs: dict[str, RigRun], data: Path) -> list[str]:
    sets = {f"rig {name}": [run.recording] for name, run in runs.items()} | load_measured_sets(data)
    rows = [["recordings", "rate [Hz]", "order", "bandwidth [Hz]", "best of order 2 [Hz]", "best of order 3 [Hz]"]]
    for name, recordings in sets.items():
        spectra = [position_spectrum(r, 0.1) for r in recordings]
        bandwidth, order = best_differentiator(spectra)
        each = [f"{best_differentiator(spectra, (o,))[0]:.0f}" for o in (2, 3)]
        rows.append([name, f"{sample_rate(recordings[0]):.0f}", str(order), f"{bandwidth:.0f}", *each])
    return markdown(rows)


def noise_share(estimate: F, clean: F, speed: F) -> float:
    """Return the RMS difference of two estimates in % of the RMS speed."""
    late = slice(round(WARM_UP_S * RATE), None)
    return float(100.0 * np.std((estimate - clean)[late]) / np.std(speed))


def markdown(rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:], ""]


def main() -> None:
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    data = Path(os.environ.get("CES_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    runs = {name: rig_run(name) for name in RIG}
    print("### Speed error v, noise share, phase delay [ms], and J of the plant driven by the estimate F [%]\n")
    print("\n".join(rig_table(runs)), flush=True)
    print("### What the rule picks\n")
    print("\n".join(rule_table(runs, data)))


if __name__ == "__main__":
    main()
