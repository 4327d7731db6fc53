"""The options of `ces identify` that choose a model's structure, its size and the candidates for its terms."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial, reduce
from pathlib import Path
from typing import Any

from ces_cli.terminal import terminal
from ces_cli.terminal.option_rules import ALL, OptionRule, never_with
from ces_identify.identification import IdentificationResult, identify
from ces_identify.polynomial.constructed_options import add_blend, add_constructed_inputs
from ces_identify.polynomial.regressors import CandidateRules, load_rules
from ces_identify.polynomial.search_limits import BOTH, METHODS
from ces_identify.structures import KITS
from ces_identify.structures.auto import AUTO, select_fitter
from ces_identify.structures.kit import SizeOption, StructureKit
from ces_identify.structures.polynomial import POLYNOMIAL

METHOD_HELP = (
    "search method: random forward selection, Gauss-Newton selection, or starts of both kinds (default); thesis: the "
    "procedure and the candidates of the thesis to the letter, for comparison, where nothing keeps a model stable"
)
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


def _rule_of(kit: StructureKit[Any], names: str) -> OptionRule:
    reason = f"applies to --structure {kit.option} or {AUTO}, not to {{structure}}; remove it"
    return OptionRule(names, lambda options: options.structure in (kit.option, AUTO), reason)


STRUCTURE_RULES = (
    never_with(ALL, "show_candidates", "does not apply with --show-candidates", but="show_candidates method"),
    _rule_of(POLYNOMIAL, "method candidates construct blend terms"),
    *(_rule_of(kit, " ".join(size.name for size in kit.sizes)) for kit in KITS.values()),
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
    """Add the options --method, --candidates, --show-candidates, --construct and --blend."""
    to.add_argument("--method", choices=METHODS, default=BOTH, help=METHOD_HELP)
    to.add_argument("--candidates", type=Path, metavar="FILE", help="candidate rules (YAML; see --show-candidates)")
    text = "print the built-in candidate rules (with --method thesis, those of the thesis) and exit"
    to.add_argument("--show-candidates", action="store_true", help=text)
    to.add_argument("--construct", action="append", default=[], metavar="INPUT", help=CONSTRUCT_HELP)
    to.add_argument("--blend", action="append", default=[], metavar="SIGNAL:A,B,...", help=BLEND_HELP)


def select_identify_function(options: argparse.Namespace) -> Callable[..., IdentificationResult]:
    """Return the function that identifies the chosen structure: (recordings, validation, options, listener)."""
    return partial(identify, fitter=select_fitter(options.structure, vars(options)))


def candidate_rules(options: argparse.Namespace) -> CandidateRules:
    """Return the candidate rules that the options describe; raises CesError naming the option or file at fault."""
    rules = reduce(add_constructed_inputs, options.construct, load_rules(options.candidates, options.method))
    return reduce(add_blend, options.blend, rules)


def _check_text(size: SizeOption, text: str) -> str:
    try:
        size.check(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text
