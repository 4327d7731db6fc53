"""The files of a diagnosis: `gap.json`, `augmented.json`, `report.html`, and the next experiment if there is one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import PurePath

from ces_data.recording import Recording
from ces_gap.augmented import augmented_text
from ces_gap.calibrate.parameters import parameter_values
from ces_gap.diagnosis import Diagnosis
from ces_gap.effects.effect import Composition
from ces_gap.experiment.next_experiment import experiment_files
from ces_gap.inference.judgement import PARAMETERS
from ces_gap.progress import OptionalSteps
from ces_gap.report.gap_json import format_document, gap_document
from ces_gap.report.page import report_page
from ces_report.shell import PageHead
from ces_report.typesetting import join_names

GAP, AUGMENTED, REPORT = "gap.json", "augmented.json", "report.html"


def result_files(
    diagnosis: Diagnosis,
    sim: Mapping[str, str | None],
    sources: Sequence[tuple[str, Sequence[Recording]]],
    head: PageHead | None = None,
) -> dict[str, str]:
    """Return the texts of the files by name.

    `sim` specifies the simulation relative to the files' folder (`ces_gap.augmented.name_simulation`).
    `sources` are the recordings of each role ("real", "held_out", "reference") for the provenance. If the report or the
    next experiment cannot be written, a note in `gap.json` says why.
    """
    titled = (head or PageHead()).titled(_title(diagnosis, sources))
    optional, proposed = OptionalSteps(), diagnosis.next_experiment
    nothing: dict[str, str] = {}
    page = optional.run(REPORT, lambda: {REPORT: report_page(diagnosis, titled)}, nothing)
    experiment = optional.run("next experiment", lambda: experiment_files(proposed) if proposed else nothing, nothing)
    document = gap_document(replace(diagnosis, notes=(*diagnosis.notes, *optional.notes)))
    provenance = {role: [{"recording": r.name, "sha256": r.sha256} for r in recordings] for role, recordings in sources}
    composition = diagnosis.composition.composition
    said = {"verdict": diagnosis.verdict, "gap": document["gap"], **provenance}
    values, timing = parameter_values(composition), diagnosis.probe.corrected
    composition = Composition(tuple(s for s in composition.settings if s.name != PARAMETERS))
    augmented = augmented_text(
        sim, composition, diagnosis.correction, diagnosis.twin, diagnosis.is_recorded, said, timing, values
    )
    return {GAP: format_document(document), AUGMENTED: augmented, **page, **experiment}


def _title(diagnosis: Diagnosis, sources: Sequence[tuple[str, Sequence[Recording]]]) -> str:
    """Return which simulation was compared with which recordings, for the report's title."""
    names = {role: join_names([r.name for r in recordings]) for role, recordings in sources}
    real = join_names([r.name for role, recordings in sources if role != "reference" for r in recordings])
    reference = f" (reference {names['reference']})" if names.get("reference") else ""
    return f"Gap of {PurePath(diagnosis.simulation).name} against {real}{reference}"
