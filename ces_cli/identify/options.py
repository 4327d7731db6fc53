"""The options of `ces identify`."""

from __future__ import annotations

from pathlib import Path

from ces_cli.terminal.options import BAGS_FORM, JOBS, JSON, OVERWRITE, REPORT, SIGNALS
from ces_identify.options import POLYNOMIALS, list_options
from ces_observer.options import Option, in_group

VALIDATE = Option(
    "validate", (), f"recordings for validation only: {BAGS_FORM}", kind=Path, metavar="BAG", together=True
)
OUT = Option("out", Path("model.json"), "model file to write; its folder must exist", metavar="FILE")
OPTIONS = (
    *(VALIDATE, SIGNALS, OUT, REPORT),
    *list_options(),
    *(OVERWRITE, JSON),
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
