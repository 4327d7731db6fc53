"""Diagnoses one blind case from its recordings and replays the augmented simulation on the held-out ones.

The results are `gap.json`, `augmented.json`, `decision.json` (the figures behind the verdict), `replay.npz` with forces
[N] at the position samples of the held-out recordings (`NAME_simulated_N` of the simulation, `NAME_augmented_N` from
the saved file, `NAME_corrected_N` without the effects), and last `row.json`. A model that was identified in place of
the simulation is `model.json`.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ces_cli.blind.identified import identify_baseline
from ces_cli.blind.mode import IDENTIFIED, PREDICTIONS, Mode
from ces_cli.terminal.simulations import open_simulation, with_predictions
from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import CesError
from ces_observer.json_checks import write_atomically

if TYPE_CHECKING:
    from ces_gap.diagnosis import Diagnosis

ROW, GAP, AUGMENTED, REPLAY, DECISION = "row.json", "gap.json", "augmented.json", "replay.npz", "decision.json"
MODEL = "model.json"


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
        row |= {"status": "failed", "reason": f"{type(error).__name__}: {error}"}
    row["seconds"] = round(time.perf_counter() - start, 2)
    write_atomically(out / ROW, json.dumps(row) + "\n")
    return row


def _diagnose(case: Path, out: Path, mode: Mode) -> str:
    from ces_gap.augmented.augmented_file import save_augmented
    from ces_gap.intake.checks import require_distinct
    from ces_gap.pipeline import DiagnoseOptions, diagnose
    from ces_gap.report.gap_json import write_gap

    described = json.loads((case / "case.json").read_text(encoding="utf-8"))
    spec = _prepare_simulation(case, out, described, mode)
    simulation = open_simulation(spec)
    real, held_out = (_read(simulation, case, described[role]) for role in ("real", "held_out"))
    reference = _read(simulation, case, described["reference"][: mode.references])
    require_distinct(real, held_out, reference)
    options = DiagnoseOptions(threads=1, experiment=False)
    diagnosis = diagnose(simulation, spec, real, held_out, reference, options)
    write_gap(out / GAP, diagnosis)
    save_augmented(out / AUGMENTED, spec, diagnosis.composition.composition, diagnosis.correction, diagnosis.surrogate)
    _save_decision(out / DECISION, diagnosis)
    _replay(out, simulation, held_out)
    return _summary(json.loads((out / GAP).read_text(encoding="utf-8")))


def _prepare_simulation(case: Path, out: Path, described: Mapping[str, Any], mode: Mode) -> str:
    """Return the specification of the mode's simulation; an identified one is written to MODEL first."""
    if mode.simulation == PREDICTIONS:
        return str(described["predictions"])
    if mode.simulation == IDENTIFIED:
        identify_baseline(_read_bags(case, described["reference"][: mode.references]), out / MODEL)
        return str(out / MODEL)
    return str(case / described["simulation"])


def _read(simulation: Simulation, case: Path, names: Sequence[str]) -> list[Recording]:
    signals, recordings = load_signals(), _read_bags(case, names)
    return [with_predictions(simulation, case / n, r, signals) for n, r in zip(names, recordings, strict=True)]


def _read_bags(case: Path, names: Sequence[str]) -> list[Recording]:
    signals = load_signals()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # every case: the message of the current has no header
        return [read_recording(case / name, signals, ("position", "current", "force")) for name in names]


def _save_decision(path: Path, diagnosis: Diagnosis) -> None:
    """Write the figures behind the verdict, and the causes that simpler methods would have named."""
    figures = None if diagnosis.figures is None else asdict(diagnosis.figures)
    write_atomically(path, json.dumps({"baselines": diagnosis.baselines, "figures": figures}, indent=1) + "\n")


def _replay(out: Path, simulation: Simulation, held_out: Sequence[Recording]) -> None:
    """Run the simulation over the held-out recordings, and the augmented one from its file with and without effects."""
    from ces_gap.augmented.augmented_file import load_augmented
    from ces_gap.effects.effect import Composition

    augmented = load_augmented(out / AUGMENTED, open_simulation)
    corrected = replace(augmented, composition=Composition())
    arrays: dict[str, NDArray[np.float32]] = {}
    for recording in held_out:
        arrays[f"{recording.name}_simulated_N"] = simulation.force(recording).astype(np.float32)
        arrays[f"{recording.name}_augmented_N"] = augmented.force(recording).astype(np.float32)
        arrays[f"{recording.name}_corrected_N"] = corrected.force(recording).astype(np.float32)
    part = out / f".part.{REPLAY}"
    np.savez_compressed(part, **arrays)  # type: ignore[arg-type]
    part.replace(out / REPLAY)


def _summary(gap: dict[str, Any]) -> str:
    effects = " + ".join(gap["composition"]["effects"]) or "nothing"
    before, after = gap["gap"]["rms_N"], gap["composition"]["gap_after_N"]
    return f"{gap['verdict']}, {effects}; gap {before or 0.0:.1f} N, left {after or 0.0:.1f} N"
