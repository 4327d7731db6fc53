"""The kinds of damper: each is a package beside this file and an entry in `KINDS`.

A new kind needs parameters (a `LumpedDamper` if its description is flat), a kernel, its `KIND` and an entry here;
simulations, blind cases and the live rig then support it. `ces_cli.blind.program.DEFAULT_PLANTS` names those that blind
cases use without `--plants`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ces_observer.records import read_record
from ces_rig.dampers import bouc_wen, hydraulic, lookup
from ces_rig.dampers.hydraulic.parameters import Hydraulic, parse_damper
from ces_rig.dampers.model import DamperKind, DamperModel, LumpedDamper
from ces_rig.errors import RigError

HYDRAULIC = Hydraulic.kind
KINDS: Mapping[str, DamperKind] = {m.KIND.design.kind: m.KIND for m in (hydraulic, bouc_wen, lookup)}
LUMPED: Mapping[str, type[LumpedDamper]] = {
    name: type(kind.design) for name, kind in KINDS.items() if isinstance(kind.design, LumpedDamper)
}


def parse_model(description: Mapping[str, Any], where: str) -> DamperModel:
    """Return the damper of a description of any kind; raises RigError for an unknown kind or a number out of range."""
    kind = description.get("kind", HYDRAULIC)
    values = {key: value for key, value in description.items() if key != "kind"}
    if kind in LUMPED:
        return read_record(LUMPED[kind], values, where, RigError)
    if kind != HYDRAULIC:
        raise RigError(f"{where}: kind is {kind!r}; expected one of {', '.join(KINDS)}")
    return Hydraulic(parse_damper(values, where))
