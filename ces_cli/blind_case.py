"""One case of a blind test: diagnosed from its recordings alone, the results in a folder."""

from __future__ import annotations

import json
import logging
import time
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ces_cli.terminal.inputs import open_simulation, with_predictions
from ces_data.bags.reader import read_recording
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_identify.identification import identify
from ces_identify.numerics.search import Limits
from ces_identify.simulations.simulation import Simulation
from ces_identify.structures import KITS
from ces_identify.structures.auto import physical_structures
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.errors import CesError
from ces_observer.json_text import write_atomically
from ces_rig.blind.cases import CaseDescription, read_case
from ces_rig.blind.scoring import (
    DECISION,
    GAP,
    IDENTIFIED,
    PREDICTIONS,
    REPLAY,
    ROW,
    Mode,
)

AUGMENTED, MODEL = "augmented.json", "model.json"
WORK = 0.12  # of a fit
OPTIONS = IdentifyOptions(split=1.0, limits=Limits(starts=1, threads=1, work=WORK), band=False)


def diagnose_case(case: Path, out: Path, mode: Mode) -> dict[str, Any]:
    """Diagnose the case, write its results and return a row: the summary or the reason of failure, and the seconds."""
    start = time.perf_counter()
    out.mkdir(parents=True, exist_ok=True)
    row: dict[str, Any] = {"case": case.name, "status": "done"}
    try:
        row["summary"] = _diagnose(case, out, mode)
    except CesError as error:
        row |= {"status": "failed", "reason": str(error)}
    except Exception as error:  # a fault of the diagnosis counts as its result; the other cases continue
        logging.getLogger(__name__).exception("%s", case)
        row |= {"status": "failed", "reason": f"{type(error).__name__}: {error}"}
    row["seconds"] = round(time.perf_counter() - start, 2)
    write_atomically(out / ROW, json.dumps(row) + "\n")
    return {**row, "mode": mode.name}


def _diagnose(case: Path, out: Path, mode: Mode) -> str:
    """Diagnose the case and write its results; return a line."""
    from ces_gap.augmented import save_augmented
    from ces_gap.inputs.checks import require_distinct
    from ces_gap.pipeline import DiagnoseOptions, diagnose
    from ces_gap.report.gap_json import write_gap

    described = read_case(case)
    if len(described.reference) < mode.references:
        raise CesError(f"{case}: has {len(described.reference)} references; expected {mode.references} for {mode.name}")
    spec = _prepare_simulation(case, out, described, mode)
    simulation = open_simulation(spec)
    real, held_out = (_read(simulation, case, names) for names in (described.real, described.held_out))
    reference = _read(simulation, case, described.reference[: mode.references])
    require_distinct(real, held_out, reference)
    options = DiagnoseOptions(threads=1, experiment=False)
    diagnosis = diagnose(simulation, spec, real, held_out, reference, options)
    write_gap(out / GAP, diagnosis)
    explanation = diagnosis.composition.composition, diagnosis.correction, diagnosis.twin, diagnosis.is_recorded
    save_augmented(out / AUGMENTED, spec, *explanation, timing=diagnosis.probe.corrected)
    figures = None if diagnosis.figures is None else asdict(diagnosis.figures)  # behind the verdict
    write_atomically(out / DECISION, json.dumps({"figures": figures}, indent=1) + "\n")
    _replay(out, simulation, held_out)
    gap = json.loads((out / GAP).read_text(encoding="utf-8"))
    effects = " + ".join(gap["composition"]["effects"]) or "nothing"
    before, after = gap["gap"]["rms_N"] or 0.0, gap["composition"]["gap_after_N"] or 0.0
    return f"{gap['verdict']}, {effects}; gap {before:.1f} N, left {after:.1f} N"


def _prepare_simulation(case: Path, out: Path, described: CaseDescription, mode: Mode) -> str:
    """Return the specification of the mode's simulation; an identified one is written to MODEL first."""
    if mode.simulation == PREDICTIONS:
        return described.predictions
    if mode.simulation == IDENTIFIED:
        identify_baseline(_read_bags(case, described.reference[: mode.references]), out / MODEL)
        return str(out / MODEL)
    inside = case / described.simulation
    return str(inside) if inside.is_file() else described.simulation  # one of its own, such as module:function


def _read(simulation: Simulation, case: Path, names: Sequence[str]) -> list[Recording]:
    recordings = zip(names, _read_bags(case, names), strict=True)
    return [with_predictions(simulation, case / name, recording, load_signals()) for name, recording in recordings]


def _read_bags(case: Path, names: Sequence[str]) -> list[Recording]:
    signals = load_signals()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # every case: the message of the current has no header
        return [read_recording(case / name, signals, ("position", "current", "force")) for name in names]


def _replay(out: Path, simulation: Simulation, held_out: Sequence[Recording]) -> None:
    """Run the simulation over the held-out recordings, as it is, with its correction, and with effects too."""
    from ces_gap.augmented import load_augmented
    from ces_gap.effects.effect import Composition

    augmented = load_augmented(out / AUGMENTED, open_simulation)
    corrected = replace(augmented, composition=Composition())
    arrays: dict[str, NDArray[np.float32]] = {}
    for name, what in (("simulated", simulation), ("corrected", corrected), ("augmented", augmented)):
        arrays |= {f"{r.name}_{name}_N": what.force(r).astype(np.float32) for r in held_out}
    part = out / f".part.{REPLAY}"
    np.savez_compressed(part, **arrays)  # type: ignore[arg-type]
    part.replace(out / REPLAY)


def identify_baseline(references: Sequence[Recording], path: Path) -> None:
    """Write to `path` the model with physics inside of the lowest selection cost on the references; raises CesError."""
    models = []
    for option in physical_structures():
        kit = KITS[option]
        fitter = kit.fitter({size.name: size.default for size in kit.sizes})
        with warnings.catch_warnings(), suppress(CesError):
            warnings.simplefilter("ignore")
            models.append(identify(references, (), OPTIONS, lambda result: None, fitter))
    if not models:
        raise CesError("no model could be identified from the reference recordings")
    min(models, key=lambda result: float(result.search_results[0].cost)).model.save(path)
