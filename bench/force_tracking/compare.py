"""The benefit of the observer: how well the force follows its curve with and without feedback on changed plants.

Usage: python -m bench.force_tracking.compare [--seeds 5] [--seconds 15] [--jobs 1] [--write-docs]
On every plant, seed and stroke runs the loop with the inverse of the sample model alone (feed-forward), with feedback
from the estimate, and from the measured force; then again with a model re-identified on the changed plant. Results
are saved in out/force_tracking.json; --write-docs writes table and picture into docs/, with --kept from saved results.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

import bench.blas_one_thread  # noqa: F401  # before numpy
from bench.force_tracking.cases import CASES, STROKES, TrackingCase, identify_again, with_effect
from bench.force_tracking.loop import Design, TrackedRun, TrackingResult, track
from bench.force_tracking.plot import draw
from bench.markdown import replace_between
from ces_observer.model import load_model

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "config" / "models" / "sample.json"
RESULTS_FILE = ROOT / "out" / "force_tracking.json"
PAGE = ROOT / "docs" / "results.md"
PICTURE = ROOT / "docs" / "img" / "force_tracking.png"
WAYS = {
    "none": "feed-forward alone",
    "estimate": "feedback from the estimate",
    "measured": "feedback from the measured force",
    "anew none": "re-identified: feed-forward alone",
    "anew estimate": "re-identified: feedback from the estimate",
}
SHOWN_S = 4.0, 5.0  # of the first run, in the picture


def main() -> None:
    options = _options()
    figures = _load_results() if options.kept else _run_all(options)
    if options.write_docs:
        shown = {way: run("noise stroke", CASES[0], 0, way, 8.0) for way in ("none", "estimate")}
        draw(figures, WAYS, shown, SHOWN_S, PICTURE)
        replace_between(PAGE, "force tracking", table(figures))
    print(table(figures))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="runs of each kind")
    parser.add_argument("--seconds", type=float, default=15.0, help="length of a run")
    parser.add_argument("--starts", type=int, default=1, help="starts of each identification")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--kept", action="store_true", help="use the saved results of the last run, measure nothing")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results.md and its picture")
    return parser.parse_args()


def _run_all(options: argparse.Namespace) -> list[TrackingResult]:
    tasks = [(case, seed) for seed in range(options.seeds) for case in CASES]
    work = (delayed(_run_case)(case, seed, options.seconds, options.starts) for case, seed in tasks)
    figures = [figure for several in Parallel(n_jobs=options.jobs)(work) for figure in several]
    RESULTS_FILE.parent.mkdir(exist_ok=True)
    RESULTS_FILE.write_text(json.dumps([asdict(figure) for figure in figures], indent=1), encoding="utf-8")
    return figures


def _load_results() -> list[TrackingResult]:
    return [TrackingResult(**one) for one in json.loads(RESULTS_FILE.read_text(encoding="utf-8"))]


def _run_case(case: TrackingCase, seed: int, seconds: float, starts: int) -> list[TrackingResult]:
    return list(_iterate_results(case, seed, seconds, starts))


def _iterate_results(case: TrackingCase, seed: int, seconds: float, starts: int) -> Iterator[TrackingResult]:
    """Re-identify only where the plant itself has changed."""
    withheld = case.draw_effect(seed)
    designs = {"": _sample()}
    if withheld is not None:
        designs["anew "] = Design.from_model(identify_again(withheld, seed, starts))
    for stroke, settings in STROKES.items():
        for way in WAYS:
            prefix, feedback = ("anew ", way[5:]) if way.startswith("anew ") else ("", way)
            if prefix in designs:
                rig = with_effect(settings, withheld, seed)
                tracked = track(rig, designs[prefix], feedback, seconds, case.driver)
                reachable = float(np.mean(tracked.reachable))
                figure = TrackingResult(case.name, stroke, way, seed, tracked.J, tracked.rms_N, reachable)
                print(figure, file=sys.stderr, flush=True)
                yield figure


def run(stroke: str, case: TrackingCase, seed: int, feedback: str, seconds: float) -> TrackedRun:
    """Return one run with the sample model."""
    return track(with_effect(STROKES[stroke], case.draw_effect(seed), seed), _sample(), feedback, seconds, case.driver)


@cache
def _sample() -> Design:
    return Design.from_model(load_model(SAMPLE))


def table(figures: Sequence[TrackingResult]) -> str:
    """Return the medians over seeds, with the smallest and largest of them, as a Markdown table for each stroke."""
    return "\n\n".join(_table(stroke, [f for f in figures if f.stroke == stroke]) for stroke in STROKES)


def _table(stroke: str, figures: Sequence[TrackingResult]) -> str:
    lines = [f"| {stroke}: J % (RMS N) | {' | '.join(WAYS.values())} |", f"|---|{'---:|' * len(WAYS)}"]
    for case in CASES:
        cells = [_cell([f for f in figures if (f.case, f.way) == (case.name, way)]) for way in WAYS]
        lines.append(f"| {case.name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(figures: Sequence[TrackingResult]) -> str:
    if not figures:
        return "-"
    costs = [figure.J for figure in figures]
    middle, rms = np.median(costs), np.median([figure.rms_N for figure in figures])
    return f"{middle:.1f} [{min(costs):.1f}-{max(costs):.1f}] ({rms:.0f} N)"


if __name__ == "__main__":
    main()
