"""`ces simulate`: runs any simulation over a recording and writes its force as CSV."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.simulations import HELP, open_simulation, with_predictions
from ces_observer.json_checks import write_atomically


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = _parser().parse_args(argv)
    signals = terminal.load_described_signals(options)
    simulation = open_simulation(options.sim)
    recording = terminal.read_one(options.bag, signals)
    with terminal.err.status(f"simulating {recording.name}"):
        force = simulation.force(with_predictions(simulation, options.bag, recording, signals))
    stamps = recording.channel("position").stamps_ns
    rows = [f"{t:.9f},{f!r}" for t, f in zip(((stamps - stamps[0]) * 1e-9).tolist(), force.tolist(), strict=True)]
    write_atomically(options.out, "\n".join(["time_s,force_N", *rows]) + "\n")
    print(f"{len(rows)} rows: {options.out}")
    return 0


def _parser() -> terminal.Parser:
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
    return p
