"""One thing that the folder holds: its kind, place and facts, by its file's name and first bytes, read bounded.

Costs are in percent, forces in N, lengths in m. A function of facts raises UnreadableError, or one of WRONG_CONTENT for
a file whose values are not those that our programs write.
"""

from __future__ import annotations

import hashlib
import json
import logging
import re
import stat
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from html import unescape
from pathlib import Path
from typing import Any

from ces_observer.errors import CesError
from ces_observer.fields import Field
from ces_observer.model import load_model
from ces_observer.proof.certificate import summarize
from ces_observer.records import some_of
from ces_rig.loop.store import Iteration

MAX_JSON_BYTES, MAX_ROWS_BYTES = 8_000_000, 64_000_000
HEAD_BYTES, METADATA_BYTES = 4096, 200_000

Facts = dict[str, Any]  # also a JSON object
ItemReader = Callable[[Path], tuple[str, Facts] | None]  # None for files of other programs
WRONG_CONTENT = (KeyError, TypeError, ValueError, AttributeError, IndexError, ArithmeticError)
MODEL, REPORT, RESULT, RECORDING, UNREADABLE = "model", "report", "result", "recording", "unreadable"
KINDS = {  # by kind: the heading of its page, one, several, and the columns of its list: key of the fact, heading, form
    MODEL: ("Models", "model", "models", "structure,structure; size,size; cost_J,J % validation,.2f; "
            "recordings,identified on; stability,stability"),
    RESULT: ("Results", "result", "results", "what,kind; summary,says"),
    REPORT: ("Reports", "report", "reports", "summary,title"),
    RECORDING: ("Recordings", "recording", "recordings", "seconds,s,.1f; messages,messages,d; MB,MB,.1f"),
    UNREADABLE: ("Unreadable", "unreadable file", "unreadable files", "summary,says"),
    "": ("Overview", "thing", "things", "what,kind; summary,says"),
}  # fmt: skip
HASHED = re.compile(r"[0-9a-f]{16,}\.json")
DONE = "done"
TITLE = re.compile(rb"<title>(.*?)</title>", re.DOTALL)
METADATA = {
    "seconds": (re.compile(rb"duration:\s*\n\s*nanoseconds:\s*(\d+)"), 1e-9),
    "messages": (re.compile(rb"\n  message_count:\s*(\d+)"), 1),
}
SCHEMA = re.compile(rb'"schema"\s*:\s*"(ces-[a-z-]+)/\d+"')
GENERATOR = b'content="ces_observer'  # of our pages, in their heads
OUR_NAMES = {"model.json", "gap.json", "augmented.json"}
MEMBER = "ensemble_"  # models by which `ces iterate` measures disagreement


class UnreadableError(CesError):
    """A file of ours that cannot be read; the message says why, without the path."""


@dataclass(frozen=True)
class Item:
    """A thing at `path` (relative, with /), changed at `modified_s` (Unix time); `problem` is why it cannot be read."""

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
    def home(self) -> str:
        """Its path, or that of its folder if it is a folder of results."""
        return self.folder if self.folder and self.kind == RESULT else self.path

    @property
    def name(self) -> str:
        """The last part of that path."""
        return self.home.rpartition("/")[2]

    @property
    def label(self) -> str:
        """Its name, shortened if that is a hash, as of a campaign's models."""
        return f"{self.name[:8]}…" if HASHED.fullmatch(self.name) else self.name

    @property
    def summary(self) -> str:
        """What it says in one line."""
        return self.problem or str(self.facts.get("summary", ""))

    @property
    def changed(self) -> str:
        """The local time of its last change to the minute, a dash if no calendar has it (a file may carry any time)."""
        try:
            return f"{datetime.fromtimestamp(self.modified_s):%Y-%m-%d %H:%M}"
        except (ValueError, OverflowError, OSError):
            return "–"


def list_facts(kind: str, item: Item) -> list[tuple[str, str, bool]]:
    """Return heading, text, and whether it is a number, of a thing's facts in the list of a kind (empty: of all)."""
    facts = {"what": KINDS[item.kind][1], **item.facts, "summary": item.summary}
    out = []
    for key, heading, *form in (column.strip().split(",") for column in KINDS[kind][3].split(";")):
        value = facts.get(key)
        text = "–" if value is None else ", ".join(map(str, value)) if isinstance(value, list) else str(value)
        out.append((heading, format_number(value, form[0]) if form else text, bool(form)))
    return out


def format_number(value: object, form: str, unit: str = "") -> str:
    """Return a number with its unit as text, a dash for anything else."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return "–"
    return f"{value:{form}}".replace("-", "−") + (f" {unit}" if unit else "")


def find_reader(path: Path) -> ItemReader | None:
    """Return what reads kind and facts of a file, by its name; None for files that are not shown."""
    suffix = path.suffix.lower()
    if path.name in ROW_FACTS:
        return lambda path: (RESULT, ROW_FACTS[path.name](_read_rows(path)))
    if suffix == ".json" and not path.name.startswith(MEMBER):
        return _read_json
    if suffix == ".html":
        return _read_page
    return read_recording if suffix in (".mcap", ".db3") else None


def read_item(read: ItemReader, path: Path, where: str, modified_s: float) -> Item | None:
    """Return the thing that `read` finds in a file, which its list shows at `where`; None for other programs' files."""
    try:
        content = read(path)
        return None if content is None else Item(content[0], where, modified_s, content[1])
    except UnreadableError as error:
        problem = str(error)
    except OSError as error:
        problem = f"cannot be read: {error.strerror or error}"
    except CesError as error:
        problem = str(error).partition(": ")[2] or str(error)  # without the path
    except WRONG_CONTENT as error:
        logging.getLogger(__name__).warning("%s", path, exc_info=error)  # it may be an error of ours
        missing = isinstance(error, KeyError)
        problem = f"no key {error}" if missing else f"not the content that our programs write: {error}"
    return Item(UNREADABLE, where, modified_s, {}, problem)


def read_recording(path: Path) -> tuple[str, Facts]:
    """Return kind and facts of a bag without opening it: a rosbag2 folder, or a bag file."""
    files = [file for file in path.iterdir() if file.is_file()] if path.is_dir() else [path]
    facts: Facts = {"MB": 1e-6 * sum(file.stat().st_size for file in files)}
    if path.is_dir():
        text = _read_head(path / "metadata.yaml", METADATA_BYTES)
        for key, (pattern, scale) in METADATA.items():
            match = pattern.search(text)
            facts[key] = scale * int(match[1]) if match else None
    length = format_number(facts.get("seconds"), ".1f", "s")
    facts["summary"] = ", ".join(text for text in (length, f"{facts['MB']:.1f} MB") if text != "–")
    return RECORDING, facts


def _read_page(path: Path) -> tuple[str, Facts] | None:
    head = _read_head(path)
    title = TITLE.search(head)
    text = unescape(title[1].decode("utf-8", "replace")).strip() if title else path.name
    return (REPORT, {"summary": text}) if GENERATOR in head else None


def _read_json(path: Path) -> tuple[str, Facts] | None:
    head = _read_head(path)
    schema = SCHEMA.search(head)
    if schema is not None:
        read_facts = JSON_FACTS.get(schema[1])
        return None if read_facts is None else read_facts(path)
    if path.name in OUR_NAMES or head.lstrip()[:1] not in (b"{", b"["):
        raise UnreadableError("empty" if not head.strip() else "no schema of ces_observer at its beginning")
    return None


TEXT, COST = Field(kind=str), Field(kind=float, null=None)
RECORDINGS = replace(some_of(recording=TEXT), many=True, null=None, default=())
MODEL_FILE = some_of(
    structure=TEXT,
    certificate=Field(kind=Mapping, null=None),
    sampling=some_of(rate_Hz=Field(kind=float)),
    provenance=some_of(
        cost_J_percent=replace(some_of(recording=TEXT, role=TEXT, J=COST), many=True, null=None, default=()),
        identification=RECORDINGS,
        validation=RECORDINGS,
    ),
)
GAP_FILE = some_of(sentence=TEXT, verdict=TEXT, gap=some_of(rms_N=COST))
CAMPAIGN_ROWS = Field(kind=some_of(status=TEXT, structure=Field(default="")).kind, many=True)
FLEET_ROWS = Field(kind=some_of(status=TEXT, name=TEXT, verdict=Field(default="")).kind, many=True)
"""What is shown of each kind of file; the rest is left unread."""


def _model_facts(path: Path) -> tuple[str, Facts]:
    content = _read_object(path)
    model = MODEL_FILE.check({"provenance": {}, **content}, "content", UnreadableError)
    known, certificate = model["provenance"], model["certificate"]

    tested = [cost for cost in known["cost_J_percent"] or () if cost["role"] == "validation"]
    costs = [cost["J"] for cost in tested if cost["J"] is not None]
    structure = model["structure"].removesuffix("_narx")
    # a polynomial's size without the proof of its bounds, which takes milliseconds
    size = f"{len(content['terms'])} terms" if structure == "polynomial" else load_model(path).size
    proof = "not proved" if certificate is None else summarize(certificate)
    return MODEL, {
        "structure": structure,
        "size": size,
        "summary": f"{structure}, {size}",
        "cost_J": sum(costs) / len(costs) if costs else None,
        "tests": _describe_tests({cost["recording"] for cost in tested}, content["provenance"] if tested else {}),
        "rate_Hz": model["sampling"]["rate_Hz"],
        "recordings": [one["recording"] for one in known["identification"] or ()],
        "validation": [one["recording"] for one in known["validation"] or ()],
        "certificate": proof,
        "stability": proof.partition(":")[0],
    }


def _describe_tests(names: set[str], provenance: Facts) -> str:
    """Return the recordings of a model's costs, with a hash of their content, '' if it was tested on none."""
    validation, identified = (provenance.get(role) or [] for role in ("validation", "identification"))
    parts = [one for one in identified if one["recording"] in names]  # the rest of which is the test
    content = sorted(f"{one.get('sha256')} {one.get('share') if one in parts else ''}" for one in [*validation, *parts])
    digest = hashlib.sha256("\n".join(content).encode()).hexdigest()[:8]
    return f"{', '.join(sorted(names))} (sha256 {digest}…)" if names else ""


def _diagnosis_facts(path: Path) -> tuple[str, Facts]:
    diagnosis = GAP_FILE.check(_read_object(path), "content", UnreadableError)
    return RESULT, {
        "what": "diagnosis",
        "summary": diagnosis["sentence"],
        "verdict": diagnosis["verdict"].replace("_", " "),
        "gap N": diagnosis["gap"]["rms_N"],
    }


def _campaign_facts(content: list[Facts]) -> Facts:
    rows = CAMPAIGN_ROWS.check(content, "line", UnreadableError)
    done = [row for row in rows if row["status"] == DONE]
    counts = f"{len(done)} models" + (f", {len(rows) - len(done)} failed" if len(done) < len(rows) else "")
    structures = ", ".join(sorted({row["structure"] for row in done}))
    return {"what": "campaign", "summary": f"{counts}: {structures}"}


def _fleet_facts(content: list[Facts]) -> Facts:
    rows = FLEET_ROWS.check(content, "line", UnreadableError)
    verdicts = Counter(row["verdict"].replace("_", " ") for row in rows if row["status"] == DONE)
    counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common()) or "none diagnosed"
    return {"what": "fleet", "summary": f"{len(rows)} units: {counts}", "units": [row["name"] for row in rows]}


def _iteration_facts(content: list[Facts]) -> Facts:
    if not content:
        return {"what": "iteration", "summary": "no iteration finished yet"}
    newest = Iteration.from_row(content[-1], Path("line"))
    cost = "" if newest.fresh_J is None else f", J {newest.fresh_J:.2f} % on the last fresh recording"
    recorded = f"{len(content)} iterations, {newest.total_s:.0f} s recorded"
    return {"what": "iteration", "summary": recorded + cost}


JSON_FACTS: dict[bytes, Callable[[Path], tuple[str, Facts]]] = {
    b"ces-model": _model_facts,
    b"ces-gap": _diagnosis_facts,
}
ROW_FACTS: dict[str, Callable[[list[Facts]], Facts]] = {
    "results.jsonl": _campaign_facts,
    "fleet.jsonl": _fleet_facts,
    "iterations.jsonl": _iteration_facts,
}


def _read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Return the first bytes of a regular file; raises UnreadableError or OSError."""
    if not stat.S_ISREG(path.stat().st_mode):  # opening a pipe would wait
        raise UnreadableError("not a regular file")
    with path.open("rb") as file:
        return file.read(count)


def _read_object(path: Path) -> Facts:
    """Return the object in a JSON file; raises UnreadableError or OSError."""
    return _parse_object(_read_whole(path, MAX_JSON_BYTES))


def _read_rows(path: Path) -> list[Facts]:
    """Return the rows of a file with one JSON object a line; an incomplete last line is one that is being written."""
    rows = []
    for number, line in enumerate(_read_whole(path, MAX_ROWS_BYTES).rpartition(b"\n")[0].splitlines(), start=1):
        try:
            rows.append(_parse_object(line))
        except UnreadableError as error:
            raise UnreadableError(f"line {number}: {error}") from None
    return rows


def _read_whole(path: Path, max_bytes: int) -> bytes:
    raw = _read_head(path, max_bytes + 1)
    if len(raw) > max_bytes:
        raise UnreadableError(f"larger than {max_bytes // 1_000_000} MB")
    return raw


def _parse_object(raw: bytes) -> Facts:
    try:
        value = json.loads(raw)
    except (ValueError, RecursionError) as error:
        raise UnreadableError(f"not complete JSON: {error}") from None
    if not isinstance(value, dict):
        raise UnreadableError("not a JSON object")
    return value
