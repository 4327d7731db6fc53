"""What a file is, by its name and its first bytes, and the thing in it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from ces_observer.errors import CesError
from ces_serve.files import facts, item
from ces_serve.files.bounded_reading import UnreadableError, read_head
from ces_serve.files.item import Item

BAG_FILES = (".mcap", ".db3")
SCHEMA = re.compile(rb'"schema"\s*:\s*"(ces-[a-z-]+)/\d+"')
GENERATOR = b'content="ces_observer'
FOOTER = b"<footer>ces_observer"
OUR_NAMES = {"model.json", "gap.json", "augmented.json"}
MEMBER = "ensemble_"  # models by which `ces iterate` measures disagreement
JSON = "json"  # of a file whose content says what it is

FactsOf = Callable[[Path], facts.Facts]
JSON_KINDS: dict[bytes, tuple[str, FactsOf]] = {
    b"ces-model": (item.MODEL, facts.model_facts),
    b"ces-gap": (item.DIAGNOSIS, facts.diagnosis_facts),
    b"ces-learned-stroke": (item.STROKE, facts.stroke_facts),
}
ROW_KINDS: dict[str, tuple[str, FactsOf]] = {
    "results.jsonl": (item.CAMPAIGN, facts.campaign_facts),
    "fleet.jsonl": (item.FLEET, facts.fleet_facts),
    "iterations.jsonl": (item.ITERATION, facts.iteration_facts),
}


def find_kind(path: Path) -> tuple[str, Path, Path, FactsOf] | None:
    """Return kind, path, main file and function of facts of a file by its name; None for files that are not shown."""
    if path.name in ROW_KINDS:
        kind, facts_of = ROW_KINDS[path.name]
        return kind, path, path, facts_of
    match path.suffix.lower():
        case ".json" if not path.name.startswith(MEMBER):
            return JSON, path, path, facts.model_facts
        case ".html":
            return item.REPORT, path, path, facts.report_facts
        case suffix if suffix in BAG_FILES:
            return item.RECORDING, path, path, facts.recording_facts
    return None


def read_item(kind: str, path: Path, where: str, modified_s: float, facts_of: FactsOf) -> Item | None:
    """Return the thing in a file, which its list shows at `where`; None for a file of other programs."""
    if kind == JSON:
        return _read_json(path, where, modified_s)
    try:
        if kind == item.REPORT and not _is_our_page(path):
            return None
        return Item(kind, where, modified_s, facts_of(path))
    except (CesError, OSError, *facts.WRONG_CONTENT) as error:
        return Item(item.UNREADABLE, where, modified_s, {"kind": kind}, _explain(kind, error))


def _read_json(path: Path, where: str, modified_s: float) -> Item | None:
    """Return the thing in a JSON file; None for a file of other programs."""
    try:
        head = read_head(path)
    except (CesError, OSError) as error:
        return Item(item.UNREADABLE, where, modified_s, {}, _explain("JSON file", error))
    schema = SCHEMA.search(head)
    if schema is not None:
        known = JSON_KINDS.get(schema[1])
        return None if known is None else read_item(known[0], path, where, modified_s, known[1])
    if path.name in OUR_NAMES or head.lstrip()[:1] not in (b"{", b"["):
        what = "empty" if not head.strip() else "no schema of ces_observer at its beginning"
        return Item(item.UNREADABLE, where, modified_s, {}, what)
    return None


def _is_our_page(path: Path) -> bool:
    """Return whether a page was written by our programs, by its head or its last lines."""
    if GENERATOR in read_head(path):
        return True
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 2000))
        return FOOTER in file.read(2000) or path.name == "fleet.html"


def _explain(kind: str, error: Exception) -> str:
    """Return why a file cannot be read, in one line without its path."""
    if isinstance(error, UnreadableError):
        return str(error)
    if isinstance(error, OSError):
        return f"cannot be read: {error.strerror or error}"
    if isinstance(error, CesError):
        return str(error).partition(": ")[2] or str(error)
    if isinstance(error, KeyError):
        return f"no key {error} where a {kind} has one"
    return f"not the content of a {kind}: {error}"
