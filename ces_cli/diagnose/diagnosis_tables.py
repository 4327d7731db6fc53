"""A diagnosis on the terminal: the verdict, the gap, its causes, its regions, and the next steps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from ces_cli.diagnose.diagnosis_text import (
    calibration_text,
    effect_name,
    estimate,
    interval,
    newtons,
    percent,
    percent_interval,
    probability,
    region_text,
)
from ces_cli.terminal import terminal
from ces_gap.calibration_map import calibration_cells
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, Where
from ces_gap.inference.verdict import CALIBRATION

COLORS = {NAMED: "green", AMBIGUOUS: "yellow", UNKNOWN: "magenta", NO_GAP: "cyan"}
MAX_CAUSES = 5
MAX_REGIONS = 3
MAX_FALSE_DISCOVERY_RATE = 0.05  # of the regions that are printed
MIN_ENERGY_RATIO, MIN_ENERGY_SHARE = 1.2, 0.05  # a printed region's energy: relative to its share of time, and in total


def print_diagnosis(diagnosis: Diagnosis, folder: Path, files: Sequence[str], printed_notes: int = 0) -> None:
    """Print a diagnosis and the `files` written to `folder`; the first `printed_notes` notes are already printed."""
    for text in diagnosis.notes[printed_notes:]:
        terminal.print_warning(text)
    name, style = diagnosis.verdict.replace("_", " ").upper(), f"bold {COLORS[diagnosis.verdict]}"
    _print_lines([f"[{style}]{name}[/]: {escape(diagnosis.sentence)}"], markup=True)
    _print_lines(_gap_lines(diagnosis))
    if diagnosis.causes and diagnosis.verdict != NO_GAP:
        terminal.print_table(_cause_table(diagnosis))
    _print_lines([*_parameter_lines(diagnosis), *_witness_lines(diagnosis), *_where_lines(diagnosis)])
    _print_lines([*_doubt_lines(diagnosis), *_next_lines(diagnosis, folder)])
    print(f"written: {folder}/{', '.join(files)}")


def _print_lines(lines: Sequence[str], markup: bool = False) -> None:
    for line in lines:
        terminal.out.print(line, highlight=False, soft_wrap=True, markup=markup)


def _gap_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the size of the gap, and how much of it remains."""
    gap, together = diagnosis.gap, diagnosis.composition
    lines = [
        f"gap: {newtons(gap.rms_N)} RMS {interval(gap.ci95_N)} on held-out data, noise subtracted "
        f"(noise {newtons(gap.noise_floor_N)} from {gap.noise_source}, J = {gap.cost_J:.2f} %)"
    ]
    if diagnosis.correction is not None:
        size = f"{newtons(gap.corrected_N)} {interval(gap.corrected_ci95_N)}"
        lines.append(f"     {size} of it beyond the simulation's own error, learned from the references")
    if together.effects:
        lines.append(
            f"with {' + '.join(together.effects)}: {newtons(together.gap_after_N)} left, the gap shrinks by "
            f"{percent(together.shrink)} {percent_interval(together.shrink_ci95)}"
        )
        lines.append(_controls(diagnosis))
    return lines


def _cause_table(diagnosis: Diagnosis) -> Table:
    """Return the effects one by one, most probable first, and below them no gap and an unknown cause."""
    table = terminal.make_table("each effect alone", ("effect",), ("probability", "shrink", "95 %"))
    for cause in diagnosis.causes[:MAX_CAUSES]:
        style = "bold" if cause.effects[0] in diagnosis.composition.effects else ""
        shrink = (percent(cause.shrink), percent_interval(cause.shrink_ci95))
        table.add_row(effect_name(cause), probability(cause.probability), *map(escape, shrink), style=style)
    table.add_section()
    table.add_row("no gap", probability(diagnosis.probability_none), "", "")
    table.add_row("unknown cause", probability(diagnosis.probability_unknown), "", "")
    return table


def _parameter_lines(diagnosis: Diagnosis) -> list[str]:
    together = diagnosis.composition
    pairs = [p for p in zip(together.effects, together.estimates, strict=True) if p[0] != CALIBRATION]
    lines = [f"{effect}: {', '.join(map(estimate, estimates))}" for effect, estimates in pairs]
    return lines + [calibration_text(cell) for cell in calibration_cells(diagnosis)]


def _witness_lines(diagnosis: Diagnosis) -> list[str]:
    """Return what the refits of the model's own parameters say."""
    if diagnosis.witness is None:
        return []
    says = diagnosis.witness_says or diagnosis.witness.note
    return [f"second witness: {says}"] if says else []


def _where_lines(diagnosis: Diagnosis) -> list[str]:
    """Return the regions with more of the gap's energy than of the time, also for the unexplained part."""
    lines = [] if diagnosis.verdict == NO_GAP else _where("where", diagnosis.where)
    return lines if diagnosis.rest is None else lines + _where("unexplained", diagnosis.rest)


def _where(label: str, where: Where) -> list[str]:
    regions = [
        r
        for r in where.regions
        if r.q_value <= MAX_FALSE_DISCOVERY_RATE
        and r.share_of_energy > max(MIN_ENERGY_RATIO * r.share_of_samples, MIN_ENERGY_SHARE)
    ]
    regions.sort(key=lambda r: r.share_of_samples - r.share_of_energy)
    by_axis = {r.axis: r for r in reversed(regions)}
    best = [r for r in regions if by_axis[r.axis] is r][:MAX_REGIONS]
    return [f"{label}: {region_text(r)}" for r in best] or [f"{label}: no region stands out"]


def _doubt_lines(diagnosis: Diagnosis) -> list[str]:
    """Return what these recordings cannot decide."""
    lines = [f"indistinguishable on these recordings: {', '.join(group)}" for group in diagnosis.indistinguishable]
    if diagnosis.not_separable:
        effects = ", ".join(diagnosis.not_separable)
        lines.append(f"not separable from a calibration of the simulation: {effects} (use --reference)")
    lines += [f"not observable: {effect}: {reason}" for effect, reason in diagnosis.invisible]
    if diagnosis.surrogate_cost_J is not None:
        lines.append(f"a surrogate with J = {diagnosis.surrogate_cost_J:.2f} % replaced the simulation")
        if diagnosis.surrogate_error is not None:
            lines[-1] += (
                f"; its error where inputs change: about {100.0 * diagnosis.surrogate_error:.0f} % of the change"
            )
    return lines


def _next_lines(diagnosis: Diagnosis, folder: Path) -> list[str]:
    lines = []
    if diagnosis.next_experiment is not None:
        lines.append(f"next: {diagnosis.next_experiment.purpose}")
        lines.append(f"      ces rig {folder}/next_experiment.yaml --out BAG   (for a real rig: next_experiment.csv)")
    if diagnosis.composition.effects and diagnosis.verdict in (NAMED, AMBIGUOUS):
        command = f"ces identify --teacher {folder}/augmented.json BAG... --out MODEL.json"
        lines.append(f"next: {command}   (the repaired simulation as a model)")
    return lines


def _controls(diagnosis: Diagnosis) -> str:
    before, wrong = diagnosis.gap.rms_N, diagnosis.wrong
    ceiling = 1.0 - diagnosis.ceiling_after_N / before if before > 0.0 else math.nan
    other = "" if wrong is None else f"the best other effect ({wrong.effects[0]}) {percent(wrong.shrink)}, "
    return f"     for comparison: {other}a learner without physics {percent(ceiling)}"
