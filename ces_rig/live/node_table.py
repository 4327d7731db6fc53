"""Parameters of the rig node as a table: the fields of its settings with their ranges and descriptions."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from ces_observer.fields import choice, quantity, setting, walk_record
from ces_observer.nodes.parameter_table import EXECUTOR
from ces_observer.options import Option, as_parameter
from ces_rig.live.rig import LIVE, RigSettings
from ces_rig.nested_numbers import replace_numbers


@dataclass(frozen=True)
class RigNodeSettings:
    """The settings that the node adds to those of a live rig; with `publish_clock` it is the source of time."""

    joint: str = setting("rear_damper", "joint name, and frame of all stamps")
    stamped_current: bool = setting(False, "publish the current as JointState (effort[joint], in A) instead of Float64")
    publish_clock: bool = setting(False, "provide simulated time and publish /clock")
    real_time_factor: float = quantity(
        1.0, "1", "with publish_clock: simulated over real time; 0: as fast as the readers allow", 0.0, 1e3
    )
    answer_s: float = quantity(
        0.0, "s", "with real_time_factor 0: longest wait for a command after each sample; 0: none", 0.0, 10.0
    )
    executor: str = choice(str(EXECUTOR.default), EXECUTOR.meaning, EXECUTOR.choices)


def specs(defaults: Any) -> Iterator[Option]:
    """Yield a parameter for each field of a record, nested ones with a dotted name."""
    for name, value, one in walk_record(defaults):
        own = {f.name: getattr(one, f.name) for f in fields(one)} | {"name": name, "default": value}
        yield as_parameter(Option(**own, live=name in LIVE))


OF_THE_NODE, OF_THE_RIG = tuple(specs(RigNodeSettings())), tuple(specs(RigSettings()))


def read_settings(values: Mapping[str, Any]) -> tuple[RigNodeSettings, RigSettings]:
    """Return the settings from values by parameter name; raises RigError for a value out of range."""
    own, rig = ({spec.name: values[spec.name] for spec in table} for table in (OF_THE_NODE, OF_THE_RIG))
    rig["withheld"] = [text for text in rig["withheld"] if text]
    return replace_numbers(RigNodeSettings(), own, "parameters"), replace_numbers(RigSettings(), rig, "parameters")
