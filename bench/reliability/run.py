"""Injects faults into a running observer for a quarter of an hour, and evaluates its estimates and diagnostics.

Needs a sourced ROS 2 (`python3 -m bench.reliability.run`): the observer is a separate process, observed over real DDS
on this computer, with a source at 1 kHz. Prints a table, one row for each report.
Exit status 1 if a rule was violated.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from math import isnan
from pathlib import Path
from random import Random

from bench.markdown import markdown
from bench.reliability.judge import FaultOutcome, check_bounds, faults
from ces_observer.model import load_model

SETTLED_S = 60.0
MAX_GROWTH_KB = 1024.0  # from the first minute to the end, by the slope


class Memory:
    """Samples VmRSS once a second in its own thread until `stop`; `kB` by `seconds` since the beginning."""

    def __init__(self, pid: int) -> None:
        self._status = Path(f"/proc/{pid}/status")
        self._stopped = threading.Event()
        self.seconds: list[float] = []
        self.kB: list[int] = []
        self._thread = threading.Thread(target=self._sample)
        self._thread.start()

    def stop(self) -> None:
        self._stopped.set()
        self._thread.join()

    def growth_kB(self) -> float | None:
        """Return the rise of a straight line fitted after the first minute; None if the run is too short."""
        pairs = [(s, kB) for s, kB in zip(self.seconds, self.kB, strict=True) if s >= SETTLED_S]
        if len(pairs) < SETTLED_S:
            return None
        mean_s, mean_kB = (sum(values) / len(pairs) for values in zip(*pairs, strict=True))
        slope = sum((s - mean_s) * (kB - mean_kB) for s, kB in pairs) / sum((s - mean_s) ** 2 for s, _ in pairs)
        return slope * (pairs[-1][0] - pairs[0][0])

    def _sample(self) -> None:
        began = time.monotonic()
        while not self._stopped.wait(1.0 - (time.monotonic() - began) % 1.0):
            try:
                lines = self._status.read_text(encoding="utf-8").splitlines()
            except OSError:
                return
            resident = next((line for line in lines if line.startswith("VmRSS")), None)
            if resident is None:  # a zombie has none
                return
            self.seconds.append(time.monotonic() - began)
            self.kB.append(int(resident.split()[1]))


ROOT = Path(__file__).resolve().parents[2]
HEADER = ("reported as", "fault", "worst recovery s", "worst error N")


class CampaignRecord:
    """The results of a campaign."""

    def __init__(self, seed: int) -> None:
        self.seed = seed
        self.outcomes: dict[str, list[FaultOutcome]] = {}
        self.wrong: list[str] = []
        self._facts = ""

    def add(self, outcome: FaultOutcome) -> None:
        """Add an outcome and print it."""
        self.outcomes.setdefault(outcome.fault, []).append(outcome)
        result = "; ".join(outcome.wrong) or "passed"
        print(f"{outcome.fault:34} {outcome.recovery_s:6.3f} s  {result}", file=sys.stderr, flush=True)

    def end(self, seconds: float, estimates: int, memory: Memory) -> None:
        """Record length, number of estimates and memory."""
        growth = memory.growth_kB()
        change = "too short for its growth" if growth is None else f"{growth:+.0f} kB after the first minute"
        if growth is not None and growth > MAX_GROWTH_KB:
            self.wrong.append(f"memory grew by {growth:.0f} kB, at most {MAX_GROWTH_KB:.0f} allowed")
        episodes = sum(map(len, self.outcomes.values()))
        self._facts = (
            f"{seconds / 60.0:.1f} minutes, seed {self.seed}: {episodes} episodes, {estimates:,} "
            f"estimates; resident memory {memory.kB[-1] / 1024.0:.1f} MB, {change}"
        )

    def is_bad(self) -> bool:
        return bool(self.wrong) or any(one.wrong for several in self.outcomes.values() for one in several)

    def lines(self) -> list[str]:
        """Return the page's lines: facts, failures and the table."""
        rows = _rows(dict(sorted(self.outcomes.items())))
        failed = [_describe_failure(name, several) for name, several in sorted(self.outcomes.items())]
        end = "The observer ended with status 0." if not self.wrong else f"**Wrong: {'; '.join(self.wrong)}.**"
        failures = "; ".join(filter(None, failed))
        verdict = f"**Failed**: {failures}; all others passed." if failures else "All passed."
        return [f"{self._facts}. {end} {verdict}", "", markdown([HEADER, *rows], left=2)]


def _rows(outcomes: Mapping[str, Sequence[FaultOutcome]]) -> list[tuple[str, ...]]:
    """Return a row for each report, with the faults that are reported so."""
    by_report: dict[str, dict[str, Sequence[FaultOutcome]]] = {}
    for name, several in outcomes.items():
        report = ", ".join(sorted({one.reason for one in several if one.reason})) or "**not**"
        by_report.setdefault(report, {})[name] = several
    return [_row(report, faulty) for report, faulty in sorted(by_report.items())]


def _row(report: str, outcomes: Mapping[str, Sequence[FaultOutcome]]) -> tuple[str, ...]:
    alike = [one for several in outcomes.values() for one in several]
    recovery_s, error_N = (_worst([getattr(one, what) for one in alike]) for what in ("recovery_s", "worst_error_N"))
    return report, "; ".join(outcomes), f"{recovery_s:.3f}", f"{error_N:,.0f}"


def _worst(values: list[float]) -> float:
    return max((value for value in values if not isnan(value)), default=float("nan"))


def _describe_failure(name: str, outcomes: list[FaultOutcome]) -> str:
    """Return which of the episodes failed and why; empty if none did."""
    bad = [one for one in outcomes if one.wrong]
    reasons = "; ".join(sorted({wrong for one in bad for wrong in one.wrong})[:3])
    return f"{name}, {len(bad)} of {len(outcomes)} times ({reasons})" if bad else ""


MODEL = ROOT / "config" / "models" / "sample.json"


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=15.0, help="length of the campaign [min], default 15")
    parser.add_argument("--seed", type=int, default=1, help="seed of order, times and random values, default 1")
    parser.add_argument("--model", type=Path, default=MODEL, help="default config/models/sample.json")
    parser.add_argument("--only", metavar="TEXT", help="only faults whose name contains this")
    options = parser.parse_args()
    if find_spec("rclpy") is None:
        parser.error("rclpy is missing; source ROS 2 and run this with its python3")
    return options


def main() -> int:
    options = parse_arguments()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    from bench.reliability.campaign import ObserverEndedError, make_limits, play, rounds, start_stage

    model = load_model(options.model)
    chosen = [one for one in faults(model.sampling.max_current_age_s) if not options.only or options.only in one.name]
    limits = make_limits(model)
    dice, record = Random(options.seed), CampaignRecord(options.seed)
    with tempfile.TemporaryDirectory() as folder, start_stage(model, Path(folder)) as stage:
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
    return 1 if record.is_bad() else 0


if __name__ == "__main__":
    sys.exit(main())
