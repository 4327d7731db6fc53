"""A diagnosis on the terminal: the verdict, the gap, its causes, where it lies, and what to do next."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from rich import box
from rich.markup import escape
from rich.table import Table

from ces_cli.diagnose.diagnosis_text import (
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
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, Where

COLORS = {NAMED: "green", AMBIGUOUS: "yellow", UNKNOWN: "magenta", NO_GAP: "cyan"}
MAX_CAUSES = 5
MAX_REGIONS = 3
MAX_FALSE_DISCOVERY_RATE = 0.05  # rate of false discoveries up to which a region counts
MIN_ENERGY_RATIO, MIN_ENERGY_SHARE = 1.2, 0.05  # as much of the gap's energy, over the share of the time, and at all


def print_diagnosis(diagnosis: Diagnosis, folder: Path, files: Sequence[str], printed_notes: int = 0) -> None:
    """Print a diagnosis; `files` are those written to `folder`, and the first notes were `printed_notes` already."""
    for text in diagnosis.notes[printed_notes:]:
        terminal.print_warning(text)
    say = terminal.out.print
    name = diagnosis.verdict.replace("_", " ").upper()
    say(f"[bold {COLORS[diagnosis.verdict]}]{name}[/]: {escape(diagnosis.sentence)}", highlight=False, soft_wrap=True)
    for line in gap_lines(diagnosis):
        say(line, highlight=False, soft_wrap=True, markup=False)
    if diagnosis.causes and diagnosis.verdict != NO_GAP:
        say(cause_table(diagnosis))
    for line in (
        *parameter_lines(diagnosis),
        *where_lines(diagnosis),
        *doubt_lines(diagnosis),
        *next_lines(diagnosis, folder),
    ):
        say(line, highlight=False, soft_wrap=True, markup=False)
    print(f"written: {folder}/{', '.join(files)}")


def gap_lines(diagnosis: Diagnosis) -> list[str]:
    """Say how large the gap is, and what is left of it."""
    gap, together = diagnosis.gap, diagnosis.composition
    lines = [
        f"gap: {newtons(gap.rms_N)} RMS {interval(gap.ci95_N)} on what was held out, noise taken out "
        f"(noise {newtons(gap.noise_floor_N)}, J = {gap.cost_J:.2f} %)"
    ]
    if diagnosis.correction is not None:
        told = f"{newtons(gap.corrected_N)} {interval(gap.corrected_ci95_N)}"
        lines.append(f"     {told} of it beyond the simulation's own error, which the references taught")
    if together.effects:
        lines.append(
            f"with {' + '.join(together.effects)}: {newtons(together.gap_after_N)} left, the gap shrinks by "
            f"{percent(together.shrink)} {percent_interval(together.shrink_ci95)}"
        )
        lines.append(_controls(diagnosis))
    return lines


def cause_table(diagnosis: Diagnosis) -> Table:
    """Return the effects one by one, likeliest first, with what is not one of them below."""
    table = Table(title="each effect alone", title_justify="left", header_style="bold", box=box.SIMPLE_HEAD)
    table.add_column("effect", no_wrap=True)
    for heading in ("probability", "shrink", "95 %"):
        table.add_column(heading, justify="right", no_wrap=True)
    for cause in diagnosis.causes[:MAX_CAUSES]:
        style = "bold" if cause.effects[0] in diagnosis.composition.effects else ""
        shrink = (percent(cause.shrink), percent_interval(cause.shrink_ci95))
        table.add_row(effect_name(cause), probability(cause.probability), *map(escape, shrink), style=style)
    table.add_section()
    table.add_row("no gap", probability(diagnosis.probability_none), "", "")
    table.add_row("something else", probability(diagnosis.probability_unknown), "", "")
    return table


def parameter_lines(diagnosis: Diagnosis) -> list[str]:
    """Say the parameters of the effects that together explain the gap."""
    together = diagnosis.composition
    pairs = zip(together.effects, together.estimates, strict=True)
    return [f"{effect}: {', '.join(map(estimate, estimates))}" for effect, estimates in pairs]


def where_lines(diagnosis: Diagnosis) -> list[str]:
    """Say where the gap's energy sits that is more than the time spent there, and where what no effect explains."""
    lines = [] if diagnosis.verdict == NO_GAP else _where("where", diagnosis.where)
    return lines if diagnosis.rest is None else lines + _where("unexplained", diagnosis.rest)


def _where(word: str, where: Where) -> list[str]:
    telling = [
        r
        for r in where.regions
        if r.q_value <= MAX_FALSE_DISCOVERY_RATE
        and r.share_of_energy > max(MIN_ENERGY_RATIO * r.share_of_samples, MIN_ENERGY_SHARE)
    ]
    telling.sort(key=lambda r: r.share_of_samples - r.share_of_energy)
    by_axis = {r.axis: r for r in reversed(telling)}
    best = [r for r in telling if by_axis[r.axis] is r][:MAX_REGIONS]
    return [f"{word}: {region_text(r)}" for r in best] or [f"{word}: no region stands out"]


def doubt_lines(diagnosis: Diagnosis) -> list[str]:
    """Say what these recordings cannot tell."""
    lines = [f"not told apart by these recordings: {', '.join(group)}" for group in diagnosis.indistinguishable]
    if diagnosis.not_separable:
        effects = ", ".join(diagnosis.not_separable)
        lines.append(f"not separable from a calibration of the simulation: {effects} (give --reference)")
    lines += [f"cannot be seen: {effect}: {reason}" for effect, reason in diagnosis.invisible]
    if diagnosis.surrogate_cost_J is not None:
        lines.append(f"the simulation was stood in for by a surrogate of J = {diagnosis.surrogate_cost_J:.2f} %")
    return lines


def next_lines(diagnosis: Diagnosis, folder: Path) -> list[str]:
    """Say what to do next."""
    lines = []
    if diagnosis.next_experiment is not None:
        lines.append(f"next: {diagnosis.next_experiment.purpose}")
        lines.append(f"      ces rig {folder}/next_experiment.yaml --out BAG   (for a real rig: next_experiment.csv)")
    if diagnosis.composition.effects and diagnosis.verdict in (NAMED, AMBIGUOUS):
        lines.append(
            f"next: ces identify --teacher {folder}/augmented.json BAG... --out MODEL.json   (the repair, as a model)"
        )
    return lines


def _controls(found: Diagnosis) -> str:
    ceiling = 1.0 - found.ceiling_after_N / found.gap.rms_N if found.gap.rms_N > 0.0 else math.nan
    wrong = (
        ""
        if found.wrong is None
        else f"the best other effect ({found.wrong.effects[0]}) {percent(found.wrong.shrink)}, "
    )
    return f"     for comparison: {wrong}a learner without physics {percent(ceiling)}"
