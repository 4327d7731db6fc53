"""Latency from stamp to received estimate, loss and CPU of the observer, compared with empty relays.

Needs a sourced ROS 2 (`python3 bench/live/bench_live.py`). The relays are in Python and C++. All nodes run side by
side; a generator loads one after the other, in interleaved rounds, so that other load of the machine affects all
equally. `--minutes 10` adds a long run of the observer at 1 kHz, `--write` writes everything into docs/benchmarks.md.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

from contestants import (
    CPP_RELAYS,
    PYTHON_RELAYS,
    ROOT,
    Contestant,
    Field,
    GeneratorLoad,
    GeneratorRun,
    build_cpp,
    cpp_relays,
    observer,
    print_note,
    python_relays,
)
from figures import median_range, row, targets

sys.path.insert(0, str(ROOT))
from bench.markdown import replace_between
from bench.measurement import processor
from ces_observer.model import load_model

PAGE = ROOT / "docs" / "benchmarks.md"
MODEL = ROOT / "config" / "models" / "sample.json"
TARGET_HZ = 1000.0
HEADER = ("rate Hz", "node", "median µs", "p99 µs", "worst ms", "CPU % of a core", "lost")
RATIOS = ("median ÷ C++", "CPU ÷ C++", "p99 ÷ same executor's relay")
OBSERVER = "**observer**"
ORDINARY = "observer, rclpy.spin"
Key = tuple[float, str]


def contestants(folder: Path, has_cpp: bool, model: Path) -> list[Contestant]:
    observers = [
        observer(OBSERVER, model, PYTHON_RELAYS["raw"]),
        observer(ORDINARY, model, PYTHON_RELAYS["single"], "executor:=single"),
    ]
    return [*(cpp_relays(folder) if has_cpp else []), *python_relays(), *observers]


def play(
    field: Field, nodes: Sequence[Contestant], rates: Sequence[float], load: GeneratorLoad, rounds: int
) -> dict[Key, list[GeneratorRun]]:
    """Return the runs of each node at each rate, one per round."""
    runs: dict[Key, list[GeneratorRun]] = {(rate, node.name): [] for rate in rates for node in nodes}
    for number in range(rounds):
        for rate in rates:
            print_note(f"round {number + 1} of {rounds}, {rate:g} Hz")
            for node in nodes:
                runs[rate, node.name].append(field.measure(node, replace(load, rate_Hz=rate)))
    return runs


def table(found: dict[Key, list[GeneratorRun]], nodes: Sequence[Contestant]) -> list[str]:
    head = [*HEADER, *RATIOS]
    lines = [f"| {' | '.join(head)} |", "|---:|---|" + "---:|" * (len(head) - 2)]
    twins = {node.name: node.baseline for node in nodes}
    for (rate, name), runs in found.items():
        cpp, same = found.get((rate, CPP_RELAYS["single"])), found.get((rate, twins[name]))
        lines.append(f"| {' | '.join(row(name, rate, runs, cpp, same))} |")
    return lines


def verdicts(found: dict[Key, list[GeneratorRun]], baseline: str) -> list[str]:
    runs, cpp = found.get((TARGET_HZ, OBSERVER)), found.get((TARGET_HZ, CPP_RELAYS["single"]))
    if runs is None or cpp is None:
        return ["* no verdict: 1000 Hz was not requested, or there is no C++ relay for comparison"]
    return targets(runs, cpp, found[TARGET_HZ, baseline])


def long_run(field: Field, node: Contestant, load: GeneratorLoad, minutes: float) -> str:
    """Run the observer for a long time; return a line with lost samples and memory."""
    print_note(f"{minutes:g} minutes at {TARGET_HZ:g} Hz")
    before = field.resident_kB(node)
    run = field.measure(node, replace(load, rate_Hz=TARGET_HZ, seconds=60.0 * minutes))
    verdict = "met" if run.lost == 0 else "**missed**"
    memory = f"memory {before / 1024:.1f} MB before, {field.resident_kB(node) / 1024:.1f} MB after"
    return (
        f"* {minutes:g} minutes at {TARGET_HZ:g} Hz: {run.lost:,} of {run.sent:,} lost, target none: {verdict} "
        f"({run.after_pause:,} more while warming up after pauses of the generator itself); median "
        f"{run.p50_us:.0f} µs, p99 {run.p99_us:.0f} µs, worst {run.max_us * 1e-3:.1f} ms, "
        f"CPU {100 * run.cpu_share:.1f} %; {memory}"
    )


def noise(found: dict[Key, list[GeneratorRun]], load: GeneratorLoad, rounds: int, began: float) -> str:
    """Return a description of the load and of the machine's disturbances."""
    runs = [run for several in found.values() for run in several]
    where = "midway between two positions" if load.current_apart else "right after the position"
    each = "each" if load.current_every == 1 else f"every {load.current_every}th"
    return (
        f"{rounds} rounds of {load.seconds:g} s each after {load.warm_up_s:g} s of warm-up: median over the rounds, "
        f"in brackets their range. A current follows {each} position, published {where}. The generator itself woke "
        f"up {median_range(runs, 'late_p50_us').text()} µs late in the median and "
        f"{median_range(runs, 'late_p99_us').text()} µs at its p99. "
        f"Load of the machine {began:.1f} at the beginning, {os.getloadavg()[0]:.1f} at the end."
    )


def report(options: argparse.Namespace, folder: Path) -> list[str]:
    has_cpp = build_cpp(folder)
    nodes = contestants(folder, has_cpp, options.model)
    generator = (
        [str(folder / "generator")] if has_cpp else [sys.executable, str(Path(__file__).with_name("generator.py"))]
    )
    sampling = load_model(options.model).sampling
    after_gap_s = sampling.warm_up_s + 2.0 * sampling.max_gap_s
    currents = options.current_every, options.current_apart
    load = GeneratorLoad(TARGET_HZ, options.seconds, options.warm_up, *currents, sampling.max_gap_s, after_gap_s)
    began = os.getloadavg()[0]
    with Field(nodes, generator) as field:
        found = play(field, nodes, options.rates, load, options.rounds)
        whole = next(node for node in nodes if node.name == OBSERVER)
        lines = [*table(found, nodes), "", *verdicts(found, whole.baseline)]
        if options.minutes:
            lines.append(long_run(field, whole, load, options.minutes))
    return [*lines, "", noise(found, load, options.rounds, began), machine()]


def machine() -> str:
    import rclpy

    rclpy.init()
    middleware = rclpy.get_rmw_implementation_identifier()
    rclpy.shutdown()
    versions = f"ROS 2 {os.environ.get('ROS_DISTRO')}, {middleware}, Python {sys.version.split()[0]}"
    return f"{processor()}, {len(os.sched_getaffinity(0))} cores; {versions}."


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rates", type=float, nargs="+", default=[200.0, 500.0, 1000.0, 2000.0], metavar="HZ")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a run [s], default 5")
    parser.add_argument("--warm-up", type=float, default=2.0, help="before each run, not counted [s], default 2")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each node at each rate, default 5")
    parser.add_argument(
        "--minutes", type=float, default=0.0, help="length of a long run of the observer at 1 kHz [min]"
    )
    parser.add_argument("--model", type=Path, default=MODEL, help="default config/models/sample.json")
    parser.add_argument("--current-every", type=int, default=1, metavar="N", help="positions per current, default 1")
    parser.add_argument("--current-apart", action="store_true", help="publish the current between two positions")
    parser.add_argument("--write", action="store_true", help=f"write the result into docs/{PAGE.name}")
    options = parser.parse_args()
    if find_spec("rclpy") is None:
        parser.error("rclpy is missing; source ROS 2 and run this with its python3")
    if not options.model.is_file():
        parser.error(f"{options.model}: no such model file; pass one from `ces identify` with --model")
    return options


def main() -> None:
    options = parse_arguments()
    options.model = options.model.resolve()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with tempfile.TemporaryDirectory() as folder:
        lines = report(options, Path(folder))
    print("\n".join(lines))
    if options.write:
        replace_between(PAGE, "live", "\n".join(lines))


if __name__ == "__main__":
    main()
