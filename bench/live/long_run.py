"""Many minutes at 1 kHz with a busy process on each core: is a sample lost?

Needs a sourced ROS 2 (`python3 bench/live/long_run.py --minutes 10`). The Python node runs, then its C++ twin. Each
sample is accounted for by its stamp and by the node's own counts: lost before the node, withheld with its reason, lost
after the node, or received. `--write` writes the result into docs/benchmarks.md.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence

from bench_live import TARGET_HZ, describe_machine, make_parser, parse, print_report
from builds import BuildError
from contestants import Contestant, Field, GeneratorLoad, GeneratorRun, make_contestants, print_note
from hogs import Hogs

HEADER = ("node", "sent", "lost before", "lost after", "withheld", "median µs", "p99 µs", "worst ms", "CPU %", "lost")
RELIABLE = tuple(
    f"qos_overrides./live0/{name}.subscription.reliability:=reliable" for name in ("joint_states", "valve_current")
)


def row(name: str, run: GeneratorRun) -> str:
    """Return a row of the table."""
    reasons = "; ".join(f"{reason}: {count:,}" for reason, count in run.withheld.items())
    cells = [name, f"{run.all_sent:,}", f"{run.lost_in:,}", f"{run.lost_out:,}", reasons, f"{run.p50_us:.0f}"]
    cells += [f"{run.p99_us:,.0f}", f"{run.max_us * 1e-3:.1f}", f"{100.0 * run.cpu_share:.1f}"]
    return f"| {' | '.join([*cells, 'none: met' if run.lost == 0 else f'**{run.lost:,}: missed**'])} |"


def measure(node: Contestant, generator: object, options: Namespace) -> GeneratorRun:
    """Run one node alone for the time."""
    print_note(f"{node.name}: {options.minutes:g} minutes at {TARGET_HZ:g} Hz")
    with Field([node], generator, priority=options.priority) as field, Hogs(not options.quiet):
        return field.measure(node, GeneratorLoad(TARGET_HZ, 60.0 * options.minutes, 2.0))


def report(options: Namespace) -> Sequence[str]:
    parameters = [*options.parameters, *(RELIABLE if options.reliable else ())]
    generator, nodes = make_contestants(options.model, parameters)
    lines = [f"| {' | '.join(HEADER)} |", "|---|---:|---:|---:|---|" + "---:|" * (len(HEADER) - 5)]
    runs = {node.name: measure(node, generator, options) for node in nodes if node.is_observer}
    lines += [row(name, run) for name, run in runs.items()]
    late_ms = max(run.late_max_us for run in runs.values()) * 1e-3
    load = "on the quiet machine" if options.quiet else "with a hog on each core"
    quality = "reliable" if options.reliable else "best-effort"
    return [
        *lines,
        "",
        f"{options.minutes:g} minutes each at {TARGET_HZ:g} Hz {load}, {quality} inputs; the generator woke up at most "
        f"{late_ms:.1f} ms late. Parameters: {' '.join(options.parameters) or 'the defaults'}.",
        describe_machine(),
    ]


def main() -> None:
    parser = make_parser(__doc__)
    parser.add_argument("--minutes", type=float, default=10.0, help="for each node, default 10")
    parser.add_argument("--reliable", action="store_true", help="reliable inputs instead of best effort")
    parser.add_argument("--quiet", action="store_true", help="without hogs")
    options = parse(parser)
    try:
        print_report(report(options), options.write, "long run")
    except BuildError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
