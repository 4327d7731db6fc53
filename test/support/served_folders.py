"""A folder with one of everything that `ces serve` shows, written by the writers of the programs."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from damper_models import plain_damper
from diagnoses import named

from ces_gap.report.gap_json import write_gap
from ces_identify.jobs import DONE, FAILED, JobResult, append_row, open_results, open_rows
from ces_observer.model import Model
from ces_report.shell import PageHead, page_template
from ces_rig.loop.store import Iteration

BAGS = Path(__file__).resolve().parent.parent.parent / "bags"
ROW = {"status": DONE, "bags": "noise", "structure": "polynomial", "seed": 1}
ROW |= {"gain": 0.9, "force_bound_N": 2e3, "seconds": 3.0}


def described_model(validation_J: float = 4.0) -> Model:
    """Return a small model with a certificate and the history of an identification."""
    model = plain_damper()
    costs = [("noise", "identification", 3.0), ("sine_4hz", "validation", validation_J)]
    history = {
        "tool": "ces_observer",
        "identification": [{"recording": "noise"}],
        "validation": [{"recording": "sine_4hz"}],
        "cost_J_percent": [{"recording": name, "role": role, "J": J} for name, role, J in costs],
    }
    return replace(model, certificate=model.certify().to_mapping(), provenance=history)


def fill_folder(folder: Path, bags: bool = True) -> Path:
    """Write one of everything into `folder` and return it."""
    described_model(4.0).save(folder / "first.json")
    described_model(9.0).save(folder / "second.json")
    write_report_page(folder / "first.html", "Model first.json")
    (folder / "worn").mkdir()
    write_gap(folder / "worn" / "gap.json", named())
    write_report_page(folder / "worn" / "report.html", "Simulation and reality")
    _write_campaign(folder / "sizes")
    _write_fleet(folder / "fleet")
    _write_iterations(folder / "loop")
    if bags:
        shutil.copytree(BAGS / "sine_4hz", folder / "recordings" / "sine_4hz")
    return folder


def write_report_page(path: Path, title: str) -> None:
    """Write a page in the shell of all reports."""
    path.write_text(page_template("shell.html.j2").render(head=PageHead(title)), encoding="utf-8")


def _write_campaign(folder: Path) -> None:
    with open_results(folder / "results.jsonl", "a campaign") as results:
        for key, terms, J in (("aa11", 4, 12.0), ("bb22", 9, 5.0)):
            costs = [
                {"set": role, "recording": bag, "J": J + more}
                for role, bag, more in (("identification", "noise", 0.0), ("sine", "sine", 1.0))
            ]
            row = {**ROW, "key": key, "size": f"{terms} terms", "parameters": terms, "selection_J": J, "costs": costs}
            results.add(JobResult(row, {f"models/{key}.json": described_model(J).to_json()}))
        results.add(JobResult({**ROW, "key": "cc33", "status": FAILED, "reason": "too few ticks"}))


def _write_fleet(folder: Path) -> None:
    said = {"verdict": "named", "effects": ["friction"], "probability": 0.9, "shrink": 0.85}
    said |= {"gap_N": 40.0, "gap_after_N": 6.0}
    row = {"key": "a", "name": "car_1", "status": DONE, "sentence": "Friction.", "folder": "units/car_1", **said}
    with open_results(folder / "fleet.jsonl", "a fleet") as results:
        results.add(JobResult(row))
        results.add(JobResult({"key": "b", "name": "car_2", "status": FAILED, "reason": "no force"}))
    (folder / "units" / "car_1").mkdir(parents=True)
    write_gap(folder / "units" / "car_1" / "gap.json", named())


def _write_iterations(folder: Path) -> None:
    with open_rows(folder / "iterations.jsonl") as file:
        for number, fresh, fit in ((1, None, 7.0), (2, 9.0, 6.0)):
            model = f"iteration_{number:02d}/model.json"
            (folder / model).parent.mkdir()
            described_model(fit).save(folder / model)
            times, costs, spreads = (15.0, 15.0 * number, 0.0, 20.0), (fresh, fit), (0.5, 0.1, 0.3)
            line = Iteration(number, f"experiment_{number:02d}", *times, *costs, {}, *spreads, [], model)
            append_row(file, line.to_row())
