"""Resident memory over time at 1 kHz: slopes of the observer and of its C++ twin beyond those of the empty relays.

Needs a sourced ROS 2 (`python3 bench/live/memory_slope.py --minutes 60`). All nodes receive the same messages for the
same time. The slope is that of a straight line fitted after `--settle` minutes. `--write` writes the result into
docs/benchmarks.md.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Sequence
from contextlib import ExitStack

from bench_live import TARGET_HZ, describe_machine, make_parser, parse, print_report
from builds import ROOT, BuildError
from contestants import CPP_RELAY, OBSERVER, PYTHON_RELAY, TWIN, Field, GeneratorLoad, make_contestants, print_note

sys.path.insert(0, str(ROOT))
from bench.reliability.memory import Memory

HEADER = ("node", "at first MB", "at the end MB", "slope MB/h", "first half", "second half", "beyond its relay MB/h")
RELAY_OF = {OBSERVER: PYTHON_RELAY, TWIN: CPP_RELAY}
MAX_SLOPE = 0.2  # MB/h beyond the relay
Points = Sequence[tuple[float, float]]  # time [h], memory [MB]


def fit_slope(points: Points) -> float:
    """Return the slope of the line of least squares."""
    count = len(points)
    mean_h, mean_MB = (sum(values) / count for values in zip(*points, strict=True))
    spread = sum((h - mean_h) ** 2 for h, _ in points)
    return sum((h - mean_h) * (MB - mean_MB) for h, MB in points) / spread


def row(name: str, points: Points, relay: Points | None) -> str:
    """Return a row of the table, with the difference to the node's empty relay."""
    half = len(points) // 2
    slopes = [fit_slope(part) for part in (points, points[:half], points[half:])]
    cells = [name, f"{points[0][1]:.2f}", f"{points[-1][1]:.2f}", *(f"{slope:+.2f}" for slope in slopes), ""]
    if relay is not None:
        beyond = slopes[0] - fit_slope(relay)
        cells[-1] = f"{beyond:+.2f}: {'met' if beyond <= MAX_SLOPE else '**missed**'}"
    return f"| {' | '.join(cells)} |"


def sample(options: Namespace) -> dict[str, Points]:
    """Run all nodes on the same messages; return their memory after the time to settle."""
    generator, nodes = make_contestants(options.model, options.parameters)
    print_note(f"{options.minutes:g} minutes at {TARGET_HZ:g} Hz")
    with ExitStack() as stack:
        field = stack.enter_context(Field(nodes, generator, priority=options.priority, shared=True))
        memories = {node.name: Memory(field.pid(node)) for node in nodes}
        for memory in memories.values():
            stack.callback(memory.stop)
        observer = next(node for node in nodes if node.name == OBSERVER)
        field.measure(observer, GeneratorLoad(TARGET_HZ, 60.0 * options.minutes, 2.0))
    settled_s = 60.0 * options.settle
    return {
        name: [(s / 3600.0, kB / 1024.0) for s, kB in zip(one.seconds, one.kB, strict=True) if s >= settled_s]
        for name, one in memories.items()
    }


def report(options: Namespace) -> list[str]:
    found = sample(options)
    lines = [f"| {' | '.join(HEADER)} |", "|---|" + "---:|" * (len(HEADER) - 1)]
    lines += [row(name, points, found.get(RELAY_OF.get(name, ""))) for name, points in found.items()]
    note = (
        f"{options.minutes:g} minutes at {TARGET_HZ:g} Hz, the first {options.settle:g} left out; target: at most "
        f"{MAX_SLOPE:g} MB an hour beyond the empty relay in the same language."
    )
    return [*lines, "", note, describe_machine()]


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=60.0, help="default 60")
    parser.add_argument("--settle", type=float, default=5.0, help="minutes at first that are left out, default 5")
    options = parse(parser)
    if options.minutes < options.settle + 0.5:
        parser.error(f"--minutes {options.minutes:g}: expected at least half a minute more than --settle")
    try:
        print_report(report(options), options.write, "memory")
    except BuildError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
