"""One thing that the folder holds: its kind, place and facts, by its file's name and first bytes.

Costs are in percent, forces in N, lengths in m. A function of facts raises UnreadableError, or one of WRONG_CONTENT for
a file whose values are not those that our programs write.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from html import unescape
from math import isfinite
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError
from ces_observer.model import load_model
from ces_observer.proof.certificate import summarize
from ces_serve.folder import UnreadableError, read_head, read_json, read_rows

Facts = dict[str, Any]
ItemReader = Callable[[Path], tuple[str, Facts] | None]  # None for files of other programs
WRONG_CONTENT = (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError)
MODEL, REPORT, RESULT, RECORDING, UNREADABLE = "model", "report", "result", "recording", "unreadable"
KINDS = {  # by kind: the heading of its page, one, several, and the columns of its list: key of the fact, heading, form
    MODEL: ("Models", "model", "models", "structure,structure; size,size; cost_J,J % validation,.2f; "
            "fit_J,J % identification,.2f; recordings,identified on; stability,stability"),
    RESULT: ("Results", "result", "results", "what,kind; summary,says; cost_J,J %,.2f"),
    REPORT: ("Reports", "report", "reports", "summary,title"),
    RECORDING: ("Recordings", "recording", "recordings", "seconds,s,.1f; messages,messages,d; MB,MB,.1f"),
    UNREADABLE: ("Unreadable", "unreadable file", "unreadable files", "summary,says"),
    "": ("Overview", "thing", "things", "what,kind; summary,says; cost_J,J %,.2f"),
}  # fmt: skip
HASHED = re.compile(r"[0-9a-f]{16,}\.json")
DONE = "done"
TITLE = re.compile(rb"<title>(.*?)</title>", re.DOTALL)
METADATA = {
    "seconds": (re.compile(rb"duration:\s*\n\s*nanoseconds:\s*(\d+)"), 1e-9),
    "messages": (re.compile(rb"\n  message_count:\s*(\d+)"), 1),
}
METADATA_BYTES = 200_000
BAG_FILES = (".mcap", ".db3")
SCHEMA = re.compile(rb'"schema"\s*:\s*"(ces-[a-z-]+)/\d+"')
GENERATOR, FOOTER = b'content="ces_observer', b"<footer>ces_observer"
OUR_NAMES = {"model.json", "gap.json", "augmented.json"}
MEMBER = "ensemble_"  # models by which `ces iterate` measures disagreement


@dataclass(frozen=True)
class ListColumn:
    """A column of a list: the key of a fact, its heading, and the form of a number (empty: a text)."""

    key: str
    heading: str
    form: str = ""

    def text(self, one: Item) -> str:
        """Return the text of a thing's cell, a dash if it has no such fact."""
        found = {"what": KINDS[one.kind][1], **one.facts, "summary": one.summary}.get(self.key)
        if self.form:
            return format_number(found, self.form)
        return "–" if found is None else ", ".join(map(str, found)) if isinstance(found, list) else str(found)


@dataclass(frozen=True)
class Item:
    """A thing at `path` (relative, with /), last changed at `modified_s` (Unix time).

    `facts` hold what its kind has to say; `problem` is why it cannot be read, empty if it can.
    """

    kind: str
    path: str
    modified_s: float
    facts: Mapping[str, Any] = field(default_factory=dict)
    problem: str = ""

    @property
    def folder(self) -> str:
        """The path without its last part, empty at the top."""
        return self.path.rpartition("/")[0]

    @property
    def name(self) -> str:
        """The last part of its path, or of its folder's path if it is a folder of results."""
        return (self.folder if self.folder and self.kind == RESULT else self.path).rpartition("/")[2]

    @property
    def label(self) -> str:
        """Its name, shortened if that is a hash, as of a campaign's models."""
        return f"{self.name[:8]}…" if HASHED.fullmatch(self.name) else self.name

    @property
    def place(self) -> str:
        """Where its name is, empty at the top."""
        return self.folder.rpartition("/")[0] if self.folder and self.kind == RESULT else self.folder

    @property
    def summary(self) -> str:
        """What it says in one line."""
        return self.problem or str(self.facts.get("summary", ""))

    @property
    def changed(self) -> str:
        """The local time of its last change to the minute, a dash if no calendar has it."""
        return format_time(self.modified_s)

    def matches(self, words: tuple[str, ...]) -> bool:
        """Return whether all words, in lower case, are in its path, kind or facts."""
        text = f"{self.kind} {self.path} {self.summary} {' '.join(map(str, self.facts.values()))}".lower()
        return all(word in text for word in words)


def columns_of(kind: str) -> tuple[ListColumn, ...]:
    """Return the columns after the name, for a list of one kind or, empty, of all."""
    return tuple(ListColumn(*column.strip().split(",")) for column in KINDS[kind][3].split(";"))


def format_time(time_s: float) -> str:
    """Return a local time to the minute, a dash if no calendar has it (a file may carry any time)."""
    try:
        return f"{datetime.fromtimestamp(time_s):%Y-%m-%d %H:%M}"
    except (ValueError, OverflowError, OSError):
        return "–"


def format_number(value: object, form: str, unit: str = "") -> str:
    """Return a number with its unit as text, a dash for anything else."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return "–"
    return f"{value:{form}}".replace("-", "−") + (f" {unit}" if unit else "")


def find_reader(path: Path) -> ItemReader | None:
    """Return what reads kind and facts of a file, by its name; None for files that are not shown."""
    suffix = path.suffix.lower()
    if path.name in ROW_FACTS:
        return lambda path: (RESULT, ROW_FACTS[path.name](read_rows(path)))
    if suffix == ".json" and not path.name.startswith(MEMBER):
        return _read_json
    if suffix == ".html":
        return lambda path: (REPORT, {"summary": _read_title(path)}) if _is_our_page(path) else None
    return read_recording if suffix in BAG_FILES else None


def read_item(read: ItemReader, path: Path, where: str, modified_s: float) -> Item | None:
    """Return the thing that `read` finds in a file, which its list shows at `where`; None for other programs' files."""
    try:
        found = read(path)
        return None if found is None else Item(found[0], where, modified_s, found[1])
    except (CesError, OSError, *WRONG_CONTENT) as error:
        return Item(UNREADABLE, where, modified_s, {}, _explain(error))


def read_recording(path: Path) -> tuple[str, Facts]:
    """Return kind and facts of a bag without opening it: a rosbag2 folder, or a bag file."""
    files = [one for one in path.iterdir() if one.is_file()] if path.is_dir() else [path]
    facts: Facts = {"MB": 1e-6 * sum(one.stat().st_size for one in files)}
    if path.is_dir():
        text = read_head(path / "metadata.yaml", METADATA_BYTES)
        for key, (pattern, scale) in METADATA.items():
            found = pattern.search(text)
            facts[key] = scale * int(found[1]) if found else None
    length = format_number(facts.get("seconds"), ".1f", "s")
    facts["summary"] = ", ".join(text for text in (length, f"{facts['MB']:.1f} MB") if text != "–")
    return RECORDING, facts


def _read_json(path: Path) -> tuple[str, Facts] | None:
    head = read_head(path)
    schema = SCHEMA.search(head)
    if schema is not None:
        known = JSON_FACTS.get(schema[1])
        return None if known is None else known(path)
    if path.name in OUR_NAMES or head.lstrip()[:1] not in (b"{", b"["):
        raise UnreadableError("empty" if not head.strip() else "no schema of ces_observer at its beginning")
    return None


def _model_facts(path: Path) -> tuple[str, Facts]:
    content = read_json(path)
    provenance = content.get("provenance") or {}
    costs = provenance.get("cost_J_percent") or []
    validation, fit = (_mean(c["J"] for c in costs if c["role"] == role) for role in ("validation", "identification"))
    structure, certificate = str(content["structure"]).removesuffix("_narx"), content["certificate"]
    # a polynomial's size without the proof of its bounds, which takes milliseconds
    size = f"{len(content['terms'])} terms" if structure == "polynomial" else load_model(path).size
    return MODEL, {
        "structure": structure,
        "size": size,
        "summary": f"{structure}, {size}",
        "cost_J": validation,
        "fit_J": fit,
        "rate_Hz": float(content["sampling"]["rate_Hz"]),
        "recordings": [str(one["recording"]) for one in provenance.get("identification") or []],
        "validation": [str(one["recording"]) for one in provenance.get("validation") or []],
        "certificate": "not proved" if certificate is None else summarize(certificate),
        "stability": "not proved" if certificate is None else summarize(certificate).partition(":")[0],
    }


def _diagnosis_facts(path: Path) -> tuple[str, Facts]:
    content = read_json(path)
    number(content["composition"]["gap_after_N"])
    return RESULT, {
        "what": "diagnosis",
        "summary": str(content["sentence"]),
        "cost_J": number(content["gap"]["cost_J"]),
        "verdict": str(content["verdict"]).replace("_", " "),
        "gap N": number(content["gap"]["rms_N"]),
    }


def _stroke_facts(path: Path) -> tuple[str, Facts]:
    content = read_json(path)
    first, confirmed = 1e3 * float(content["first_error_m"]), 1e3 * float(content["confirmed_error_m"])
    runs = int(content["iterations"])
    said = f"error {first:.3f} mm before, {confirmed:.3f} mm after {runs} runs; {content['stopped']}"
    return RESULT, {"what": "learned stroke", "summary": said}


def _campaign_facts(rows: list[dict[str, Any]]) -> Facts:
    done = [row for row in rows if row["status"] == DONE]
    costs = [float(row["selection_J"]) for row in done if row["selection_J"] is not None]
    counts = f"{len(done)} models" + (f", {len(rows) - len(done)} failed" if len(done) < len(rows) else "")
    structures = ", ".join(sorted({str(row["structure"]) for row in done}))
    return {"what": "campaign", "summary": f"{counts}: {structures}", "cost_J": min(costs, default=None)}


def _fleet_facts(rows: list[dict[str, Any]]) -> Facts:
    verdicts = Counter(str(row["verdict"]).replace("_", " ") for row in rows if row["status"] == DONE)
    said = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common()) or "none diagnosed"
    return {"what": "fleet", "summary": f"{len(rows)} units: {said}", "units": [str(row["name"]) for row in rows]}


def _iteration_facts(rows: list[dict[str, Any]]) -> Facts:
    if not rows:
        return {"what": "iteration", "summary": "no iteration finished yet"}
    fresh = number(rows[-1]["fresh_J"])
    said = "" if fresh is None else f", J {fresh:.2f} % on the last fresh recording"
    recorded = f"{len(rows)} iterations, {float(rows[-1]['total_s']):.0f} s recorded"
    return {"what": "iteration", "summary": recorded + said, "cost_J": fresh}


JSON_FACTS: dict[bytes, Callable[[Path], tuple[str, Facts]]] = {
    b"ces-model": _model_facts,
    b"ces-gap": _diagnosis_facts,
    b"ces-learned-stroke": _stroke_facts,
}
ROW_FACTS: dict[str, Callable[[list[dict[str, Any]]], Facts]] = {
    "results.jsonl": _campaign_facts,
    "fleet.jsonl": _fleet_facts,
    "iterations.jsonl": _iteration_facts,
}


def number(value: object) -> float | None:
    """Return a finite number, None for null; raises UnreadableError for anything else."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        raise UnreadableError("a value is not a number")
    return float(value)


def _mean(costs: Iterable[Any]) -> float | None:
    values = [value for value in map(number, costs) if value is not None]
    return sum(values) / len(values) if values else None


def _read_title(path: Path) -> str:
    found = TITLE.search(read_head(path))
    return unescape(found[1].decode("utf-8", "replace")).strip() if found else path.name


def _is_our_page(path: Path) -> bool:
    """Return whether a page was written by our programs, by its head or its last lines."""
    if GENERATOR in read_head(path):
        return True
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 2000))
        return FOOTER in file.read(2000) or path.name == "fleet.html"


def _explain(error: Exception) -> str:
    """Return why a file cannot be read, in one line without its path."""
    if isinstance(error, UnreadableError):
        return str(error)
    if isinstance(error, OSError):
        return f"cannot be read: {error.strerror or error}"
    if isinstance(error, CesError):
        return str(error).partition(": ")[2] or str(error)
    return f"no key {error}" if isinstance(error, KeyError) else f"not the content that our programs write: {error}"
