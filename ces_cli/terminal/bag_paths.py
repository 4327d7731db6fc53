"""Arguments that name recordings: bags, folders that hold bags, and globs of either."""

from __future__ import annotations

import glob
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_observer.errors import CesError

FILES = (".mcap", ".db3")
WILD = "*?["
RECORDING, VEHICLE = "recording", "vehicle"


@dataclass(frozen=True)
class FleetUnit:
    """One recording of a fleet, or the recordings of one vehicle, which are in one folder."""

    name: str
    paths: tuple[Path, ...]


def find_bags(words: Sequence[str]) -> list[Path]:
    """Return the bags that the arguments name, each once and in order; raises CesError for one that names none."""
    return list(dict.fromkeys(path for word in words for path in _match_word(word)))


def find_fleet_units(words: Sequence[str], each: str) -> list[FleetUnit]:
    """Return a unit for each recording that the arguments name, or for each folder that holds some (`each`)."""
    groups: dict[Path, list[Path]] = {}
    for path in find_bags(words):
        groups.setdefault(path if each == RECORDING else path.resolve().parent, []).append(path)
    names = _make_distinct_names([path.resolve() for path in groups])
    return [FleetUnit(name, tuple(paths)) for name, paths in zip(names, groups.values(), strict=True)]


def _match_word(word: str) -> Iterator[Path]:
    paths = [Path(word)]
    if not paths[0].exists() and any(letter in word for letter in WILD):
        matched = [Path(name) for name in sorted(glob.glob(word, recursive=True))]  # noqa: PTH207 - absolute, too
        paths = [path for path in matched if (path.is_dir() or is_bag(path)) and not is_bag(path.parent)]
    bags = [bag for path in paths for bag in _find_bags_inside(path)]
    if not bags:
        what = "no bag matches" if paths != [Path(word)] else "no bag in this folder or below it"
        raise CesError(f"{word}: {what}; expected rosbag2 folders, .mcap or .db3 files, folders of them, or a glob")
    yield from bags


def _find_bags_inside(path: Path) -> list[Path]:
    """Return the bag that `path` is, or those in and below it; a path that does not exist is returned as it is."""
    if is_bag(path) or not path.is_dir():
        return [path]
    return [
        bag for child in sorted(path.iterdir()) if child.is_dir() or is_bag(child) for bag in _find_bags_inside(child)
    ]


def is_bag(path: Path) -> bool:
    """Return whether `path` is a rosbag2 folder, or a bag file by its name."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else path.suffix in FILES


def _make_distinct_names(paths: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that differ from each other, each joined into one word."""
    for depth in range(1, 8):
        names = ["_".join([*path.parts[-depth:-1], path.stem if path.suffix in FILES else path.name]) for path in paths]
        if len(set(names)) == len(names):
            return [name.replace("/", "_").replace(" ", "_") for name in names]
    return [f"{path.name}_{number}" for number, path in enumerate(paths, start=1)]
