"""An exported FMU as a SIM: simulated, as teacher, and diagnosed; and what a diagnosis writes, replayed."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from needs import skip_without
from numpy.typing import NDArray
from programs import NO_SHORT_FITS, ces, only_effects, text_of
from schema_rules import faults
from shared_results import COULOMB_N, SharedResults

from ces_data.bags.reader import read_recording
from ces_observer.model import load_model
from ces_observer.signals import Signals

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def work(shared_gap: SharedResults, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """The working folder, with the shared results and the model's FMU."""
    folder = tmp_path_factory.mktemp("work")
    for path in shared_gap.folder.iterdir():
        (folder / path.name).symlink_to(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(*NO_SHORT_FITS)
        patch.setattr(*only_effects("friction", "leakage", "force_scale"))
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


def gap_left(augmented: str, bag: str, out: Path, noise_N: float) -> float:
    """Return the gap [N] of an augmented simulation on a bag, with noise subtracted."""
    measured = read_recording(Path(bag), Signals.from_mapping({}, "test")).channel("force").values
    gap = (measured - simulate(augmented, bag, out))[125:-50]
    assert np.isfinite(gap).mean() > 0.95
    return float(np.sqrt(max(np.nanmean(gap**2) - noise_N**2, 0.0)))


@pytest.mark.parametrize("names", ["", ":position=position,current=current,force=force"])
def test_simulate_returns_the_models_force(work: Path, fmu: str, tmp_path: Path, names: str) -> None:
    expected = simulate("model.json", "two", tmp_path / "model.csv")
    assert np.isfinite(expected).sum() > 1800
    np.testing.assert_allclose(simulate(f"{fmu}{names}", "two", tmp_path / "fmu.csv"), expected, rtol=1e-9, atol=1e-9)


def test_identify_learns_from_it(work: Path, fmu: str, tmp_path: Path) -> None:
    words = ("--candidates", "rules.yaml", "--terms", 4, "--starts", 1, "--method", "gauss-newton", "--threads", 1)
    assert ces("identify", "one", "--teacher", fmu, *words, "--no-band", "--out", tmp_path / "m.json") == 0
    (row, *_) = load_model(tmp_path / "m.json").provenance["teacher"]["cost_J_percent"]
    assert row["model_to_teacher"] < 2.0


@pytest.fixture(scope="module", params=["model.json", "damper.fmu"])
def diagnosed(request: pytest.FixtureRequest, work: Path) -> tuple[str, dict[str, Any]]:
    """The folder of a diagnosis and its gap.json: of the model with all effects, and of the FMU."""
    folder = "gap"
    if request.param == "damper.fmu":
        request.getfixturevalue("fmu")
        folder = "fmu_gap"
        words = ("--real", "worn", "--held-out", "worn_again", "--reference", "two", "--threads", 1, "--out", folder)
        assert ces("diagnose", "--sim", request.param, *words) == 0
    return folder, json.loads(Path(folder, "gap.json").read_text())


def test_friction_is_named(diagnosed: tuple[str, dict[str, Any]]) -> None:
    _, gap = diagnosed
    assert faults(gap) == []
    assert (gap["verdict"], gap["composition"]["effects"]) == ("named", ["friction"])
    assert gap["gap"]["corrected_N"] == pytest.approx(0.95 * COULOMB_N, rel=0.1)
    assert gap["causes"][0]["probability"] > 0.8
    assert gap["composition"]["shrink"] > 0.8


def test_the_augmented_simulation_closes_the_gap_as_claimed(
    work: Path, diagnosed: tuple[str, dict[str, Any]], tmp_path: Path
) -> None:
    """Also around predictions that were recorded."""
    folder, gap = diagnosed
    claimed, noise_N = gap["composition"]["gap_after_N"], gap["gap"]["noise_floor_N"]
    left = gap_left(f"{folder}/augmented.json", "worn_again", tmp_path / "a.csv", noise_N)
    assert left == pytest.approx(claimed, abs=0.1 * COULOMB_N)
    document = json.loads(Path(folder, "augmented.json").read_text())
    assert Path(folder, document["sim"]["spec"]).resolve() == Path(Path(gap["simulation"]).name).resolve()
    assert ces("replay", "model.json", "worn_again", "--out", "predicted", "--overwrite") == 0
    sim = {"spec": "topic:/observer/estimate", "sha256": None}
    (tmp_path / "augmented.json").write_text(json.dumps({**document, "sim": sim}))
    left = gap_left(str(tmp_path / "augmented.json"), "predicted", tmp_path / "p.csv", noise_N)
    assert left == pytest.approx(claimed, abs=0.1 * COULOMB_N)


def test_the_help_says_that_an_fmu_runs_native_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert "native code" in " ".join(text_of(capsys, "simulate", "--help").split())
