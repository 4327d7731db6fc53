# ruff: noqa: E402 - thread counts must be set before NumPy is imported
"""Comparison of causal differentiators: delay and noise, error in the damping force, and cost J after a search.

Three tables, printed and with `--out FILE` written as Markdown: the rig's recordings, with true speed and with the
rig's own plant driven by each estimate; the cost J of models searched for on each estimate (`--search`); and what the
package's rule for its own differentiator picks. Measured data join in if the folder in CES_DATA (default ../shared/data
beside the checkout) is there. Each peer has its one number set to the least RMS error over all of the rig's
recordings, knowing the true speed; the package's own has only its rule. `--figure FILE` draws the trade-off.
"""

from __future__ import annotations

import os

for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import argparse
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from differentiator_peers import PEERS, F, Peer, kalman
from recorded_cases import load_dyke, load_utfsm
from scipy.interpolate import CubicSpline
from scipy.signal import butter, sosfilt, sosfiltfilt

from ces_identify.numerics.kernels import free_run
from ces_identify.polynomial.compiled_terms import compile_terms, power_table
from ces_identify.polynomial.search_limits import Limits
from ces_identify.polynomial.selection import search
from ces_identify.preparation.cost import series_cost
from ces_identify.preparation.position_spectrum import position_spectrum, sample_rate
from ces_identify.preparation.sampling import best_differentiator, choose_sampling
from ces_identify.preparation.series import Series, prepare, usable_samples
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.polynomial import build_problem
from ces_observer.model import Sampling
from ces_rig.dampers.hydraulic.stepper import rest_force, simulate
from ces_rig.experiment import GRID_S, Experiment, Truth, find_experiment, load_experiment, measure, simulate_truth

RIG = ("sine_4hz", "sine_12hz", "sweep", "noise", "road")
RATE = 1000.0
WARM_UP_S = 1.0
REFERENCE_HZ = 100.0  # [Hz] zero-phase low-pass that defines the true speed of measured data
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


def clean_estimate(peer: Peer, number: float, run: RigRun) -> F:
    """Return the estimate from the noise-free stroke at the sampling times: distortion alone."""
    return peer.speeds(run.stroke, RATE, number)


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
    driven = simulate(damper, GRID_S, (run.true.stroke_m + drift)[kept], run.true.commanded_A[kept])
    late = time[kept] > WARM_UP_S
    wanted = run.true.force_N[kept][late]
    error_N = driven.force_N[late] - rest_force(damper) - wanted
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
        clean = clean_estimate(peer, number, runs["noise"])
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


def search_table(runs: dict[str, RigRun], data: Path, seconds: float) -> list[str]:
    """Return J on held-out ticks of the best model on the selection ticks and, in brackets, of the other start."""
    sets = {"rig noise + sweep": [runs["noise"].recording, runs["sweep"].recording], **load_measured_sets(data)}
    columns = {name: search_costs(recordings, seconds) for name, recordings in sets.items()}
    names = list(next(iter(columns.values())))
    return markdown([["J [%], 60 % / 40 %", *columns], *([n, *(c[n] for c in columns.values())] for n in names)])


def load_measured_sets(data: Path) -> dict[str, list[Recording]]:
    if not data.is_dir():
        return {}
    return {
        "Dyke ranran_50": [load_dyke(data / "dyke_mr" / "ranran_50.csv")],
        "UTFSM sweeps": [load_utfsm(p) for p in sorted((data / "utfsm_mr").glob("sweep_15Hz_*A.csv"))],
        "UTFSM sines": [load_utfsm(p) for p in sorted((data / "utfsm_mr").glob("sine_10mm2Hz_*A.csv"))],
    }


def search_costs(recordings: list[Recording], seconds: float) -> dict[str, str]:
    rate = sample_rate(recordings[0])
    sampling = choose_sampling(recordings)
    prepared = [prepare(r, sampling) for r in recordings]
    positions = [r.channel("position").values for r in recordings]
    low = butter(4, min(REFERENCE_HZ, 0.4 * rate), fs=rate, output="sos")
    reference = [sosfiltfilt(low, np.gradient(x) * rate) for x in positions]
    out = {"zero phase (not causal)": search_and_score(with_speed(prepared, recordings, reference), seconds)}
    for peer in PEERS:
        number = tune(peer, positions, reference, rate)
        speeds = [peer.speeds(x, rate, number) for x in positions]
        out[peer.name] = search_and_score(with_speed(prepared, recordings, speeds), seconds)
    own = [kalman(sampling.order)(x, rate, sampling.bandwidth_Hz) for x in positions]
    out[OWN] = search_and_score(with_speed(prepared, recordings, own), seconds)
    return out


def with_speed(prepared: list[Series], recordings: list[Recording], speeds: list[F]) -> list[Series]:
    out = []
    for series, recording, speed in zip(prepared, recordings, speeds, strict=True):
        out.append(replace(series, speed=np.interp(series.time_s, sample_times(recording), speed)))
    return out


def search_and_score(series: list[Series], seconds: float, terms: int = 20) -> str:
    problem = build_problem(
        [s.part(0.0, 0.6) for s in series], IdentifyOptions(limits=Limits(terms, seconds, threads=2))
    )
    costs = []
    for found in search(problem, Limits(max_terms=terms, seconds=seconds, starts=2, threads=2)):
        chosen = [problem.candidates[i] for i in found.chosen]
        compiled = compile_terms(chosen)
        held_out = [s.part(0.6, 1.0) for s in series]
        costs.append(np.mean([cost_of(compiled, found.coefficients, problem, s) for s in held_out]))
    return f"{costs[0]:.1f} ({costs[1]:.1f})"


def cost_of(compiled, coefficients, problem, series: Series) -> float:  # type: ignore[no-untyped-def]
    powers = power_table(compiled.powers, problem.envelope, series.position, series.speed, series.current)
    force, _ = free_run(powers, series.segments, compiled.arrays, coefficients, problem.force_envelope)
    return series_cost(series, force)


def rule_table(runs: dict[str, RigRun], data: Path) -> list[str]:
    sets = {f"rig {name}": [run.recording] for name, run in runs.items()} | load_measured_sets(data)
    rows = [["recordings", "rate [Hz]", "order", "bandwidth [Hz]", "best of order 2 [Hz]", "best of order 3 [Hz]"]]
    for name, recordings in sets.items():
        spectra = [position_spectrum(r, 0.1) for r in recordings]
        bandwidth, order = best_differentiator(spectra)
        each = [f"{best_differentiator(spectra, (o,))[0]:.0f}" for o in (2, 3)]
        rows.append([name, f"{sample_rate(recordings[0]):.0f}", str(order), f"{bandwidth:.0f}", *each])
    return markdown(rows)


SHOWN = {
    "Kalman, white acceleration (α-β)": "C0-",
    "Kalman, white jerk": "C1-",
    "Kalman, white snap": "C2-",
    "difference, Butterworth 2": "C3-",
    "Savitzky–Golay 2, end": "C4-",
    "Levant, second order": "C5--",
    "adaptive window (FOAW)": "C6--",
}


def draw(runs: dict[str, RigRun], path: Path) -> None:
    """Draw noise over distortion of the speed (noise recording, left) and the plant's J (road, right)."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.4), layout="constrained")
    sampling = choose_sampling([runs["noise"].recording, runs["sweep"].recording])
    peers = {peer.name: peer for peer in PEERS if peer.name in SHOWN}
    for name, style in SHOWN.items():
        width = 2.4 if "jerk" in name else 1.4
        left.loglog(*trade_off(peers[name], runs["noise"]), style, lw=width, label=name)
    quiet = Recording("quiet", dict(runs["noise"].recording.channels) | {"position": quiet_position(runs["noise"])})
    own, clean = own_estimate(sampling, runs["noise"].recording), own_estimate(sampling, quiet)
    speed = runs["noise"].speed
    left.loglog(relative_error(clean, speed), noise_share(own, clean, speed), "ko", ms=8, label="the rule's pick")
    for total in (3.0, 6.0):
        angle = np.linspace(0.02, 1.5, 60)
        left.loglog(total * np.cos(angle), total * np.sin(angle), color="0.75", lw=0.8, zorder=0)
        left.text(total * 1.03, 0.55, f"{total:.0f} % in total", color="0.45", fontsize=8, rotation=90)
    left.set(xlim=(0.3, 30), ylim=(0.5, 20), xlabel="distortion and delay [% of RMS speed]")
    left.set(ylabel="noise [% of RMS speed]", title="Speed, rig noise recording")
    for name in ("Kalman, white acceleration (α-β)", "Kalman, white jerk", "Kalman, white snap"):
        grid = [g for g in peers[name].grid[::2] if 40.0 <= g <= 330.0]
        costs = [plant_cost(peers[name].speeds(runs["road"].positions, RATE, g), runs["road"]) for g in grid]
        right.semilogx(grid, costs, SHOWN[name], lw=2.4 if "jerk" in name else 1.4, marker=".")
    own = own_estimate(sampling, runs["road"].recording)
    right.semilogx(sampling.bandwidth_Hz, plant_cost(own, runs["road"]), "ko", ms=8)
    right.set(ylim=(0, 16), xlabel="bandwidth [Hz]", ylabel="J of the plant driven by the estimate [%]")
    right.set(title="Force, rig road recording", xticks=[50, 100, 200, 300], xticklabels=["50", "100", "200", "300"])
    right.minorticks_off()
    for axes in (left, right):
        axes.grid(which="major", alpha=0.2)
        axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def trade_off(peer: Peer, run: RigRun) -> tuple[list[float], list[float]]:
    """Return distortion and noise [% of RMS speed] over the peer's grid."""
    clean = [clean_estimate(peer, number, run) for number in peer.grid]
    noisy = [peer.speeds(run.positions, RATE, number) for number in peer.grid]
    noise = [noise_share(n, c, run.speed) for n, c in zip(noisy, clean, strict=True)]
    return [relative_error(c, run.speed) for c in clean], noise


def noise_share(estimate: F, clean: F, speed: F) -> float:
    """Return the RMS difference of two estimates in % of the RMS speed."""
    late = slice(round(WARM_UP_S * RATE), None)
    return float(100.0 * np.std((estimate - clean)[late]) / np.std(speed))


def markdown(rows: list[list[str]]) -> list[str]:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:], ""]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="Markdown file for the tables")
    parser.add_argument("--figure", type=Path, help="image file for the trade-off")
    parser.add_argument("--search", type=float, default=0.0, metavar="SECONDS", help="also run searches of this length")
    arguments = parser.parse_args()
    data = Path(os.environ.get("CES_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    runs = {name: rig_run(name) for name in RIG}
    tables: list[tuple[str, Callable[[], list[str]]]] = [
        (
            "Speed error v, noise share, phase delay [ms], and J of the plant driven by the estimate F [%]",
            lambda: rig_table(runs),
        ),
        ("What the rule picks", lambda: rule_table(runs, data)),
    ]
    if arguments.search > 0.0:
        tables.append(("Cost of models searched for", lambda: search_table(runs, data, arguments.search)))
    lines: list[str] = []
    for title, make in tables:
        table = [f"### {title}", "", *make()]
        print("\n".join(table), flush=True)
        lines += table
    if arguments.out:
        arguments.out.write_text("\n".join(lines), encoding="utf-8")
    if arguments.figure:
        draw(runs, arguments.figure)


if __name__ == "__main__":
    main()
