"""The plan of `ces iterate`: a YAML file goes in, checked limits, stopping rules and settings come out.

Every section is a frozen dataclass, checked once; `TEMPLATE` is a plan with every key explained.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import lfilter

from ces_data.arrays import F
from ces_data.config_file import packaged_text, read_yaml_mapping
from ces_identify.options import DELAY, STARTS, TERMS, THREADS, TIME, build_identify_options, structure_option
from ces_identify.structures.kit import IdentifyOptions
from ces_iterate.commands import RigCommands
from ces_iterate.errors import IterateError
from ces_observer.fields import REQUIRED, require_known_keys
from ces_observer.records import choice, declare, quantity, read_record
from ces_observer.structures import STRUCTURES

TOLERANCE = 1e-4  # relative, and in amperes: rounding of the file's digits


@dataclass(frozen=True)
class HeatLimits:
    """How much dissipated power the damper stands.

    The load is the dissipated power [W] behind a first-order low-pass of `memory_s`, the time constant with which the
    damper cools; it is proportional to the rise of temperature of a body of one heat capacity. Before there is a model,
    the dissipated power is bounded by `force_N` times the speed. With 0, `power_W` sets no limit.
    """

    power_W: float = quantity(0.0, "W", "largest load; 0: no limit", 0.0, 1e5)
    memory_s: float = quantity(120.0, "s", "time constant of cooling", 1.0, 1e5)
    force_N: float = quantity(1500.0, "N", "RMS force to expect before there is a model", 1.0, 1e6)

    def load_after(self, load_W: float, power_W: F, interval_s: float) -> F:
        """Return the load [W] (n,) after each `interval_s` of dissipated power (n,), from a load at the start."""
        decay = exp(-interval_s / self.memory_s)
        n = np.arange(1, len(power_W) + 1)
        return np.asarray(load_W * decay**n + lfilter([1.0 - decay], [1.0, -decay], power_W))

    def cool_down_s(self, load_W: float, wanted_W: float) -> float:
        """Return the rest [s] in which a load falls to `wanted_W`; 0 if it is not above."""
        return self.memory_s * float(np.log(load_W / wanted_W)) if load_W > wanted_W > 0.0 else 0.0


@dataclass(frozen=True)
class RigLimits:
    """The box that no experiment leaves. Strokes are measured from mid-stroke, `centre_m` on the rig's own scale."""

    stroke_m: float = quantity(REQUIRED, "m", "largest distance from centre_m", 0.0, 0.5, above=True)
    speed_m_s: float = quantity(REQUIRED, "m/s", "largest speed", 0.0, 20.0, above=True)
    acceleration_m_s2: float = quantity(REQUIRED, "m/s²", "largest acceleration", 0.0, 1e4, above=True)
    low_A: float = quantity(REQUIRED, "A", "lowest current", 0.0, 100.0)
    high_A: float = quantity(REQUIRED, "A", "highest current", 0.0, 100.0)
    frequency_Hz: float = quantity(15.0, "Hz", "highest frequency that the actuator follows", 0.5, 100.0)
    hold_s: float = quantity(0.03, "s", "shortest time between two steps of the current", 1e-3, 10.0)
    centre_m: float = quantity(0.0, "m", "position around which the strokes are designed", -1.0, 1.0)
    heat: HeatLimits = field(default_factory=HeatLimits)

    def __post_init__(self) -> None:
        if self.high_A < self.low_A:
            raise IterateError(f"high_A {self.high_A:g} is below low_A {self.low_A:g}; exchange them")

    def excess(self, commands: RigCommands) -> Iterator[str]:
        """Yield a phrase for each limit that the commands do not keep; heat is checked by the loop."""
        speed, acceleration = commands.motion()
        peaks = {
            "stroke": (np.abs(commands.stroke_m - self.centre_m).max(), self.stroke_m, "m"),
            "speed": (np.abs(speed).max(), self.speed_m_s, "m/s"),
            "acceleration": (np.abs(acceleration).max(), self.acceleration_m_s2, "m/s²"),
        }
        for name, (peak, limit, unit) in peaks.items():
            if peak > limit * (1.0 + TOLERANCE):
                yield f"{name} {peak:.4g} {unit} exceeds {limit:g} {unit}"
        low, high = commands.current_A.min(), commands.current_A.max()
        if low < self.low_A - TOLERANCE or high > self.high_A + TOLERANCE:
            yield f"current {low:.4g} to {high:.4g} A leaves {self.low_A:g} to {self.high_A:g} A"

    def require_within(self, commands: RigCommands) -> RigCommands:
        """Return the commands; raises IterateError if they leave the limits. Every rig gets only what passed here."""
        found = "; ".join(self.excess(commands))
        if found:
            raise IterateError(f"{commands.name}: {found}; change the experiment or the plan's limits")
        return commands


DESIGNED, REPEATED = "designed", "repeated"


@dataclass(frozen=True)
class ExperimentPlan:
    """How the experiments come about."""

    kind: str = choice(DESIGNED, "whether each experiment is designed anew, or one is repeated", (DESIGNED, REPEATED))
    duration_s: float = quantity(15.0, "s", "length of an experiment", 3.0, 600.0)
    commands: str = ""

    def __post_init__(self) -> None:
        if self.commands and self.kind != REPEATED:
            raise IterateError(f"'commands' needs kind: {REPEATED}; remove it or repeat it")


@dataclass(frozen=True)
class StopRules:
    """When to stop; the first rule that applies ends the iteration."""

    budget_s: float = quantity(60.0, "s", "recorded seconds to spend in all", 1.0, 1e5)
    target_J: float = quantity(0.0, "%", "cost on a recording that the model has not seen; 0: none", 0.0, 100.0)
    max_iterations: int = quantity(20, "1", "most experiments", 1, 1000)
    fall: float = quantity(0.02, "1", "repeated: smallest relative fall of the cost that goes on", 0.0, 1.0)


@dataclass(frozen=True)
class IdentifyPlan:
    """How a model is identified from all recordings, as the options of `ces identify`."""

    structure: str = declare(structure_option())
    time: float = declare(replace(TIME, low=0.5, high=1e5))
    starts: int = declare(replace(STARTS, default=4))
    terms: int = declare(replace(TERMS, default=25))
    threads: int = declare(replace(THREADS, default=2))
    delay: float = declare(DELAY)

    def options(self, seed: int) -> IdentifyOptions:
        """Return the options of an identification on the whole of all recordings."""
        return build_identify_options({**vars(self), "seed": seed, "split": 1.0})


@dataclass(frozen=True)
class PlanSettings:
    """What a plan says besides its rig: `recordings` exist and are identified first, `validate` are only scored."""

    limits: RigLimits
    seed: int = quantity(1, "1", "seed of all random numbers", 0, 2**31)
    experiments: ExperimentPlan = field(default_factory=ExperimentPlan)
    stop: StopRules = field(default_factory=StopRules)
    identify: IdentifyPlan = field(default_factory=IdentifyPlan)
    recordings: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Plan(PlanSettings):
    """An iteration: `rig` is the description of the rig, checked by `ces_iterate.rigs.kinds`.

    Paths are relative to `folder`.
    """

    source: str
    folder: Path
    rig: Mapping[str, Any]

    def path(self, text: str) -> Path:
        """Return a path of the plan, relative to the plan's folder."""
        return self.folder / Path(text).expanduser()


KEYS = ("seed", "limits", "experiments", "stop", "identify", "rig", "recordings", "validate")


def load_plan(path: Path) -> Plan:
    """Return the plan of a file; raises IterateError of one line that names the file and the key."""
    content = read_yaml_mapping(path, "a plan for ces iterate; ces iterate --template prints one", error=IterateError)
    return parse_plan(content, str(path), path.parent)


def parse_plan(content: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping, as `load_plan`."""
    require_known_keys(content, KEYS, source, IterateError)
    for key in ("limits", "rig"):
        if not isinstance(content.get(key), Mapping):
            raise IterateError(f"{source}: '{key}' is missing or not a mapping; ces iterate --template shows it")
    without_rig = {key: value for key, value in content.items() if key != "rig"}
    settings = read_record(PlanSettings, without_rig, source, IterateError)
    return Plan(**vars(settings), source=source, folder=folder, rig=content["rig"])


OFFERED = ", ".join(one.option for one in STRUCTURES.values() if one.is_offered)
TEMPLATE = packaged_text("ces_iterate", "template.yaml").replace("STRUCTURES", OFFERED)
