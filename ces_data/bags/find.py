"""Which bags words name: bags, folders that hold bags, globs of either, and logs."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ces_data.bags.mcap import require_complete
from ces_data.log_formats import explain_import, is_foreign, is_log
from ces_observer.errors import CesError, RecordingError

FILES = (".mcap", ".db3", ".bag")
PART = re.compile(r"(.+?)(?:_([0-9]+))?\.(?:mcap|db3)(?:\.zstd)?")  # as recorders name the files of a bag
WILD = "*?["
BAGS_EXPECTED = "expected rosbag2 folders, .mcap or .db3 files, folders of them, or a glob"


def find_bags(words: Sequence[str | Path], repeated: bool = False) -> list[Path]:
    """Return the bags that the arguments name, in order; raises CesError for an argument that names none.

    A bag that several arguments name is returned once, or with `repeated` each time. A path that does not exist is
    returned as it is, for the reader's message.
    """
    paths = [path for word in words for path in _match_word(str(word))]
    return paths if repeated else list(dict.fromkeys(paths))


def find_bag(word: str) -> Path:
    """Return the one bag or log that a word names; raises CesError if it names several or none."""
    paths = find_bags([word])
    if len(paths) > 1:
        names = ", ".join(str(path) for path in paths[:3])
        raise CesError(
            f"{word}: names {len(paths)} recordings ({names}{', …' if len(paths) > 3 else ''}); expected one"
        )
    return paths[0]


def _match_word(word: str) -> Iterator[Path]:
    if (folder := Path(word)).is_dir() and not is_bag(folder) and _is_cut_short(folder):
        yield folder
        return
    paths = [Path(word)]
    matched = paths
    if not paths[0].exists() and any(letter in word for letter in WILD):
        matched = [Path(name) for name in sorted(glob.glob(word, recursive=True))]  # noqa: PTH207 - absolute, too
        paths = [p for p in matched if (p.is_dir() or is_bag(p) or is_log(p)) and not is_bag(p.parent)]
    bags = [bag for path in paths for bag in _find_bags_inside(path)]
    if not bags:
        what = "no bag in this folder or below it" if matched == [Path(word)] else "no bag matches"
        inside = (path for first in matched for path in ([first] if first.is_file() else sorted(first.glob("*"))))
        foreign = next(filter(is_foreign, inside), None)
        raise CesError(f"{word}: {what}; " + (f"{foreign} {explain_import(foreign)}" if foreign else BAGS_EXPECTED))
    yield from bags


def _find_bags_inside(path: Path) -> list[Path]:
    """Return the bag that `path` is, or those in and below it; a path that does not exist is returned as it is."""
    if is_bag(path) or not path.is_dir():
        return [path]
    inside = [entry for entry in sorted(path.iterdir()) if entry.is_dir() or is_bag(entry)]
    return [bag for entry in inside for bag in _find_bags_inside(entry)]


def is_bag(path: Path) -> bool:
    """Return whether `path` is a rosbag2 folder, also of a killed recorder, or a bag file by its name."""
    if not path.is_dir():
        return path.suffix in FILES
    if (path / "metadata.yaml").is_file():
        return True
    files = [file for file in path.iterdir() if file.name.removesuffix(".zstd").endswith(FILES)]
    parts = _find_parts(files)
    return parts is not None and parts[0] == path.name  # the numbered files of one recorder, no collection of bags


def _find_parts(files: Sequence[Path]) -> tuple[str, Path] | None:
    """Return the name of the recorder of which all files are the numbered ones, from 0, and the last; else None."""
    parts = {int(match[2] or 0): (match[1], file) for file in files if (match := PART.fullmatch(file.name))}
    if len({name for name, _ in parts.values()}) != 1 or len(parts) != len(files) or 0 not in parts:
        return None
    return parts[max(parts)]


def _is_cut_short(folder: Path) -> bool:
    """Return whether all files in a folder are the numbered MCAP files of one recorder, the last without its end."""
    parts = _find_parts([file for file in folder.iterdir() if file.suffix in (".mcap", ".db3", ".zstd")])
    if parts is None or parts[1].suffix != ".mcap":
        return False
    try:
        require_complete(parts[1])
    except RecordingError:
        return True
    return False
