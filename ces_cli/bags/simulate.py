"""`ces simulate`: runs any simulation over a recording and writes its force as CSV."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ces_cli.terminal import terminal
from ces_cli.terminal.json_output import add_json, print_document
from ces_cli.terminal.simulations import HELP, open_simulation, with_predictions
from ces_identify.numerics.arrays import F
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulate import sample_bounds
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    signals = terminal.load_described_signals(options)
    simulation = open_simulation(options.sim)
    recording = terminal.read_one(options.bag, signals)
    with terminal.err.status(f"simulating {recording.name}"):
        columns = {"force_N": simulation.force(with_predictions(simulation, options.bag, recording, signals))}
        if options.band:
            columns |= _bounds(simulation, recording)
    stamps = recording.channel("position").stamps_ns
    values = zip(((stamps - stamps[0]) * 1e-9).tolist(), *(c.tolist() for c in columns.values()), strict=True)
    rows = [f"{time:.9f},{','.join(map(repr, forces))}" for time, *forces in values]
    write_atomically(options.out, "\n".join([",".join(["time_s", *columns]), *rows]) + "\n")
    if options.json:
        print_document("simulate", _as_json(recording, columns["force_N"], options))
    else:
        print(f"{len(rows)} rows: {options.out}")
    return 0


def _as_json(recording: Recording, force: F, options: argparse.Namespace) -> dict[str, object]:
    """Return the document of --json."""
    known = force[np.isfinite(force)]
    return {
        "recording": recording.name,
        "simulation": options.sim,
        "csv": options.out,
        "rows": len(force),
        "rows_without_force": len(force) - len(known),
        "force_N": [known.min(), known.max()] if len(known) else None,
    }


def _bounds(simulation: Simulation, recording: Recording) -> dict[str, F]:
    """Return the bounds of a model's band; raises CesError for other simulations."""
    if not isinstance(simulation, ModelSimulation):
        raise CesError("--band: only a model file has a band; give --sim MODEL.json")
    return dict(zip(("lower_N", "upper_N"), sample_bounds(simulation.model, recording), strict=True))


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "simulate",
        "Run a simulation with the position and current of a recording and write time_s,force_N, one row for each "
        "position sample (nan where the simulation returns no force, such as while an estimator warms up).",
        "ces simulate --sim model.json bags/road --out road.csv",
    )
    p.add_argument("bag", type=Path, metavar="BAG")
    p.add_argument("--sim", required=True, metavar="SIM", help=HELP)
    terminal.add_signals(p)
    p.add_argument("--out", type=Path, required=True, metavar="FILE.csv")
    p.add_argument("--band", action="store_true", help="add columns lower_N,upper_N: the bounds of the model's band")
    add_json(p)
    return p
