"""An exported FMU as a SIM: simulated, and as teacher."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from needs import skip_without
from numpy.typing import NDArray
from programs import NO_SHORT_FITS, ces, text_of
from shared_results import SharedResults

from ces_observer.model import load_model

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def work(shared_model: SharedResults, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working folder, with the shared results and the model's FMU."""
    folder = tmp_path_factory.mktemp("work")
    for path in shared_model.folder.iterdir():
        (folder / path.name).symlink_to(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(*NO_SHORT_FITS)
        yield folder


@pytest.fixture(scope="module")
def fmu(work: Path) -> str:
    pytest.importorskip("fmpy")
    skip_without("cc")
    assert ces("export", "model.json", "--format", "fmu", "--out", "damper.fmu") == 0
    return "damper.fmu"


def simulate(sim: str, bag: str, out: Path) -> NDArray[np.float64]:
    """Return the forces [N] of a simulation at the position samples of a bag."""
    assert ces("simulate", "--sim", sim, bag, "--out", out, "--overwrite") == 0
    return np.array([float(row["force_N"]) for row in csv.DictReader(out.open())])


@pytest.mark.parametrize("names", ["", ":position=position,current=current,force=force"])
def test_simulate_returns_the_models_force(work: Path, fmu: str, tmp_path: Path, names: str) -> None:
    expected = simulate("model.json", "two", tmp_path / "model.csv")
    assert np.isfinite(expected).sum() > 1800
    np.testing.assert_allclose(simulate(f"{fmu}{names}", "two", tmp_path / "fmu.csv"), expected, rtol=1e-9, atol=1e-9)


def test_identify_learns_from_it(work: Path, fmu: str, tmp_path: Path) -> None:
    words = ("--candidates", "rules.yaml", "--terms", 4, "--starts", 1, "--threads", 1)
    assert ces("identify", "one", "--teacher", fmu, *words, "--no-band", "--out", tmp_path / "m.json") == 0
    (row, *_) = load_model(tmp_path / "m.json").provenance["teacher"]["cost_J_percent"]
    assert row["model_to_teacher"] < 2.0


def test_the_help_says_that_an_fmu_runs_native_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert "native code" in " ".join(text_of(capsys, "simulate", "--help").split())
