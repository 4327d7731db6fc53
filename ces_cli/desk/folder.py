"""The served folder: texts from a URL go in, paths inside it come out; what it holds by name and content; uploads."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from html import unescape
from itertools import islice
from pathlib import Path, PurePosixPath
from secrets import token_hex
from typing import IO, Any

from ces_data.bags.find import FILES
from ces_data.log_formats import KINDS
from ces_observer.errors import CesError

RECORDING, MODEL, REPORT = "recording", "model", "report"
SUFFIXES = dict.fromkeys({*KINDS, *FILES}, RECORDING) | {".json": MODEL, ".html": REPORT}
METADATA = "metadata.yaml"  # of a bag
RESULTS = {"results.csv": "campaign", "fleet.csv": "fleet"}
OURS = {"characteristics.html", "gap.json", *RESULTS}  # beside them stand tables, no logs
MAX_PATH, MAX_NAME = 1024, 120  # letters of a path in a URL, and of an uploaded file
MAX_DEPTH, MAX_FILES, MAX_ITEMS = 12, 100_000, 500
MAX_JSON_BYTES, HEAD_BYTES = 8_000_000, 4096
WRONG_CONTENT = (ValueError, TypeError, KeyError, AttributeError, ArithmeticError, RecursionError)
MIN_FREE_BYTES = 1 << 28  # that an upload leaves on the disk
GENERATOR = b'content="ces_observer'  # of our pages, in their heads
TITLE = re.compile(rb"<title>(.*?)</title>", re.DOTALL)
MODEL_HEAD = re.compile(rb'\s*\{\s*"schema"\s*:\s*"ces-model/')


class RefusedError(CesError):
    """What a browser asked for and does not get, with the status that says so."""

    def __init__(self, text: str, status: int = 404) -> None:
        super().__init__(text)
        self.status = status


@dataclass(frozen=True)
class Item:
    """A recording, model or report at `path` (relative, with /) and what it says; `is_wrong`: why it cannot be read."""

    kind: str
    path: str
    changed: str
    text: str
    is_wrong: bool


class ServedFolder:
    """The folder; raises CesError if it is not one."""

    def __init__(self, path: Path) -> None:
        if not path.is_dir():
            raise CesError(f"{path}: {'is not a' if path.exists() else 'no such'} folder; expected one to work in")
        self.root = path.resolve()

    def find(self, relative: str) -> Path:
        """Return a path below the folder; raises RefusedError if hidden, outside (links followed) or not there."""
        parts = PurePosixPath(relative).parts
        odd = not 0 < len(relative) <= MAX_PATH or "\0" in relative or "\\" in relative
        if odd or any(part.startswith((".", "/")) for part in parts):
            raise RefusedError("not a path in this folder")
        real = Path(os.path.realpath(self.root.joinpath(*parts)))
        if not real.is_relative_to(self.root) or not real.exists():
            raise RefusedError(f"{relative}: not in this folder")
        return real

    def items(self) -> list[Item]:
        """Return the newest things of each kind in the folder and below it, the newest first."""
        found: dict[str, list[tuple[float, Path]]] = {RECORDING: [], MODEL: [], REPORT: []}
        for kind, path in self._walk():
            with suppress(OSError):  # a link to nowhere
                found[kind].append((path.stat().st_mtime, path))
        items: list[Item] = []
        for kind, paths in found.items():
            made = (self._describe(kind, path, time) for time, path in sorted(paths, reverse=True))
            items += islice(filter(None, made), MAX_ITEMS)
        return items

    def _walk(self) -> Iterator[tuple[str, Path]]:
        """Yield kind and path of what may be shown; links to folders are not followed, nor what is too deep."""
        count = 0
        for folder, folders, files in os.walk(self.root):
            here, count, ours = Path(folder), count + len(files), OURS.intersection(files)
            if METADATA in files and here != self.root:
                folders.clear()
                yield RECORDING, here
                continue
            is_end = len(here.relative_to(self.root).parts) >= MAX_DEPTH or count > MAX_FILES
            folders[:] = [name for name in folders if _is_shown(name) and not is_end]
            for name in filter(_is_shown, files):
                kind = REPORT if name in RESULTS else SUFFIXES.get(Path(name).suffix.lower(), "")
                if kind and not (kind == RECORDING and ours):
                    yield kind, here / name

    def _describe(self, kind: str, path: Path, time_s: float) -> Item | None:
        """Return what a file or bag is; None for what other programs wrote, and for links that leave the folder."""
        changed = f"{datetime.fromtimestamp(min(max(time_s, 0), 4e9)):%F %R}"
        if not Path(os.path.realpath(path)).is_relative_to(self.root) or not (path.is_dir() or path.is_file()):
            return None  # opening a pipe would wait
        try:
            text, is_wrong = DESCRIBE[kind](path), False
        except (CesError, OSError, *WRONG_CONTENT) as error:
            text, is_wrong = f"cannot be read: {error}", True
        return Item(kind, path.relative_to(self.root).as_posix(), changed, text, is_wrong) if text else None

    def receive(self, name: str, size: int | None, stream: IO[bytes]) -> str:
        """Write an uploaded file beside and rename it; returns its name. Raises RefusedError, and never replaces."""
        name = re.sub(r"[^\w .,+()=-]", "_", PurePosixPath(name.replace("\\", "/")).name)[-MAX_NAME:].lstrip(" .-_")
        if SUFFIXES.get(Path(name).suffix.lower(), REPORT) == REPORT:
            raise RefusedError(f"'{name}' is no recording, log or model by its name", 415)
        if size is None or size > shutil.disk_usage(self.root).free - MIN_FREE_BYTES:
            raise RefusedError(f"{name}: there is no room for it on this disk", 413)
        part = self.root / f".upload-{token_hex(8)}"
        try:
            with part.open("xb") as file:
                shutil.copyfileobj(stream, file, 1 << 20)
                if file.tell() != size:
                    raise RefusedError(f"{name}: {file.tell()} of {size} bytes arrived; send it again", 400)
            (self.root / name).touch(exist_ok=False)
            part.replace(self.root / name)
        except FileExistsError:
            raise RefusedError(f"{name} exists; rename the new file, or remove the old one", 409) from None
        finally:
            part.unlink(missing_ok=True)
        return name


def _is_shown(name: str) -> bool:
    return not name.startswith(".") and name.isprintable() and "\\" not in name  # has an address


def _describe_size(path: Path) -> str:
    size = sum(file.stat().st_size for file in (path.iterdir() if path.is_dir() else [path]))
    return f"{1e-6 * size:.1f} MB"


def _describe_model(path: Path) -> str:
    """Return structure and cost of a model, with the recordings that it was tested on: other costs do not compare."""
    if not MODEL_HEAD.match(_read_head(path)):
        return ""
    model = _read_object(path)
    structure, known = str(model["structure"]).removesuffix("_narx"), model.get("provenance") or {}
    tested = [one for one in known.get("cost_J_percent") or () if one["role"] == "validation" and one["J"] is not None]
    on = ", ".join(dict.fromkeys(str(one["recording"]) for one in tested))
    cost = f"J {sum(one['J'] for one in tested) / len(tested):.2f} % on {on}" if tested else "not tested"
    return f"{structure}, {cost}"


def _describe_page(path: Path) -> str:
    """Return the title of a page of ours, or the sentence of the diagnosis that it shows; '' for other pages."""
    head, gap = _read_head(path), path.with_name("gap.json")
    if path.name in RESULTS or GENERATOR not in head:
        return RESULTS.get(path.name, "")
    if path.name == "report.html" and gap.is_file():
        return str(_read_object(gap)["sentence"])
    title = TITLE.search(head)
    return unescape(title[1].decode("utf-8", "replace")).strip() if title else path.name


def _read_head(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(HEAD_BYTES)


def _read_object(path: Path) -> Any:
    if path.stat().st_size > MAX_JSON_BYTES:
        raise CesError(f"larger than {MAX_JSON_BYTES // 1_000_000} MB")
    return json.loads(path.read_bytes())


DESCRIBE = {RECORDING: _describe_size, MODEL: _describe_model, REPORT: _describe_page}
