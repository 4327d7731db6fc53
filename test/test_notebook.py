"""The notebook runs from the first cell to the last, says what it should, and is stored without outputs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from patience import PATIENCE_S

NotebookClient = pytest.importorskip("nbclient").NotebookClient
nbformat = pytest.importorskip("nbformat")
pytest.importorskip("ipykernel")
pytest.importorskip("pandas")
NOTEBOOK = Path(__file__).resolve().parent.parent / "examples" / "own_data.ipynb"


def output_of(cell: dict[str, object]) -> str:
    return "".join(str(output.get("text", "")) for output in cell.get("outputs", []))  # type: ignore[attr-defined]


def test_the_notebook_is_stored_without_outputs() -> None:
    for cell in nbformat.read(NOTEBOOK, as_version=4).cells:
        assert not cell.get("outputs") and not cell.get("execution_count")


@pytest.mark.slow
def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(NOTEBOOK.parents[1]), os.environ.get("PYTHONPATH", "")]))
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    notebook = nbformat.read(NOTEBOOK, as_version=4)
    patience = {"timeout": int(PATIENCE_S), "startup_timeout": int(PATIENCE_S)}
    NotebookClient(notebook, **patience, resources={"metadata": {"path": str(tmp_path)}}).execute()
    text = "\n".join(output_of(cell) for cell in notebook.cells if cell.cell_type == "code")
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    shown = "\n".join(str(output.get("data", {}).get("text/plain", "")) for output in outputs)
    assert "proved stable" in shown and "standard_error" in shown and "friction" in text
    cost = float(next(line.split() for line in shown.splitlines() if line.startswith("DataFrame  validation"))[4])
    assert cost < 15.0
    images = [output for cell in notebook.cells for output in cell.get("outputs", []) if "image/png" in str(output)]
    assert len(images) == 1
