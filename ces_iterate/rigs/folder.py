"""A dyno behind a folder: an experiment and its instructions are written, the operator puts the log beside them.

A log is read only when it is complete: its size and time have not changed between two looks, and it reads without an
error. One that cannot be read is reported once and looked at again when it changes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from ces_data.bags.reader import read_recording
from ces_data.findings import require_usable
from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import DynoMapping
from ces_data.recording import Recording
from ces_iterate.commands import NEED, RigCommands
from ces_iterate.errors import IterateError
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_observer.signals import Signals

DROP = "log"  # folder in an iteration's folder, for the operator
MIN_SHARE = 0.9  # of the experiment's length that a log must hold
TEMPORARY = (".tmp", ".part", ".partial", ".crdownload", ".filepart", "~")

Mark = tuple[tuple[str, int, int], ...]
"""Names, sizes and times [ns] of all files of a log, to see whether it still changes."""


@dataclass(frozen=True)
class FolderRig:
    """Waits for a bag, or with a `mapping` for a log of any format that `ces import` reads, every `poll_s`."""

    mapping: DynoMapping | None
    signals: Signals
    poll_s: float = 1.0
    note: Callable[[str], None] = field(default=lambda text: print(text, file=sys.stderr, flush=True))
    sleep: Callable[[float], None] = field(default=time.sleep)

    def run(self, commands: RigCommands, folder: Path) -> Recording:
        """Return the recording that the operator put into `folder`/log; waits until it is there."""
        drop = folder / DROP
        drop.mkdir(exist_ok=True)
        write_atomically(folder / "INSTRUCTIONS.txt", instructions(commands, drop, self.mapping is not None))
        self.note(f"waiting for the log of {commands.name} in {drop} (see INSTRUCTIONS.txt; Ctrl-C may interrupt)")
        seen: dict[Path, Mark] = {}
        refused: dict[Path, Mark] = {}
        while True:
            for path in sorted(drop.iterdir()):
                if path.name.startswith(".") or path.name.endswith(TEMPORARY):
                    continue
                mark = _mark(path)
                if not mark or refused.get(path) == mark:
                    continue
                if seen.get(path) != mark:
                    seen[path] = mark
                    continue
                try:
                    return self._read(path, commands)
                except CesError as error:
                    refused[path] = mark
                    self.note(f"not used: {error}")
            self.sleep(self.poll_s)

    def _read(self, path: Path, commands: RigCommands) -> Recording:
        if path.is_dir() or path.suffix == ".mcap":
            recording = read_recording(path, self.signals, NEED)
        elif self.mapping is not None:
            recording = import_log(path, self.mapping)
        else:
            raise IterateError(f"{path}: is not a bag, and rig: mapping does not say how to read it; add a mapping")
        require_usable(recording)
        stamps = recording.channel("position").stamps_ns
        length = float(stamps.max() - stamps.min()) * 1e-9
        if length < MIN_SHARE * commands.duration_s:
            raise IterateError(f"{path}: {length:.1f} s long; expected the whole of {commands.duration_s:.1f} s")
        return recording


def instructions(commands: RigCommands, drop: Path, mapped: bool) -> str:
    """Return what the operator is to do."""
    what = "the dyno's log, or a rosbag2 folder," if mapped else "the rosbag2 folder (or .mcap file)"
    rest = f"1. Let the damper rest for {commands.rest_s:.0f} s, so that it cools down.\n" if commands.rest_s else ""
    low, high = commands.stroke_m.min(), commands.stroke_m.max()
    return (
        f"Experiment {commands.name}\n\n{rest}"
        f"2. Run commands.csv: time [s], stroke [m] (positive in compression), current [A], a row every 1 ms,\n"
        f"   {commands.duration_s:.1f} s in all, stroke {1e3 * low:.1f} to {1e3 * high:.1f} mm.\n"
        "   Record position, current and force.\n"
        f"3. Put {what} into {drop}. Copy it under a name that ends in .part and rename it when it is complete,\n"
        "   or just copy it: it is read when it no longer changes.\n"
    )


def _mark(path: Path) -> Mark:
    """Return the state of a file or folder, () if it is empty, being renamed, or a bag that is still recorded."""
    if path.is_dir() and not (path / "metadata.yaml").exists():
        return ()
    try:
        files = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
        stats = [(str(p), p.stat()) for p in files]
    except OSError:
        return ()
    return tuple((name, s.st_size, s.st_mtime_ns) for name, s in stats) if any(s.st_size for _, s in stats) else ()
