"""`ces export-data`: writes recordings, and a model's estimates over them, as CSV or Parquet for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ces_cli.bags.replay import estimate_forces
from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import print_findings
from ces_cli.terminal.options import BAGS, OVERWRITE, SIGNALS, ProgramRequest, option
from ces_data.bags.find import find_bags
from ces_data.outputs import OUT, require_outputs
from ces_data.recording import Channel, Recording
from ces_data.signals_file import load_signals
from ces_data.tables import FORMATS, require_writer, tabulate, write_table
from ces_observer.errors import CesError, OptionName
from ces_observer.model import Model, load_model
from ces_observer.records import declare

SUFFIXES = {".csv": "csv", ".parquet": "parquet", ".pq": "parquet"}
ESTIMATES = (  # column of the estimator's rows, name and unit
    (2, "estimated_speed", "m/s"),
    (3, "estimated_force", "N"),
    (4, "estimated_force_lower", "N"),
    (5, "estimated_force_upper", "N"),
)


@dataclass(frozen=True, kw_only=True)
class ExportDataRequest(ProgramRequest):
    """Write recordings as CSV or Parquet, in SI units, which the names of the columns state (position_m, force_N). A
    row is a position sample; a channel with other times is held (current_held_A) or interpolated (force_interp_N), and
    its cell is empty in a gap. stamp_ns is the exact time since 1970, time_s counts from the first row.
    """

    program = "export-data"
    example = (
        "ces export-data bags/road --out road.csv\n"
        "  ces export-data bags/road bags/sweep --out tables --format parquet --model model.json"
    )

    bags: tuple[str, ...] = declare(BAGS)
    out: Path = option(meaning="FILE.csv, FILE.parquet, or a folder, which gets a file for each bag", metavar="FILE")
    format: str | None = option(None, "of the files in a folder", choices=FORMATS, none="csv")
    model: Path | None = option(
        None, "add the speed and force that a model estimates, and the bounds of its band", metavar="MODEL.json"
    )
    signals: Path | None = declare(SIGNALS)
    overwrite: bool = declare(OVERWRITE)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError before any work if an output cannot be written."""
    request = terminal.read(ExportDataRequest, argv)
    bags = find_bags(request.bags)
    targets = list_targets(bags, request.out, request.format)
    for path, kind in targets:
        require_writer(path, kind)
        if path == request.out or request.out.is_dir():
            inputs = [*bags, request.model, request.signals]
            require_outputs(request.overwrite, {OUT: path}, inputs=inputs)
        else:
            require_outputs(request.overwrite, folders={OUT: request.out})
    signals = load_signals(request.signals)
    model = load_model(request.model) if request.model else None
    for bag, (path, kind) in zip(bags, targets, strict=True):
        recording = terminal.read_one(bag, signals, ("position",))
        print_findings([recording])
        with terminal.step(f"writing {path}"):
            table = tabulate(recording, _estimate(model, recording) if model else {})
            write_table(table, path, kind)
        print(f"{path}: {len(table.stamps_ns)} rows of {', '.join(column.name for column in table.columns)}")
    return 0


def list_targets(bags: Sequence[Path], out: Path, form: str | None) -> list[tuple[Path, str]]:
    """Return path and format of the file for each bag; raises CesError if they do not fit each other."""
    kind = SUFFIXES.get(out.suffix.lower())
    if kind is not None and not out.is_dir():
        if len(bags) > 1:
            raise CesError(OptionName("out", out), f": {len(bags)} bags need a folder, which gets a file for each")
        if form not in (None, kind):
            remedy = OptionName("format"), ", or give a folder"
            raise CesError(OptionName("out", out), f": is a {kind} file by its name; omit ", *remedy)
        return [(out, kind)]
    if out.is_file() or (out.suffix and not out.is_dir()):
        raise CesError(OptionName("out", out), f": expected a name that ends in {', '.join(SUFFIXES)}, or a folder")
    names = [bag.name if bag.is_dir() else bag.stem for bag in bags]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise CesError(f"{names.count(twice)} bags are named '{twice}' and would give the same file; export them apart")
    chosen = form or FORMATS[0]
    return [(out / f"{name}.{chosen}", chosen) for name in names]


def _estimate(model: Model, recording: Recording) -> dict[str, Channel]:
    """Return the estimates as channels on the position's stamps; those without a finite number are left out."""
    rows = estimate_forces(model, recording).rows
    stamps = rows[:, 0].astype(np.int64)
    channels = {name: Channel(name, unit, stamps, rows[:, i].astype(np.float64)) for i, name, unit in ESTIMATES}
    return {name: channel for name, channel in channels.items() if np.isfinite(channel.values).any()}
