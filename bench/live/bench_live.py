"""Latency from stamp to received estimate, loss and CPU of the observer and its C++ twin, beside empty relays.

Needs a sourced ROS 2 (`python3 -m bench.live.bench_live`). All nodes run side by side; a generator loads one after the
other, in rounds, so that other load of the machine affects all equally: quiet, then with a busy process on each core.
The C++ programs are built into out/live.
"""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from statistics import median

from bench.live.contestants import (
    CPP_RELAY,
    OBSERVER,
    ROOT,
    TWIN,
    BuildError,
    Contestant,
    ContestField,
    GeneratorLoad,
    GeneratorRun,
    Hogs,
    make_contestants,
    print_note,
)
from bench.markdown import markdown
from bench.measurement import processor, verdict

TARGETS = {OBSERVER: (1.5, 1.6), TWIN: (1.15, 1.15)}  # median and CPU, times those of the empty C++ relay
HEADER = ("load", "rate Hz", "node", "median µs", "p99 µs", "worst ms", "CPU % of a core")


@dataclass(frozen=True)
class MedianRange:
    """Median and range of a figure over the rounds."""

    middle: float
    low: float
    high: float

    @classmethod
    def from_values(cls, values: Iterable[float]) -> MedianRange:
        """Return median and range of at least one value."""
        all_values = sorted(values)
        return cls(median(all_values), all_values[0], all_values[-1])

    def text(self, digits: int = 0) -> str:
        return f"{self.middle:,.{digits}f} ({self.low:,.{digits}f}…{self.high:,.{digits}f})"


def median_range(runs: Sequence[GeneratorRun], name: str, scale: float = 1.0) -> MedianRange:
    """Return the spread of a run's figure."""
    return MedianRange.from_values(scale * getattr(run, name) for run in runs)


def ratio(runs: Sequence[GeneratorRun], others: Sequence[GeneratorRun], name: str) -> MedianRange:
    """Return the spread of the ratios of two contestants in the same round, equally disturbed by the machine."""
    return MedianRange.from_values(getattr(a, name) / getattr(b, name) for a, b in zip(runs, others, strict=True))


def row(load: str, rate_Hz: float, name: str, runs: Sequence[GeneratorRun]) -> list[str]:
    """Return a row of the table."""
    cells = [load, f"{rate_Hz:g}", name, median_range(runs, "p50_us").text(), median_range(runs, "p99_us").text()]
    return [*cells, f"{max(run.max_us for run in runs) * 1e-3:,.1f}", median_range(runs, "cpu_share", 100.0).text(1)]


MODEL = ROOT / "config" / "models" / "sample.json"
TARGET_HZ = 1000.0
QUIET, BUSY = "quiet", "busy cores"
Key = tuple[str, float, str]  # load, rate [Hz], name
Runs = dict[Key, list[GeneratorRun]]


def play(field: ContestField, nodes: Sequence[Contestant], options: argparse.Namespace) -> Runs:
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


def table(found: Runs) -> str:
    return markdown([HEADER, *(row(load, rate, name, runs) for (load, rate, name), runs in found.items())], left=3)


def target_lines(found: Runs) -> list[str]:
    """Return a line for each target of a node at 1 kHz on the quiet machine."""
    if (relay := found.get((QUIET, TARGET_HZ, CPP_RELAY))) is None:
        return ["* no verdict: 1000 Hz on the quiet machine was not requested"]
    named = {name: found[QUIET, TARGET_HZ, name] for name in TARGETS if (QUIET, TARGET_HZ, name) in found}
    lines = []
    for name, runs in named.items():
        for what, figure, limit in zip(("median", "CPU"), ("p50_us", "cpu_share"), TARGETS[name], strict=True):
            spread = ratio(runs, relay, figure)
            times = f"{spread.text(2)} times; target at most {limit:g}: {verdict(spread.middle, limit)}"
            lines.append(f"* {name}, {what} beside the empty C++ relay: {times}")
    return lines


def describe_noise(found: Runs, options: argparse.Namespace, began: float) -> str:
    """Return a description of the load and of the machine's disturbances."""
    runs = [run for several in found.values() for run in several]
    priority = f"SCHED_FIFO {runs[0].priority}" if runs[0].priority else "ordinary priority"
    lost, sent = (sum(getattr(run, name) for run in runs) for name in ("lost", "all_sent"))
    withheld = max(0, sum(run.without_estimate for run in runs) - lost)
    return (
        f"Lost {lost:,} of {sent:,} samples, withheld {withheld:,} after the warm-up. {options.rounds} rounds of "
        f"{options.seconds:g} s each after {options.warm_up:g} s of warm-up: median over "
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
    with ContestField(nodes, generator, priority=options.priority) as field:
        found = play(field, nodes, options)
    notes = [describe_noise(found, options, began), describe_machine()]
    return [table(found), "", *target_lines(found), "", *notes]


def parse_arguments() -> argparse.Namespace:
    """Parse the command line, and check what a run needs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--model", type=Path, default=MODEL, help="default config/models/sample.json")
    priority = "of the generator under SCHED_FIFO, so that it is on time beside hogs; 0: ordinary; default 50"
    parser.add_argument("--priority", type=int, default=50, help=priority)
    parameters = "of the observers, such as realtime_priority:=20"
    parser.add_argument("--parameters", nargs="+", default=[], metavar="NAME:=VALUE", help=parameters)
    parser.add_argument("--rates", type=float, nargs="+", default=[1000.0, 2000.0], metavar="HZ")
    parser.add_argument("--loads", nargs="+", choices=(QUIET, BUSY), default=[QUIET, BUSY], help="default both")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a run [s], default 5")
    parser.add_argument("--warm-up", type=float, default=1.5, help="before each run, not counted [s], default 1.5")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each node at each rate and load, default 5")
    options = parser.parse_args()
    if find_spec("rclpy") is None:
        parser.error("rclpy is missing; source ROS 2 and run this with its python3")
    if not options.model.is_file():
        parser.error(f"{options.model}: no such model file; pass one from `ces identify` with --model")
    options.model = options.model.resolve()
    return options


def main() -> None:
    options = parse_arguments()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # ends the nodes, too
    try:
        print("\n".join(report(options)))
    except BuildError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main()
