"""Compares models on recordings and returns the page of the comparison."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from ces_identify.comparison.compared_model import make_compared_model, name_sources
from ces_identify.comparison.comparison import compare
from ces_identify.comparison.comparison_page import comparison_page
from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.checks import require_usable
from ces_identify.recordings.signals_file import load_signals
from ces_identify.simulations.simulation import ModelSimulation
from ces_observer.model import load_model

NEED = ("position", "current", "force")
WHOLE = (0.0, 1.0)


def compare_files(
    models: Sequence[str], bags: Sequence[str], signals: str | None, report: Callable[[str], None]
) -> str:
    """Return the page that compares model files on bags; raises CesError."""
    described = load_signals(Path(signals) if signals else None)
    recordings = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of stamps; the pages of the recordings show them
        for bag in bags:
            report(f"reading {Path(bag).name}")
            recordings.append(read_recording(Path(bag), described, NEED))
            require_usable(recordings[-1])
    report(f"running {len(models)} models on {len(bags)} recordings")
    compared = [
        make_compared_model(name, ModelSimulation(load_model(path)), path)
        for name, path in zip(name_sources(models), models, strict=True)
    ]
    comparison = compare(compared, recordings, WHOLE, timing=False)
    report("drawing the page")
    return comparison_page(comparison, facts={})
