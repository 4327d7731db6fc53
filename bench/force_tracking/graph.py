"""Force tracking on a real ROS graph, compared with the same run in process; launches closed_loop.launch.py.

Usage, where the package is installed and sourced: python3 -m bench.force_tracking.graph [--seconds 20]
The rig provides the time, so that every sample has a known tick: at real time, and at half of it for slow computers.
The stroke is that of `compare.py`. The force is the load cell's, whose noise of 8 N is small compared with the errors.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from bench.force_tracking.cases import CASES, STROKES, with_effect
from bench.force_tracking.loop import Design, TrackedRun, evaluate_run, track
from ces_observer.model import load_model
from ces_rig.drive.vehicle_kernel import STROKE
from ces_rig.live.node import CLOCK_START_NS
from ces_rig.live.rig import LiveRig

SAMPLE = Path(__file__).resolve().parents[2] / "config" / "models" / "sample.json"
MODES = {"in process": None, "graph, half of real time": "0.5", "graph, real time": "1.0"}
FEEDBACKS = ("none", "estimate", "measured")
SETTINGS = with_effect(STROKES["noise stroke"], CASES[0].draw_effect(0), 0)
PATIENCE_S = 120.0
DEEP = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)


class ForceListener(Node):  # type: ignore[misc]  # rclpy is missing where types are checked
    """Records the measured force by tick."""

    def __init__(self) -> None:
        super().__init__("force_listener")
        self.force_N: dict[int, float] = {}
        self.create_subscription(WrenchStamped, "measured_force", self._on_force, DEEP)

    def _on_force(self, message: WrenchStamped) -> None:
        stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        self.force_N[(stamp_ns - CLOCK_START_NS) * SETTINGS.rate_hz // 10**9] = message.wrench.force.z


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=20.0)
    seconds = parser.parse_args().seconds
    rclpy.init()
    print("| feedback | " + " | ".join(f"{mode}: J % (RMS N)" for mode in MODES) + " |")
    print(f"|---|{'---:|' * len(MODES)}")
    for feedback in FEEDBACKS:
        cells = []
        for factor in MODES.values():
            run = in_process(feedback, seconds) if factor is None else on_graph(feedback, factor, seconds)
            cells.append(f"{run.J:.1f} ({run.rms_N:.0f} N)")
        print(f"| {feedback} | {' | '.join(cells)} |", flush=True)
    rclpy.shutdown()


def in_process(feedback: str, seconds: float) -> TrackedRun:
    return track(SETTINGS, Design.from_model(load_model(SAMPLE)), feedback, seconds)


def on_graph(feedback: str, factor: str, seconds: float) -> TrackedRun:
    """Launch the loop, listen for `seconds` of the rig's time, and end it."""
    ticks = round(seconds * SETTINGS.rate_hz)
    listener = ForceListener()
    with tempfile.TemporaryDirectory() as folder:
        launched = launch(Path(folder), feedback, factor)
        until = time.monotonic() + PATIENCE_S + seconds
        while max(listener.force_N, default=0) < ticks and time.monotonic() < until:
            rclpy.spin_once(listener, timeout_sec=0.1)
        os.killpg(launched.pid, signal.SIGINT)
        launched.wait()
    listener.destroy_node()
    return evaluate_forces(listener.force_N, ticks)


def launch(folder: Path, feedback: str, factor: str) -> subprocess.Popen[bytes]:
    """Start the launch file with the rig's settings of the bench."""
    script, rig = SETTINGS.script, folder / "rig.yaml"
    moves = f"script: {{cutoff_Hz: {script.cutoff_Hz}, loop_s: {script.loop_s}}}"
    rig.write_text(f"/**: {{ros__parameters: {{seed: {SETTINGS.seed}, {moves}}}}}\n", encoding="utf-8")
    words = {
        "use_sim_time": "true", "real_time_factor": factor, "feedback": feedback, "rig_params": str(rig),
        "stroke": script.kind, "amplitude_m": str(script.amplitude_m), "model": str(SAMPLE),
    }  # fmt: skip
    command = ["ros2", "launch", "ces_observer", "closed_loop.launch.py", *(f"{k}:={v}" for k, v in words.items())]
    return subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def evaluate_forces(force_N: Mapping[int, float], ticks: int) -> TrackedRun:
    """Evaluate the received forces like those of a run in process; lost messages do not count."""
    rig = LiveRig(replace(SETTINGS))
    stroke = np.empty(ticks)
    for k in range(ticks):
        rig.tick()
        stroke[k] = rig.motion[STROKE]
    force = np.array([force_N.get(k + 1, np.nan) for k in range(ticks)])
    nothing = np.full(ticks, np.nan)
    run = evaluate_run(rig, stroke, force, nothing, nothing)
    return replace(run, reachable=run.reachable & np.isfinite(force))


if __name__ == "__main__":
    main()
