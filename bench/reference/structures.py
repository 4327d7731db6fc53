"""The page of model structures, from their kits."""

from __future__ import annotations

import sys
from typing import Any

from bench.reference.tables import code, codes, table
from ces_identify.structures import KITS
from ces_identify.structures.kit import StructureKit
from ces_observer.proof.certificate import ENERGY_CLAIM
from ces_observer.records import Record

HEAD = """
What `ces identify --structure NAME` fits; `auto` compares several. [Model structures](../structures.md) says
when to choose which, [what is proved](../proof.md) what a proof means.
"""


def structures_page() -> str:
    """Return the page."""
    rows = [
        (
            code(name),
            kit.about,
            codes(size.flag for size in kit.sizes),
            codes(Record(kit.body).keys({})),
            "go on straight, up to a stated reach" if kit.body.extrapolates else "clamped",
        )
        for name, kit in KITS.items()
    ]
    heading = (
        "structure",
        "what it is",
        "[sizes](programs.md#identify)",
        "keys in `model.json`",
        "inputs outside the envelope",
    )
    proofs = table(("structure", "what is proved", "how"), ((code(name), *_proof(kit)) for name, kit in KITS.items()))
    return "\n".join(["# Structures", HEAD, table(heading, rows), proofs])


def _proof(kit: StructureKit[Any]) -> tuple[str, str]:
    module = vars(sys.modules[kit.body.__module__])
    return module.get("CLAIM", ENERGY_CLAIM), module["METHOD"]
