"""The report: a model and its evaluations in, one self-contained HTML page out, for the screen and for paper.

The page loads nothing from elsewhere and runs no script; figures are inline SVG whose colours follow the page's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from ces_identify.preparation.weighting import EQUAL, Weighting
from ces_identify.report.page import render
from ces_identify.validation.evaluate import Evaluation
from ces_observer.json_checks import write_atomically
from ces_observer.model import Model

__all__ = ["write_report"]


def write_report(
    path: Path,
    title: str,
    model: Model,
    evaluations: Sequence[Evaluation],
    facts: Mapping[str, str],
    weighting: Weighting = EQUAL,
) -> None:
    """Write the page on how `model` does in `evaluations` to `path`.

    `facts` are shown under the title as they are: date, command, noise floor and the like. A `weighting` adds the
    weighted J of each recording. Raises CesError if `path`
    cannot be written, in which case what was there is left as it was.
    """
    write_atomically(path, render(title, model, evaluations, facts, weighting))
