"""The figures of docs/rig.md.

python -m bench.rig.figures docs/img
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

mpl.use("Agg")
from matplotlib import pyplot as plt

from bench.rig.characteristic import current_step, cycle, rise_time, steady_force
from ces_iterate.stroke.goal import StrokeGoal
from ces_iterate.stroke.learning import learn_stroke
from ces_iterate.stroke.limits import StrokeLimits
from ces_iterate.stroke.rig import INTERVAL_S, VirtualStrokeRig
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.dampers.hydraulic.stepper import rest_force
from ces_rig.drive.servo_actuator import ServoActuator
from ces_rig.experiment import STREAMS, Truth, load_experiment, packaged_experiments, simulate_truth

CURRENTS = (0.29, 0.40, 0.50, 0.60, 0.70)  # [A] in the working range
BEYOND = {0.20: ":", 1.00: "--", 1.60: "-."}  # [A] outside it
STYLE: Any = {
    "figure.dpi": 130, "font.size": 10, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "grid.color": "#dddddd", "grid.linewidth": 0.6, "axes.axisbelow": True, "legend.frameon": False,
    "lines.linewidth": 1.6, "figure.constrained_layout.use": True,
}  # fmt: skip


def main(folder: Path) -> None:
    """Write all figures into `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    makers = {
        "steady": draw_steady_force,
        "loops": draw_loops,
        "step": draw_current_steps,
        "experiments": draw_experiments,
        "learned": draw_learned_stroke,
    }
    with plt.rc_context(STYLE):
        for name, make in makers.items():
            figure = make(Damper())
            figure.savefig(folder / f"rig_{name}.png", metadata={"Software": None})
            plt.close(figure)


def draw_steady_force(damper: Damper) -> Any:
    """Steady force over speed for several currents."""
    speeds = np.concatenate([np.geomspace(0.004, 0.04, 8), np.linspace(0.05, 0.2, 31), np.linspace(0.22, 0.8, 12)])
    signed = np.concatenate([-speeds[::-1], speeds])
    figure, axes = plt.subplots(figsize=(6.4, 4.6))
    for current in sorted({*CURRENTS, *BEYOND}):
        forces = [steady_force(damper, v, current) for v in signed]
        look = {"color": "#777777", "ls": BEYOND[current]} if current in BEYOND else {"color": _colour(current)}
        axes.plot(signed, np.array(forces) / 1e3, label=f"{current:.2f} A", **look)
    _zero_lines(axes)
    axes.set(xlabel="speed [m/s], positive in compression", ylabel="force [kN]", title="Steady force over speed")
    axes.legend(title="current", loc="lower right")
    return figure


def draw_loops(damper: Damper) -> Any:
    """Force over speed for sines of 4 and 12 Hz."""
    figure, both = plt.subplots(1, 2, figsize=(9.6, 4.4), sharey=True, sharex=True)
    for axes, (amplitude, frequency) in zip(both, ((0.018, 4.0), (0.006, 12.0)), strict=True):
        for current in CURRENTS[::2]:
            loop = cycle(damper, amplitude, frequency, current)
            axes.plot(loop.speed_m_s, loop.force_N / 1e3, color=_colour(current), label=f"{current:.2f} A")
        _zero_lines(axes)
        axes.set(xlabel="speed [m/s]", title=f"{frequency:.0f} Hz, ±{amplitude * 1e3:.0f} mm")
    both[0].set_ylabel("force [kN]")
    both[0].legend(title="current", loc="upper left")
    return figure


def draw_current_steps(damper: Damper) -> Any:
    """Force after steps of current at constant rebound speed."""
    figure, axes = plt.subplots(figsize=(6.4, 4.0))
    for first, last, colour in ((0.29, 0.70, _colour(0.70)), (0.70, 0.29, _colour(0.29))):
        run, at = current_step(damper, -0.2, first, last)
        label = f"{first:.2f} → {last:.2f} A: 63 % after {rise_time(run, at) * 1e3:.0f} ms"
        axes.plot((run.time_s - at) * 1e3, (run.force_N - rest_force(damper)) / 1e3, color=colour, label=label)
    axes.axvline(0.0, color="#888888", linewidth=0.8)
    axes.set(xlim=(-10, 80), xlabel="time after the step [ms]", ylabel="force [kN]", ylim=(-3.6, 0.6))
    axes.set_title("Step of current at 0.2 m/s rebound")
    axes.legend(loc="upper right")
    return figure


def draw_experiments(_: Damper) -> Any:
    """A second of each sample experiment: stroke, current and force."""
    names = ("sine_4hz", "sweep", "noise", "road")
    figure, grid = plt.subplots(3, 4, figsize=(11.0, 5.6), sharex="col", sharey="row")
    for column, name in zip(grid.T, names, strict=True):
        _second(column, name, simulate_truth(load_experiment(packaged_experiments()[name])))
    for axes, label in zip(grid[:, 0], ("stroke [mm]", "current [A]", "force [kN]"), strict=True):
        axes.set_ylabel(label)
    return figure


def draw_learned_stroke(_: Damper) -> Any:
    """The packaged road on the default actuator: errors over the runs, tracking, and the condition of convergence."""
    experiment = load_experiment(packaged_experiments()["road"])
    time = np.arange(round(experiment.settings.duration_s / INTERVAL_S) + 1) * INTERVAL_S
    wanted = experiment.stroke.samples(time, np.random.default_rng([experiment.settings.seed, STREAMS["stroke"]]))
    rig = VirtualStrokeRig(replace(experiment, actuator=ServoActuator()))
    learned = learn_stroke(rig, StrokeGoal(wanted, INTERVAL_S, StrokeLimits()))
    figure, (runs, tracking, condition) = plt.subplots(1, 3, figsize=(11.0, 3.6))
    error, floor = 1e6 * np.array([run.error_m for run in learned.runs]), 1e6 * learned.repeatability_m
    runs.axhspan(floor / 2.0, 1.5 * floor, color="#cfe5df", label="to 1.5 × repeatability")
    runs.semilogy(np.arange(1, len(error) + 1), error, "o-", color=_colour(0.5))
    runs.set(xlabel="run", ylabel="RMS error [µm]", title="Error over the runs", ylim=(floor / 2.0, 2.0 * error.max()))
    runs.legend()
    part = slice(5_400, 6_001)
    for values, colour, label in (
        (wanted, "#bbbbbb", "wanted"),
        (learned.first.position_m, _colour(0.35), "before"),
        (learned.confirmation.position_m, "#d1570b", "after"),
    ):
        width = 5.0 if label == "wanted" else 1.4
        tracking.plot(time[part], 1e3 * values[part], color=colour, label=label, linewidth=width)
    tracking.set(xlabel="time [s]", ylabel="position [mm]", title="Tracking")
    tracking.legend()
    f = learned.learning_filter
    condition.axhline(1.0, color="#888888", linewidth=0.8)
    condition.plot(f.frequency_Hz, f.share * f.bound_in_tolerance, color="#d1570b", label="model 30 % wrong")
    condition.plot(f.frequency_Hz, f.share * f.bound_measured, color=_colour(0.5), label="as measured")
    condition.plot(f.frequency_Hz, f.share, color="#777777", linestyle="--", label="Q")
    condition.set(xlabel="frequency [Hz]", title="|Q(1 − LG)|", ylim=(0.0, 1.25))
    condition.legend(loc="lower left", bbox_to_anchor=(0.0, 0.11), fontsize=8)
    return figure


def _second(column: Any, name: str, true: Truth) -> None:
    part = slice(20_000, 22_001)
    signals = (true.stroke_m * 1e3, true.coil_A, true.force_N / 1e3)
    for axes, signal in zip(column, signals, strict=True):
        axes.plot(true.time_s[part], signal[part], color=_colour(0.5), linewidth=1.2)
    column[0].set_title(name)
    column[2].set(xlabel="time [s]", xticks=(10.0, 10.5, 11.0))


def _colour(current_A: float) -> Any:
    return mpl.colormaps["viridis"](0.05 + 0.8 * (current_A - 0.29) / 0.41)


def _zero_lines(axes: Any) -> None:
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.axvline(0.0, color="#888888", linewidth=0.8)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("docs/img"))
