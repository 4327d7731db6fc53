"""Results of the programs, made once in a run of the tests and shared by all its processes. Read-only: copy to change.

`shared_model` is a folder after `ces identify`, `shared_gap` the same folder after `ces diagnose` (fixtures).
"""

from __future__ import annotations

import fcntl
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from small_recordings import RULES, make_columns, write_columns

SECONDS, RATE, COULOMB_N = 8.0, 250.0, 60.0
QUICK = ("--terms=4", "--starts=1", "--threads=1")


@dataclass(frozen=True)
class SharedResults:
    """A folder with bags `one` and `two`, and `worn` and `worn_again` with friction; rules.yaml; and what was made."""

    folder: Path

    @property
    def model(self) -> Path:
        """The model identified from `one`, validated on `two`."""
        return self.folder / "model.json"

    @property
    def report(self) -> Path:
        """The page of its identification."""
        return self.folder / "report.html"

    @property
    def gap(self) -> Path:
        """The folder of the diagnosis of `worn`, held out `worn_again`, with gap.json, augmented.json, report.html."""
        return self.folder / "gap"


def identify_once(factory: pytest.TempPathFactory) -> SharedResults:
    """Return the results with the model and its page."""
    return _once(factory, "shared_model", _identify)


def diagnose_once(factory: pytest.TempPathFactory) -> SharedResults:
    """Return the results with the diagnosis too."""
    identify_once(factory)
    return _once(factory, "shared_gap", _diagnose)


def common_folder(factory: pytest.TempPathFactory) -> Path:
    """Return the temporary folder of all processes of this run."""
    base = factory.getbasetemp()
    return base.parent if "PYTEST_XDIST_WORKER" in os.environ else base


def _once(factory: pytest.TempPathFactory, name: str, make: Callable[[SharedResults], None]) -> SharedResults:
    """Call `make` in the first process that asks; the others wait for it."""
    common = common_folder(factory)
    results = SharedResults(common / "shared_results")
    with (common / f"{name}.lock").open("a+") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (common / f"{name}.made").exists():
            make(results)
            (common / f"{name}.made").touch()
    return results


def _ces(*words: object) -> None:
    from ces_cli.main import main

    assert main([str(word) for word in words]) == 0


def _identify(results: SharedResults) -> None:
    results.folder.mkdir()
    (results.folder / "rules.yaml").write_text(RULES)
    for seed, name in enumerate(("one", "two", "worn", "worn_again"), start=1):
        t, columns = make_columns(SECONDS, seed, RATE)
        if name.startswith("worn"):
            columns["force"] += COULOMB_N * np.tanh(np.gradient(columns["position"], t) / 0.015)
        write_columns(results.folder / name, t, columns)
    words = ("--candidates", results.folder / "rules.yaml", "--out", results.model, "--report", results.report)
    _ces("identify", results.folder / "one", "--validate", results.folder / "two", *words, *QUICK)


def _diagnose(results: SharedResults) -> None:
    real = ("--real", results.folder / "worn", "--held-out", results.folder / "worn_again")
    words = ("--reference", results.folder / "two", "--out", results.gap, "--threads=1")
    _ces("diagnose", "--sim", results.model, *real, *words)
