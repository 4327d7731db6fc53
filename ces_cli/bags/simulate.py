"""`ces simulate`: runs any simulation over a recording and writes its force as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import HELP, find_file, open_simulation, with_predictions
from ces_cli.terminal.options import ONE_BAG, PART, BagRequest, option
from ces_cli.terminal.outputs import print_document
from ces_data.bags.find import find_bag
from ces_data.outputs import OUT, require_outputs
from ces_data.signals_file import load_signals
from ces_identify.validation.checked import simulate_checked
from ces_observer.json_text import write_atomically
from ces_observer.records import declare


@dataclass(frozen=True, kw_only=True)
class SimulateRequest(BagRequest):
    """Run a simulation with the position and current of a recording and write time_s,force_N, one row for each position
    sample (nan where the simulation returns no force, such as while an estimator warms up).
    """

    program = "simulate"
    example = "ces simulate --sim model.json bags/road --out road.csv"

    bag: str = declare(ONE_BAG)
    sim: str = option(meaning=HELP, metavar="SIM")
    part: tuple[float, ...] = declare(PART)
    out: Path = option(metavar="FILE.csv")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(SimulateRequest, argv)
    path = find_bag(request.bag)
    inputs = [path, request.signals, find_file(request.sim)]
    require_outputs(request.overwrite, {OUT: request.out}, inputs=inputs)
    signals = load_signals(request.signals)
    simulation = open_simulation(request.sim)
    recording = terminal.read_one(path, signals, part=request.part)
    with terminal.step(f"simulating {recording.name}"):
        extended = with_predictions(simulation, path, recording, signals)
        force, run, warnings = simulate_checked(simulation, extended)
    stamps = recording.channel("position").stamps_ns
    known = np.isfinite(force)
    for text in warnings:
        terminal.print_warning(text)
    values = zip(((stamps - stamps[0]) * 1e-9).tolist(), force.tolist(), strict=True)
    write_atomically(request.out, "time_s,force_N\n" + "".join(f"{time:.9f},{newtons!r}\n" for time, newtons in values))
    if request.json:
        facts = {"recording": recording.name, "simulation": request.sim, "csv": request.out, "rows": len(force)}
        facts |= {"rows_without_force": int((~known).sum()), "rows_held": run and int(run.held_at(known)[2].sum())}
        ends = [force[known].min(), force[known].max()] if known.any() else None
        print_document("simulate", {**facts, "force_N": ends})
    else:
        print(f"{len(force)} rows: {request.out}")
    return 0
