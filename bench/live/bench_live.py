"""Latency from stamp to received estimate, loss and CPU of the observer and its C++ twin, beside empty relays.

Needs a sourced ROS 2 (`python3 bench/live/bench_live.py`). All nodes run side by side; a generator loads one after the
other, in rounds, so that other load of the machine affects all equally: quiet, then with a busy process on each core.
`--write` writes the table into docs/benchmarks.md. The C++ programs are built into out/live.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from builds import ROOT, BuildError
from contestants import CPP_RELAY, Contestant, Field, GeneratorLoad, GeneratorRun, make_contestants, print_note
from figures import HEADER, RATIOS, TARGETS, median_range, row, verdicts
from hogs import Hogs

sys.path.insert(0, str(ROOT))
from bench.markdown import replace_between
from bench.measurement import processor

PAGE = ROOT / "docs" / "benchmarks.md"
MODEL = ROOT / "config" / "models" / "sample.json"
TARGET_HZ = 1000.0
QUIET, BUSY = "quiet", "a hog on each core"
Key = tuple[str, float, str]  # load, rate [Hz], name
Runs = dict[Key, list[GeneratorRun]]


def play(field: Field, nodes: Sequence[Contestant], options: argparse.Namespace) -> Runs:
    """Return the runs of each node, one per round."""
    runs: Runs = {(load, rate, node.name): [] for load in options.loads for rate in options.rates for node in nodes}
    for number in range(options.rounds):
        for load in options.loads:
            with Hogs(load == BUSY):
                for rate in options.rates:
                    print_note(f"round {number + 1} of {options.rounds}, {load}, {rate:g} Hz")
                    for node in nodes:
                        one = GeneratorLoad(rate, options.seconds, options.warm_up)
                        runs[load, rate, node.name].append(field.measure(node, one))
    return runs


def table(found: Runs) -> list[str]:
    head = [*HEADER, *RATIOS]
    lines = [f"| {' | '.join(head)} |", "|---|---:|---|" + "---:|" * (len(head) - 3)]
    for (load, rate, name), runs in found.items():
        lines.append(f"| {' | '.join(row(load, rate, name, runs, found[load, rate, CPP_RELAY]))} |")
    return lines


def target_lines(found: Runs) -> list[str]:
    if (relay := found.get((QUIET, TARGET_HZ, CPP_RELAY))) is None:
        return ["* no verdict: 1000 Hz on the quiet machine was not requested"]
    named = {name: found[QUIET, TARGET_HZ, name] for name in TARGETS if (QUIET, TARGET_HZ, name) in found}
    return [line for name, runs in named.items() for line in verdicts(name, runs, relay)]


def describe_noise(found: Runs, options: argparse.Namespace, began: float) -> str:
    """Return a description of the load and of the machine's disturbances."""
    runs = [run for several in found.values() for run in several]
    priority = f"SCHED_FIFO {runs[0].priority}" if runs[0].priority else "ordinary priority"
    return (
        f"{options.rounds} rounds of {options.seconds:g} s each after {options.warm_up:g} s of warm-up: median over "
        f"the rounds, in brackets their range. The generator, under {priority}, woke up "
        f"{median_range(runs, 'late_p50_us').text()} µs late in the median and "
        f"{median_range(runs, 'late_p99_us').text()} µs at its p99. Load of the machine {began:.1f} before."
    )


def describe_machine() -> str:
    import rclpy

    middleware = rclpy.get_rmw_implementation_identifier()
    versions = f"ROS 2 {os.environ.get('ROS_DISTRO')}, {middleware}, Python {sys.version.split()[0]}"
    return f"{processor()}, {len(os.sched_getaffinity(0))} cores; {versions}."


def report(options: argparse.Namespace) -> list[str]:
    began = os.getloadavg()[0]
    generator, nodes = make_contestants(options.model, options.parameters)
    with Field(nodes, generator, priority=options.priority) as field:
        found = play(field, nodes, options)
    notes = [describe_noise(found, options, began), describe_machine()]
    return [*table(found), "", *target_lines(found), "", *notes]


def make_parser(text: str | None) -> argparse.ArgumentParser:
    """Return a parser with the options of all programs of this folder."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, default=MODEL, help="default config/models/sample.json")
    priority = "of the generator under SCHED_FIFO, so that it is on time beside hogs; 0: ordinary; default 50"
    parser.add_argument("--priority", type=int, default=50, help=priority)
    parser.add_argument(
        "--parameters",
        nargs="+",
        default=[],
        metavar="NAME:=VALUE",
        help="of the observers, such as realtime_priority:=20",
    )
    parser.add_argument("--write", action="store_true", help=f"write the result into docs/{PAGE.name}")
    return parser


def parse(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """Parse the command line and check what all programs need."""
    options = parser.parse_args()
    if find_spec("rclpy") is None:
        parser.error("rclpy is missing; source ROS 2 and run this with its python3")
    if not options.model.is_file():
        parser.error(f"{options.model}: no such model file; pass one from `ces identify` with --model")
    options.model = options.model.resolve()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # ends the nodes, too
    return options


def print_report(lines: Sequence[str], write: bool, mark: str) -> None:
    """Print the lines, and write them between the marks of the page."""
    print("\n".join(lines))
    if write:
        replace_between(PAGE, mark, "\n".join(lines))


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--rates", type=float, nargs="+", default=[1000.0, 2000.0], metavar="HZ")
    parser.add_argument("--loads", nargs="+", choices=(QUIET, BUSY), default=[QUIET, BUSY], help="default both")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a run [s], default 5")
    parser.add_argument("--warm-up", type=float, default=1.5, help="before each run, not counted [s], default 1.5")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each node at each rate and load, default 5")
    options = parse(parser)
    try:
        print_report(report(options), options.write, "live")
    except BuildError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
