"""The long run: seeded random inputs to the estimator and the readers of model and signals files; prints a table.

    python -m bench.fuzz.fuzz --samples 1200000 --files 100000 --jobs 1

Exit status 1 if an input broke a promise (see fuzz_targets.py); such inputs are saved in out/fuzz.
"""

from __future__ import annotations

import argparse
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from math import ceil
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from bench.fuzz.fuzz_samples import samples, spoil_bytes, spoil_model
from bench.fuzz.fuzz_targets import FORCE, try_damper, try_estimator, try_model, try_signals
from ces_observer.estimator import Estimator
from ces_observer.model import load_model

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent

SEEDS = HERE / "seeds"
FAILURES_DIR = ROOT / "out" / "fuzz"
BATCH_FILES, BATCH_SAMPLES = 500, 5_000
DICTIONARY = tuple(
    line[1:-1].encode().decode("unicode_escape").encode("latin-1")
    for line in (HERE / "signals.dict").read_text().splitlines()
)


@dataclass
class FuzzTally:
    """Inputs by outcome, the slowest time, and the inputs that broke a promise."""

    outcomes: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    broken: list[str] = field(default_factory=list)

    def add(self, other: FuzzTally) -> None:
        self.outcomes += other.outcomes
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.broken += other.broken


def fuzz_files(
    spoil: Callable[[bytes, Random], bytes], target: Callable[[Path], str], name: str, seed: int
) -> FuzzTally:
    """Corrupt the seeds of `name` BATCH_FILES times and pass each file to `target`."""
    random, tally = Random(f"{name} {seed}"), FuzzTally()
    raws = [path.read_bytes() for path in sorted((SEEDS / name).iterdir())]
    with TemporaryDirectory() as folder:
        path = Path(folder) / name
        for _ in range(BATCH_FILES):
            path.write_bytes(spoil(random.choice(raws), random))
            start = time.perf_counter()
            try:
                tally.outcomes[target(path)] += 1
            except Exception:
                tally.broken.append(_keep(name, path.read_bytes(), seed))
            tally.slowest_s = max(tally.slowest_s, time.perf_counter() - start)
    return tally


def fuzz_estimator(seed: int) -> FuzzTally:
    """Feed BATCH_SAMPLES samples to the estimator of a model, every other time through the whole damper observer."""
    random, tally = Random(f"samples {seed}"), FuzzTally()
    models = [load_model(path) for path in sorted((SEEDS / "model").iterdir())]
    model = models[seed % len(models)]
    fed = list(samples(random, BATCH_SAMPLES))
    start = time.perf_counter()
    try:
        if seed // len(models) % 2:
            tally.outcomes.update(try_damper(model, fed, random.choice((0.0, 0.5))))
        else:
            tally.outcomes.update(try_estimator(Estimator(model), fed))
    except Exception:
        tally.broken.append(_keep("samples", b"", seed))
    tally.slowest_s = (time.perf_counter() - start) / BATCH_SAMPLES
    return tally


def _keep(name: str, raw: bytes, seed: int) -> str:
    FAILURES_DIR.mkdir(parents=True, exist_ok=True)
    path = FAILURES_DIR / f"{name}-{seed}-{abs(hash(raw)) % 10**8}"
    path.write_bytes(raw)
    path.with_suffix(".txt").write_text(traceback.format_exc(), errors="backslashreplace")
    return ascii(f"{path}: {traceback.format_exc().splitlines()[-1]}")


TARGETS: dict[str, Callable[[int], FuzzTally]] = {
    "model files": partial(fuzz_files, spoil_model, try_model, "model"),
    "signals files": partial(fuzz_files, partial(spoil_bytes, clauses=DICTIONARY), try_signals, "signals"),
    "samples to the estimator": fuzz_estimator,
}


def run(name: str, seeds: range, jobs: int) -> FuzzTally:
    """Run a target's batches in `jobs` processes."""
    total = FuzzTally()
    with ProcessPoolExecutor(jobs) as pool:
        for tally in pool.map(TARGETS[name], seeds):
            total.add(tally)
            for broken in tally.broken:
                print(f"BROKEN: {broken}", flush=True)
    return total


def row(name: str, total: FuzzTally, seconds: float) -> str:
    """Return a row of the table."""
    count = total.outcomes.total() + len(total.broken)
    taken = sum(total.outcomes[key] for key in (FORCE, "read"))
    return (
        f"| {name} | {count:,} | {taken:,} | {count - taken:,} | {len(total.broken)} | {total.slowest_s * 1e3:.1f} "
        f"| {seconds:.0f} |"
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--samples", type=int, default=1_200_000, help="samples for the estimator")
    parser.add_argument("--files", type=int, default=100_000, help="files for each reader")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--seed", type=int, default=0, help="first batch")
    options = parser.parse_args()
    broken = 0
    print("| inputs | count | used | refused or withheld | promises broken | slowest [ms] | time [s] |")
    print("|---|---:|---:|---:|---:|---:|---:|", flush=True)
    for name in TARGETS:
        wanted = options.samples / BATCH_SAMPLES if name.startswith("samples") else options.files / BATCH_FILES
        batches = ceil(wanted)
        start = time.perf_counter()
        total = run(name, range(options.seed, options.seed + batches), options.jobs)
        print(row(name, total, time.perf_counter() - start), flush=True)
        broken += len(total.broken)
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
