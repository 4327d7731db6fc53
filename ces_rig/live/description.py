"""The damper of a live rig: read from a rig description, with withheld effects added by name and numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ces_identify.config_file import parse_yaml_mapping, read_yaml_mapping, require_known_keys
from ces_rig.dampers.effects import WithheldEffect
from ces_rig.dampers.hydraulic.effects import Hydraulic
from ces_rig.dampers.hydraulic.parameters import Damper, parse_damper
from ces_rig.dampers.hydraulic.stepper import rest_force
from ces_rig.dampers.kinds import HYDRAULIC, KINDS, DamperModel, read_lumped
from ces_rig.errors import RigError
from ces_rig.experiment import Experiment, parse_experiment
from ces_rig.sensors import Sensors
from ces_rig.withheld import plants, sensing, surroundings

LIVE_SENSING = ("current_scale", "force_offset", "force_drift", "force_scale", "mains_hum", "position_wave")


@dataclass(frozen=True)
class DamperDescription:
    """A damper of a kind (`dampers.kinds.KINDS`), its sensors, and the load cell's reading at mid-stroke [N]."""

    kind: str = HYDRAULIC
    model: DamperModel = field(default_factory=lambda: Hydraulic(Damper()))
    sensors: Sensors = field(default_factory=Sensors)
    rest_N: float = 0.0
    sensor_effects: tuple[tuple[str, Mapping[str, float]], ...] = ()  # names and physical numbers


def load_description(path: Path) -> DamperDescription:
    """Return the damper in a rig YAML (a damper of any kind, or an experiment); raises RigError."""
    description = read_yaml_mapping(path, "a damper or an experiment", error=RigError)
    lumped = read_lumped(description, str(path))
    if lumped is not None:
        return DamperDescription(lumped.kind, lumped)
    if "stroke" in description:
        return describe_experiment(parse_experiment(description, str(path), path))
    return DamperDescription(model=Hydraulic(parse_damper(description, str(path))))


def describe_experiment(experiment: Experiment) -> DamperDescription:
    """Return the damper and sensors of an experiment."""
    rest = 0.0 if experiment.settings.tare else rest_force(experiment.damper)
    return DamperDescription(model=Hydraulic(experiment.damper), sensors=experiment.sensors, rest_N=rest)


def with_effects(damper: DamperDescription, effects: Iterable[str]) -> DamperDescription:
    """Return the damper with effects, each written as `name` or `name: {severity: s, proportion: p, …}`.

    Raises RigError for an unknown effect and for one that this damper or a live rig cannot have.
    """
    for effect in (parse_effect(text, damper.kind) for text in effects):
        if effect.name in sensing.SENSING:
            numbers = sensing.numbers(effect, damper.model.current_A[1])
            damper = replace(damper, sensor_effects=(*damper.sensor_effects, (effect.name, numbers)))
        else:
            changed = damper.model.with_numbers(KINDS[damper.kind].numbers(damper.model, effect))
            damper = replace(damper, model=changed)
    return damper


def parse_effect(text: str, kind: str) -> WithheldEffect:
    """Return the effect of a line of YAML; severity is 1 and each proportion mid-range by default."""
    name, numbers = _parse_text(text)
    known = _available_effects(kind)
    if name not in known:
        raise RigError(
            f"withheld '{text}': no effect '{name}' on a live {kind} damper; expected one of {', '.join(known)}"
        )
    spreads = plants.list_spreads(kind)[name]
    require_known_keys(numbers, ("severity", *spreads), f"withheld '{text}'", RigError)
    severity = numbers.pop("severity", 1.0)
    return WithheldEffect(name, severity, {**{key: spread.middle for key, spread in spreads.items()}, **numbers})


def _available_effects(kind: str) -> Sequence[str]:
    """Return the effects that work tick by tick: none in sensors with memory or around the damper, and no foam in
    the CES damper."""
    excluded = {*sensing.SENSING, *surroundings.SPREADS} - {*LIVE_SENSING} | (
        {"foaming"} if kind == HYDRAULIC else set()
    )
    return [name for name in plants.available_effects(kind) if name not in excluded]


def _parse_text(text: str) -> tuple[str, dict[str, float]]:
    if text.strip().isidentifier():
        return text.strip(), {}
    try:
        ((name, numbers),) = parse_yaml_mapping(text, "withheld", "an effect", error=RigError).items()
        return str(name), {str(key): float(number) for key, number in numbers.items()}
    except (RigError, AttributeError, TypeError, ValueError):
        raise RigError(f"withheld '{text}': expected a name, or for example 'friction: {{severity: 0.5}}'") from None
