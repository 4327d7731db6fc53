"""The benefit of constructed inputs and blended sub-models: the same search with and without, on sample recordings.

Usage: python bench/constructed_inputs.py [SECONDS [TERMS]]. Fits noise and sweep for so many seconds (default 40) with
so many terms (default 20), with each seed; prints the median over seeds of J in % as a table in Markdown.
"""

from __future__ import annotations

import sys
import warnings
from functools import reduce
from pathlib import Path

import numpy as np

from ces_identify.identification import identify
from ces_identify.polynomial.constructed_options import add_blend, add_constructed_inputs
from ces_identify.polynomial.regressors import CandidateRules, load_rules
from ces_identify.polynomial.search_limits import Limits
from ces_identify.recordings.bag_reader import RecordingWarning, read_recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.structures.kit import IdentifyOptions

BAGS = Path(__file__).resolve().parent.parent / "bags"
FITTED, JUDGED = ("noise", "sweep"), ("sine_4hz", "road")
SEEDS = (1, 101, 201)
ROWS: tuple[tuple[tuple[str, ...], tuple[str, ...]], ...] = (  # --construct, --blend
    ((), ()),
    (("hysteresis:0.0005,0.002",), ()),
    (("remanence:0.05",), ()),
    (("frequency",), ()),
    ((), ("current:0.3,0.5,0.69",)),
    ((), ("speed:-0.3,0.3",)),
    (("remanence:0.05",), ("speed:-0.3,0.3",)),
)


def rules_of(constructed: tuple[str, ...], blends: tuple[str, ...]) -> CandidateRules:
    """Return the built-in rules with these options."""
    return reduce(add_blend, blends, reduce(add_constructed_inputs, constructed, load_rules(None)))


def costs(rules: CandidateRules, seconds: float, terms: int, seed: int) -> list[float]:
    """Return J [%] on the fitting and on the evaluation recordings, then number of terms and proved gain."""
    signals = load_signals(None)
    fitted, judged = ([read_recording(BAGS / name, signals) for name in names] for names in (FITTED, JUDGED))
    limits = Limits(terms, seconds, 0.0, 2, seed, 2)
    found = identify(fitted, judged, IdentifyOptions(1.0, rules, limits))
    assert found.model.certificate is not None
    return [*(e.cost for e in found.evaluations), len(found.model.body.terms), found.model.certificate["gain"]]


def main() -> None:
    """Print the table."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 40.0
    terms = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    warnings.simplefilter("ignore", RecordingWarning)
    print(f"| options | candidates | {' | '.join((*FITTED, *JUDGED))} | terms | gain |")
    print("|---" * 8 + "|")
    for constructed, blends in ROWS:
        rules = rules_of(constructed, blends)
        rows = np.median([costs(rules, seconds, terms, seed) for seed in SEEDS], axis=0)
        options = " ".join((*(f"--construct {c}" for c in constructed), *(f"--blend {b}" for b in blends)))
        name = f"`{options}`" if options else "none"
        cells = [name, str(rules.count()), *(f"{j:.2f}" for j in rows[:4]), f"{rows[4]:.0f}", f"{rows[5]:.3f}"]
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
