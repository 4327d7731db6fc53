"""The plan of an iteration, from its YAML file: every section is a frozen dataclass, checked once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ces_identify.config_file import read_yaml_mapping, require_known_keys
from ces_identify.polynomial.search_limits import Limits
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO
from ces_identify.structures.kit import IdentifyOptions
from ces_iterate.errors import IterateError
from ces_iterate.plan.limits import RigLimits
from ces_rig.descriptions import build, choice, quantity

DESIGNED, REPEATED = "designed", "repeated"


@dataclass(frozen=True)
class ExperimentPlan:
    """How the experiments come about."""

    kind: str = choice(DESIGNED, "whether each experiment is designed anew, or one is repeated", (DESIGNED, REPEATED))
    duration_s: float = quantity(15.0, "s", "length of an experiment", 3.0, 600.0)
    commands: str = ""


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

    structure: str = choice(next(iter(KITS)), "structure of the model", (*KITS, AUTO))
    time_s: float = quantity(60.0, "s", "most seconds of a search", 0.5, 1e5)
    starts: int = quantity(4, "1", "random starts", 1, 10000)
    terms: int = quantity(25, "1", "most terms of a polynomial", 1, 200)
    threads: int = quantity(2, "1", "threads of the search", 1, 256)

    def options(self, seed: int) -> IdentifyOptions:
        """Return the options of an identification on the whole of all recordings."""
        limits = Limits(self.terms, self.time_s, 0.0, self.starts, seed, self.threads)
        return IdentifyOptions(split=1.0, limits=limits)


@dataclass(frozen=True)
class Plan:
    """An iteration: `rig` is the description of the rig, checked by `ces_iterate.rigs.kinds`.

    `recordings` exist already and are identified first; `validate` are only judged. Paths are relative to `folder`.
    """

    source: str
    folder: Path
    limits: RigLimits
    rig: Mapping[str, Any]
    seed: int = quantity(1, "1", "seed of all random numbers", 0, 2**31)
    experiments: ExperimentPlan = field(default_factory=ExperimentPlan)
    stop: StopRules = field(default_factory=StopRules)
    identify: IdentifyPlan = field(default_factory=IdentifyPlan)
    recordings: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()

    def path(self, text: str) -> Path:
        """Return a path of the plan, relative to the plan's folder."""
        return self.folder / Path(text).expanduser()


SECTIONS = {"limits": RigLimits, "experiments": ExperimentPlan, "stop": StopRules, "identify": IdentifyPlan}
KEYS = ("seed", *SECTIONS, "rig", "recordings", "validate")


def load_plan(path: Path) -> Plan:
    """Return the plan of a file; raises a CesError of one line that names the file and the key."""
    content = read_yaml_mapping(path, "a plan for ces iterate; ces iterate --template prints one", error=IterateError)
    return parse_plan(content, str(path), path.parent)


def parse_plan(content: Mapping[str, Any], source: str, folder: Path) -> Plan:
    """Return the plan of a mapping, as `load_plan`."""
    require_known_keys(content, KEYS, source, IterateError)
    for key in ("limits", "rig"):
        if not isinstance(content.get(key), Mapping):
            raise IterateError(f"{source}: '{key}' is missing or not a mapping; ces iterate --template shows it")
    sections: dict[str, Any] = {
        key: _build(section, content[key], f"{source}: {key}") for key, section in SECTIONS.items() if key in content
    }
    simple = _build(SimpleSettings, {key: content[key] for key in SIMPLE if key in content}, source)
    plan = Plan(source, folder, rig=content["rig"], **sections, **{key: getattr(simple, key) for key in SIMPLE})
    if plan.experiments.commands and plan.experiments.kind != REPEATED:
        raise IterateError(f"{source}: experiments: 'commands' needs kind: {REPEATED}; remove it or repeat it")
    return plan


@dataclass(frozen=True)
class SimpleSettings:
    """The values of a plan that are in no section."""

    seed: int = quantity(1, "1", "seed of all random numbers", 0, 2**31)
    recordings: tuple[str, ...] = ()
    validate: tuple[str, ...] = ()


SIMPLE = ("seed", "recordings", "validate")


def _build(section: type[Any], values: Any, where: str) -> Any:
    try:
        return build(section, values, where)
    except IterateError as error:
        raise IterateError(f"{where}: {error}") from None
