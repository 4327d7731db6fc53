"""Injects faults into a running observer for a quarter of an hour, and evaluates its estimates and diagnostics.

Needs a sourced ROS 2 (`python3 bench/reliability/run.py`): the observer is a separate process, observed over real DDS
on this computer, with a source at 1 kHz. With `--simulated`, time comes from /clock. `--write` writes the table into
docs/reliability.md and the plot of memory into docs/img. Exit status 1 if a rule was violated.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from random import Random

ROOT = Path(__file__).resolve().parent.parent.parent
MODEL = ROOT / "config" / "models" / "sample.json"


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=15.0, help="length of the campaign [min], default 15")
    parser.add_argument("--seed", type=int, default=1, help="seed of order, times and random values, default 1")
    parser.add_argument("--simulated", action="store_true", help="simulated time")
    parser.add_argument("--model", type=Path, default=MODEL, help="default config/models/sample.json")
    parser.add_argument("--only", metavar="TEXT", help="only faults whose name contains this")
    parser.add_argument("--write", action="store_true", help="write table and plot into docs/")
    options = parser.parse_args()
    if find_spec("rclpy") is None:
        parser.error("rclpy is missing; source ROS 2 and run this with its python3")
    return options


def main() -> int:
    options = parse_arguments()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    sys.path.insert(0, str(ROOT))
    from campaign import ObserverEndedError, make_limits, play, rounds, start_stage
    from faults import REAL, SIMULATED, faults
    from judge import check_bounds
    from memory import Memory
    from page import CampaignRecord, write

    from ces_observer.model import load_model

    model = load_model(options.model)
    times = SIMULATED if options.simulated else REAL
    chosen = [one for one in faults(model.sampling.max_current_age_s) if times in one.times]
    chosen = [one for one in chosen if not options.only or options.only in one.name]
    limits = make_limits(model, times)
    dice, record = Random(options.seed), CampaignRecord(times, options.seed)
    with tempfile.TemporaryDirectory() as folder, start_stage(model, Path(folder), times) as stage:
        memory = Memory(stage.observer.process.pid)
        began = time.monotonic()
        try:
            for outcome in play(stage, rounds(chosen, dice, began + 60.0 * options.minutes), limits, dice):
                record.add(outcome)
        except ObserverEndedError as error:
            record.wrong.append(str(error))
        record.end(time.monotonic() - began, len(stage.monitor.estimates), memory)
        memory.stop()
        record.wrong += stage.observer.end()
        record.wrong += check_bounds(stage.monitor.estimates, range(len(stage.monitor.estimates)), limits)
        record.wrong += ["the monitor misread estimates"] if stage.monitor.estimates.misread else []
        if record.wrong:
            print(stage.observer.log()[-3000:], file=sys.stderr)
    print("\n".join(record.lines()))
    if options.write:
        write(record, memory)
    return 1 if record.is_bad() else 0


if __name__ == "__main__":
    sys.exit(main())
