"""The options of `ces identify` that choose a model's structure, its size and the candidates for its terms."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial, reduce
from pathlib import Path

from ces_cli.terminal import terminal
from ces_identify.identification import IdentificationResult, identify
from ces_identify.polynomial.constructed_options import add_blend, add_constructed_inputs
from ces_identify.polynomial.regressors import CandidateRules, load_rules
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, fit_best, fit_with_alternatives
from ces_identify.structures.kit import SizeOption
from ces_identify.structures.polynomial import POLYNOMIAL
from ces_observer.errors import CesError

CONSTRUCT_HELP = (
    "let terms use a constructed input: hysteresis:M,... (stroke since the last reversal, at most M metres), "
    "remanence:A,... (current with a hysteresis of A amperes), lag:S,... (current after a first-order lag of S "
    "seconds, or auto: estimated from the data), frequency or frequency:S (of the displacement, over S seconds); "
    "may be repeated"
)
BLEND_HELP = (
    "divide the terms into sub-models, one for each of these values of a signal, with blending in between, such as "
    "speed:-0.3,0.3; SIGNAL is position, speed, current or a constructed input such as valve; may be repeated"
)


def add_structure(to: argparse.ArgumentParser) -> None:
    """Add the option --structure, and those of each structure's sizes."""
    default, *_ = KITS
    about = ", ".join(f"{kit.option}: {kit.about}" for kit in KITS.values())
    text = f"{about}; {AUTO}: the best of short fits of all (default {default})"
    text += "; --candidates, --method and --terms apply to polynomials only"
    to.add_argument("--structure", choices=(*KITS, AUTO), default=default, help=text)
    for size in (size for kit in KITS.values() for size in kit.sizes):
        to.add_argument(
            f"--{size.name}",
            type=terminal.integer_between(*size.whole) if size.whole else partial(_check_text, size),
            default=size.default,
            metavar=size.metavar,
            help=f"{size.meaning} (default {size.default})",
        )


def add_candidates(to: argparse.ArgumentParser) -> None:
    """Add the options --candidates, --show-candidates, --construct and --blend."""
    to.add_argument("--candidates", type=Path, metavar="FILE", help="candidate rules (YAML; see --show-candidates)")
    to.add_argument("--show-candidates", action="store_true", help="print the built-in candidate rules and exit")
    to.add_argument("--construct", action="append", default=[], metavar="INPUT", help=CONSTRUCT_HELP)
    to.add_argument("--blend", action="append", default=[], metavar="SIGNAL:A,B,...", help=BLEND_HELP)


def select_identify_function(options: argparse.Namespace) -> Callable[..., IdentificationResult]:
    """Return the function that identifies the chosen structure: (recordings, validation, options, listener)."""
    if options.structure == AUTO:
        return partial(identify, fitter=fit_best(vars(options)))
    return partial(identify, fitter=fit_with_alternatives(options.structure, vars(options)))


def candidate_rules(options: argparse.Namespace) -> CandidateRules:
    """Return the candidate rules that the options describe; raises CesError naming the option or file at fault."""
    if options.structure not in (POLYNOMIAL.option, AUTO) and (options.construct or options.blend):
        raise CesError(f"--construct and --blend: apply to polynomials only, not to --structure {options.structure}")
    rules = reduce(add_constructed_inputs, options.construct, load_rules(options.candidates))
    return reduce(add_blend, options.blend, rules)


def _check_text(size: SizeOption, text: str) -> str:
    try:
        size.check(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text
