"""The options of `ces identify`: the program has all, the node `identify` those that it shares, as parameters."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ces_cli.terminal.options import BAGS_FORM, JOBS, JSON, OVERWRITE, REPORT, SIGNALS
from ces_identify.options import POLYNOMIALS, list_options
from ces_observer.errors import CesError
from ces_observer.options import Option, as_parameter, command_words, in_group

BAGS = Option("bags", (), f"recordings with a measured force: {BAGS_FORM}", kind=Path, metavar="BAG", together=True)
VALIDATE = Option(
    "validate", (), f"recordings for validation only: {BAGS_FORM}", kind=Path, metavar="BAG", together=True
)
OUT = Option("out", Path("model.json"), "model file to write; its folder must exist", metavar="FILE")
OF_THE_PROGRAM = (
    JSON,
    Option(
        "show_candidates",
        False,
        "print the built-in candidate rules (with --method thesis, those of the thesis) and exit",
        group=POLYNOMIALS,
    ),
    *in_group(
        "many identifications",
        Option(
            "folds",
            0,
            "cross-validate, too: hold out each of K folds of the BAGs once (K = number of BAGs: one at a time); a "
            "single BAG is cut into K stretches. Takes K times as long again; 0: off",
            0,
            1000,
            metavar="K",
        ),
        Option(
            "campaign",
            None,
            "identify every combination that FILE.yaml describes and compare them; --out is then a folder, and the "
            "same command continues an interrupted run",
            kind=Path,
            metavar="FILE.yaml",
        ),
        JOBS,
    ),
)


def list_shared() -> tuple[Option, ...]:
    """Return the options that program and node share."""
    return (VALIDATE, SIGNALS, OUT, REPORT, *list_options(), OVERWRITE)


SHARED = list_shared()
PARAMETERS = tuple(as_parameter(option) for option in (BAGS, *SHARED))
EXIT_WHEN_DONE = Option("exit_when_done", False, "end after publishing the costs of the model")


def build_command_line(values: Mapping[str, Any]) -> list[str]:
    """Return the command line of `ces identify` for these parameter values; raises CesError naming the parameter."""
    bags = command_words([BAGS], values)[1:]
    if not bags:
        raise CesError(
            "parameter 'bags' is not set; set it to the paths of recordings: -p bags:='[bags/noise, bags/sweep]'"
        )
    return [*command_words(SHARED, values), "--", *bags]
