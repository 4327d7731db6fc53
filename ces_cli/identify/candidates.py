"""The candidate terms `ces identify` selects from: rules of a file, and short options that add to them."""

from __future__ import annotations

import argparse
from functools import reduce
from pathlib import Path

from ces_identify.polynomial.constructed_options import add_blend, add_constructed_inputs
from ces_identify.polynomial.regressors import CandidateRules, load_rules
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer.errors import CesError


def add_candidates(to: argparse.ArgumentParser) -> None:
    """Add the options --candidates, --show-candidates, --construct and --blend."""
    to.add_argument("--candidates", type=Path, metavar="FILE", help="candidate rules (YAML; see --show-candidates)")
    to.add_argument("--show-candidates", action="store_true", help="print the built-in candidate rules and exit")
    to.add_argument(
        "--construct",
        action="append",
        default=[],
        metavar="INPUT",
        help="let terms use a constructed input, too: hysteresis:M,... (stroke since the last reversal, up to so many "
        "metres), remanence:A,... (current behind a hysteresis of so many amperes), lag:S,... (current behind a "
        "first-order lag of so many seconds, or auto: found from the data), frequency or frequency:S (of the "
        "displacement, over so many seconds); may be repeated",
    )
    to.add_argument(
        "--blend",
        action="append",
        default=[],
        metavar="SIGNAL:A,B,...",
        help="let terms belong to sub-models, each alone at one of these values of a signal and blended between, such "
        "as speed:-0.3,0.3; of position, speed, current or a constructed input, as valve is; may be repeated",
    )


def candidate_rules(options: argparse.Namespace) -> CandidateRules:
    """Return the candidate rules asked for; raises CesError naming the option or file that is wrong."""
    if options.structure != POLYNOMIAL.option and (options.construct or options.blend):
        raise CesError(f"--construct and --blend: are of polynomials only, not of --structure {options.structure}")
    rules = reduce(add_constructed_inputs, options.construct, load_rules(options.candidates))
    return reduce(add_blend, options.blend, rules)
