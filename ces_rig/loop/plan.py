"""The plan of `ces iterate`: a YAML file goes in, checked limits, stopping rules and settings come out.

Every section is a frozen dataclass, checked once; `TEMPLATE` is a plan with every key explained.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ces_data.config_file import packaged_text, read_yaml_mapping
from ces_identify.options import DELAY, STARTS, TERMS, THREADS, TIME, IdentifyRequest, structure_option
from ces_observer.records import choice, declare, in_files, part, quantity, read_record
from ces_observer.structures import STRUCTURES
from ces_rig.errors import RigError
from ces_rig.experiments.commands import RigLimits

SHOWN = "ces iterate --template shows it"
DESIGNED, REPEATED = "designed", "repeated"


@dataclass(frozen=True)
class ExperimentPlan:
    """How the experiments come about."""

    kind: str = choice(DESIGNED, "whether each experiment is designed anew, or one is repeated", (DESIGNED, REPEATED))
    duration_s: float = quantity(15.0, "s", "length of an experiment", 3.0, 600.0)
    commands: str = ""

    def __post_init__(self) -> None:
        if self.commands and self.kind != REPEATED:
            raise RigError(f"'commands' needs kind: {REPEATED}; remove it or repeat it")


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

    def request(self, seed: int) -> IdentifyRequest:
        """Return the request for an identification on the whole of all recordings."""
        return IdentifyRequest(**vars(self), seed=seed, split=1.0)


@dataclass(frozen=True)
class Plan:
    """An iteration: `recordings` exist and are identified first, `validate` are only scored.

    `rig` is the description of the rig, which `ces_rig.loop.rigs` checks. Paths are relative to `folder`.
    """

    limits: RigLimits = part(remedy=SHOWN)
    rig: Mapping[str, Any] = part(remedy=SHOWN)
    seed: int = quantity(1, "1", "seed of all random numbers", 0, 2**31)
    experiments: ExperimentPlan = field(default_factory=ExperimentPlan)
    stop: StopRules = field(default_factory=StopRules)
    identify: IdentifyPlan = field(default_factory=IdentifyPlan)
    recordings: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()
    source: str = field(default="", metadata=in_files(None))
    folder: Path = field(default=Path(), metadata=in_files(None))

    def path(self, text: str) -> Path:
        """Return a path of the plan, relative to the plan's folder."""
        return self.folder / Path(text).expanduser()


def load_plan(path: Path) -> Plan:
    """Return the plan of a file; raises RigError of one line that names the file and the key."""
    content = read_yaml_mapping(path, "a plan for ces iterate; ces iterate --template prints one", error=RigError)
    return parse_plan(content, str(path), path.parent)


def parse_plan(content: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping, as `load_plan`."""
    return replace(read_record(Plan, content, source, RigError), source=source, folder=folder)


OFFERED = ", ".join(one.option for one in STRUCTURES.values() if one.is_offered)
TEMPLATE = packaged_text("ces_rig.loop", "template.yaml").replace("STRUCTURES", OFFERED)
