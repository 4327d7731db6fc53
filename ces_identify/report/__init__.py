"""The report: a model and its evaluations go in, one self-contained HTML page for screen and print comes out.

The page has no scripts and loads nothing; figures are inline SVG with the page's colours.
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
    """Write the page about `model` and its `evaluations` to `path`.

    `facts` appear under the title: date, command, noise floor and the like. A `weighting` adds the weighted J of each
    recording. Raises CesError if `path` cannot be written; an existing file then stays unchanged.
    """
    write_atomically(path, render(title, model, evaluations, facts, weighting))
