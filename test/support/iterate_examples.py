"""Small plans, limits and rigs of the loop, with which a whole iteration takes seconds."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ces_data.recording import Recording
from ces_rig.dampers.stepper import KINDS
from ces_rig.experiments.commands import INTERVAL_S, HeatLimits, RigCommands, RigLimits
from ces_rig.experiments.designer import DesignTask, make_power_model
from ces_rig.experiments.information import Information, Pool, draw_features, draw_pool
from ces_rig.loop.rigs import Plan, VirtualRig, parse_plan

LIMITS: Mapping[str, Any] = {
    "stroke_m": 0.02, "speed_m_s": 0.7, "acceleration_m_s2": 60.0, "low_A": 0.2, "high_A": 1.6, "frequency_Hz": 12.0,
}  # fmt: skip


def make_limits(**changes: Any) -> RigLimits:
    return RigLimits(**{**LIMITS, **changes})


def make_plan(folder: Path, **sections: Any) -> Plan:
    """Return a plan of two experiments of 3 s on a damper known by a table, with a small search."""
    content: dict[str, Any] = {
        "limits": dict(LIMITS),
        "rig": {"kind": "virtual"},
        "experiments": {"duration_s": 3.0},
        "stop": {"budget_s": 6.0},
        "identify": {"structure": "polynomial", "terms": 4, "starts": 1, "threads": 1},
    }
    return parse_plan(content | sections, "plan.yaml", folder)


def small_rig() -> VirtualRig:
    return VirtualRig(KINDS["lookup"].design)


def make_task(limits: RigLimits, seed: int = 1, load_W: float = 0.0) -> tuple[DesignTask, Pool]:
    """Return the task of a first experiment, and the pool of its targets."""
    pool, features = draw_pool(limits, seed), draw_features(seed)
    targets = features.at(pool.state)
    power = make_power_model(None, limits.heat)
    nothing = Information.none(targets.shape[1])
    return DesignTask(limits, features, nothing, targets, np.ones(len(targets)), power, load_W), pool


def sine_commands(name: str = "sine", duration_s: float = 3.0) -> RigCommands:
    time = np.arange(round(duration_s / INTERVAL_S) + 1) * INTERVAL_S
    return RigCommands(name, 0.01 * np.sin(2 * np.pi * 3.0 * time) ** 3, 0.9 + 0.5 * np.sign(np.sin(9.0 * time)))


class BreakingRig:
    """The virtual rig, but Ctrl-C comes during the run of this number."""

    def __init__(self, break_at: int) -> None:
        self.rig, self.runs, self.break_at = small_rig(), 0, break_at

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        self.runs += 1
        if self.runs == self.break_at:
            raise KeyboardInterrupt
        return self.rig.run(commands, folder)


HOT = HeatLimits(power_W=5.0, memory_s=20.0, force_N=300.0)
