"""The model structures `ces identify` can choose from, and the options that size them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial

from ces_cli.terminal import terminal
from ces_identify.identification import IdentificationResult, identify
from ces_identify.structures import KITS
from ces_identify.structures.kit import SizeOption


def add_structure(to: argparse.ArgumentParser) -> None:
    """Add the option --structure, and those of each structure's sizes."""
    default, *_ = KITS
    about = ", ".join(f"{kit.option}: {kit.about}" for kit in KITS.values())
    to.add_argument(
        "--structure",
        choices=tuple(KITS),
        default=default,
        help=f"{about} (default {default}); --candidates, --method and --terms are of polynomials only",
    )
    for size in (size for kit in KITS.values() for size in kit.sizes):
        to.add_argument(
            f"--{size.name}",
            type=terminal.integer_between(*size.whole) if size.whole else partial(_check_text, size),
            default=size.default,
            metavar=size.metavar,
            help=f"{size.meaning} (default {size.default})",
        )


def select_identify_function(options: argparse.Namespace) -> Callable[..., IdentificationResult]:
    """Return the function that identifies the structure chosen: (recordings, validation, options, listener)."""
    return partial(identify, fitter=KITS[options.structure].fitter(vars(options)))


def _check_text(size: SizeOption, text: str) -> str:
    try:
        size.check(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text
