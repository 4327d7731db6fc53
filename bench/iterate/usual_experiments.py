"""The experiments that `ces iterate` is compared with and the recordings that judge, for any damper of the virtual rig.

The packaged descriptions are used as they are; their currents, 0.29 to 0.7 A, are mapped to the damper's own range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ces_identify.recordings.recording import Recording
from ces_iterate.commands import INTERVAL_S, RigCommands
from ces_iterate.plan.limits import RigLimits
from ces_iterate.rigs.virtual import VirtualRig
from ces_rig.dampers.kinds import KINDS
from ces_rig.drive.currents import make_current
from ces_rig.drive.reg1 import Reg1
from ces_rig.drive.working_range import HIGH, LOW
from ces_rig.experiment import find_experiment, load_experiment

PACKAGED = "as packaged"
BINARY, STEPS = {"kind": "binary"}, {"kind": "steps", "levels_A": [0.29, 0.495, 0.70, 0.3925, 0.5975], "hold_s": 1.0}
FREE = {"kind": "filtered_noise"}
JUDGES: Sequence[tuple[str, str, Mapping[str, Any] | None]] = (
    ("road", PACKAGED, None), ("road", "binary", BINARY), ("road", "steps", STEPS),
    ("sine_4hz", PACKAGED, None), ("sine_4hz", "binary", BINARY), ("sine_4hz", "steps", STEPS),
    ("sine_12hz", PACKAGED, None), ("sine_12hz", "binary", BINARY), ("sine_12hz", "steps", STEPS),
    ("fm_binary", PACKAGED, None), ("fm_binary", "steps", STEPS),
)  # fmt: skip
"""Stroke, name of its current, and the current if it is not the packaged one."""


def make_rig(kind: str) -> VirtualRig:
    """Return the virtual rig: the packaged damper for `default`, else the design of a kind of damper."""
    return VirtualRig() if kind == "default" else VirtualRig(KINDS[kind].design)


def packaged_commands(
    name: str, rig: VirtualRig, seed: int, duration_s: float | None = None, current: Mapping[str, Any] | None = None
) -> RigCommands:
    """Return a packaged experiment with another seed, and if given with another length and current."""
    experiment = load_experiment(find_experiment(name))
    time = np.arange(round((duration_s or experiment.settings.duration_s) / INTERVAL_S) + 1) * INTERVAL_S
    stroke = experiment.stroke.samples(time, np.random.default_rng([seed, 0]))
    kind = make_current(current, name) if current else experiment.current
    assert not isinstance(kind, Reg1)
    share = (kind.samples(time, stroke, np.random.default_rng([seed, 1])) - LOW) / (HIGH - LOW)
    low, high = rig.model.current_A
    return RigCommands(name, stroke, low + (high - low) * share, seed)


def usual_commands(rig: VirtualRig, seed: int, total_s: float, current: Mapping[str, Any] | None) -> list[RigCommands]:
    """Return noise and sweep of the same length, `total_s` together."""
    return [
        packaged_commands(name, rig, 100 * seed + k, 0.5 * total_s, current)
        for k, name in enumerate(("noise", "sweep"))
    ]


def judging_recordings(rig: VirtualRig, seed: int, run: Any) -> dict[str, Recording]:
    """Return the recordings that judge, by name; `run` records commands."""
    return {
        f"{stroke}, {name}": run(packaged_commands(stroke, rig, 100 * seed + 50 + k, None, current))
        for k, (stroke, name, current) in enumerate(JUDGES)
    }


def kindred_commands(rig: VirtualRig, seed: int, duration_s: float) -> list[RigCommands]:
    """Return experiments of the judging kinds, with other seeds than those that judge."""
    names = ("road", "sine_4hz", "sine_12hz", "fm_binary")
    return [packaged_commands(name, rig, 100 * seed + 80 + k, duration_s) for k, name in enumerate(names)]


def limits_of(commands: Sequence[RigCommands], rig: VirtualRig) -> RigLimits:
    """Return the limits that these commands reach, with the sweep's highest frequency."""
    motions = [one.motion() for one in commands]
    low, high = rig.model.current_A
    return RigLimits(
        stroke_m=max(float(np.abs(one.stroke_m).max()) for one in commands),
        speed_m_s=max(float(np.abs(speed).max()) for speed, _ in motions),
        acceleration_m_s2=max(float(np.abs(acceleration).max()) for _, acceleration in motions),
        low_A=low,
        high_A=high,
        frequency_Hz=16.0,
    )
