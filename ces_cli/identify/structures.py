"""The model structures `ces identify` can choose from, and the options that size them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from ces_cli.terminal import terminal
from ces_identify.identify import Identified, identify
from ces_identify.identify_trained import FuzzyShape, NetworkShape, identify_anfis, identify_network

POLYNOMIAL, SIGMOID, ANFIS = "polynomial", "sigmoid", "anfis"
MOST_RULES = 60


def add_structure(to: argparse.ArgumentParser) -> None:
    """Add the options --structure, --units and --rules."""
    to.add_argument(
        "--structure",
        choices=(POLYNOMIAL, SIGMOID, ANFIS),
        default=POLYNOMIAL,
        help="polynomial NARX (default), sigmoid network NARX, or neuro-fuzzy rules; --candidates, --method and "
        "--terms are of polynomials only",
    )
    to.add_argument(
        "--units", type=terminal.whole(1, 60), default=NetworkShape().units, metavar="N", help="sigmoids (default 10)"
    )
    to.add_argument(
        "--rules",
        type=grid,
        default=(FuzzyShape().speeds, FuzzyShape().currents),
        metavar="VxI",
        help="neuro-fuzzy memberships of speed and of current, each combination a rule (default 7x2)",
    )


def grid(text: str) -> tuple[int, int]:
    """Read `VxI`, two numbers of memberships."""
    speeds, _, currents = text.partition("x")
    if not (speeds.isdecimal() and currents.isdecimal() and int(speeds) >= 2 and int(currents) >= 1):
        raise argparse.ArgumentTypeError(f"'{text}' is not VxI, such as 7x2: at least 2 of speed and 1 of current")
    if int(speeds) * int(currents) > MOST_RULES:
        raise argparse.ArgumentTypeError(f"'{text}' makes {int(speeds) * int(currents)} rules; at most {MOST_RULES}")
    return int(speeds), int(currents)


def identifier(options: argparse.Namespace) -> Callable[..., Identified]:
    """Return the function that identifies the structure chosen: (recordings, validation, options, listener)."""
    if options.structure == SIGMOID:
        return partial(identify_network, shape=NetworkShape(units=options.units))
    if options.structure == ANFIS:
        return partial(identify_anfis, shape=FuzzyShape(speeds=options.rules[0], currents=options.rules[1]))
    return identify
