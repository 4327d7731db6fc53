"""A folder with one of everything that `ces serve` shows, and what asks its desk."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

from damper_models import plain_damper
from diagnoses import named

from ces_gap.report.gap_json import write_gap
from ces_observer.model import Model
from ces_report.shell import PageHead, page_template

BAGS = Path(__file__).resolve().parent.parent.parent / "bags"
OWN = {"Origin": "http://localhost"}  # of a page of the desk, as test clients reach it


def described_model(validation_J: float = 4.0) -> Model:
    """Return a small model with a certificate and the history of an identification."""
    model = plain_damper()
    costs = [("noise", "identification", 3.0), ("sine_4hz", "validation", validation_J)]
    history = {
        "tool": "ces_observer",
        "cost_J_percent": [{"recording": name, "role": role, "J": J} for name, role, J in costs],
    }
    return replace(model, certificate=model.certify().to_mapping(), provenance=history)


def fill_folder(folder: Path) -> Path:
    """Write one of everything into `folder` and return it."""
    described_model(4.0).save(folder / "first.json")
    described_model(9.0).save(folder / "second.json")
    write_report_page(folder / "first.html", "Model first.json")
    (folder / "worn").mkdir()
    write_gap(folder / "worn" / "gap.json", named())
    write_report_page(folder / "worn" / "report.html", "Simulation and reality")
    shutil.copytree(BAGS / "sine_4hz", folder / "recordings" / "sine_4hz")
    return folder


def write_report_page(path: Path, title: str) -> None:
    """Write a page in the shell of all reports."""
    path.write_text(page_template("shell.html.j2").render(head=PageHead(title)), encoding="utf-8")


def open_desk(folder: Path) -> tuple[Any, Any]:
    """Return a desk and a client with its token."""
    from ces_cli.desk.app import Desk

    desk = Desk(folder)
    client = desk.app.test_client()
    assert client.get(f"/?token={desk.token}").status_code == 200
    return desk, client
