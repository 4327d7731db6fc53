"""The page of model structures, from their kits."""

from __future__ import annotations

from bench.reference.tables import code, codes, table
from ces_identify.structures import KITS
from ces_observer.records import Record

HEAD = """
What `ces identify --structure NAME` fits; `auto` compares several. [Model structures](../structures.md) says
when to choose which, [why a model is stable](../proof.md) what is proved of each.
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
    return "\n".join(["# Structures", HEAD, table(heading, rows)])
