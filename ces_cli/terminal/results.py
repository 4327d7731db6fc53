"""Results that several programs show: costs as tables and for --json, and the map of a coverage."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rich.text import Text

from ces_cli.terminal.terminal import lay_out, print_table, print_warning
from ces_data.samples import Coverage
from ces_identify.identification import CrossValidation
from ces_identify.prepare.cost import EQUAL, Weighting
from ces_identify.validation.cost_table import NONE, cost_table, interval_text, percent
from ces_identify.validation.evaluate import (
    VALIDATION,
    CostInterval,
    Evaluation,
    PooledCost,
    explain_missing,
    pool_evaluations,
)
from ces_observer.model import Model
from ces_report.table import Table, text_table


def print_costs(evaluations: Sequence[Evaluation], title: str, weighting: Weighting = EQUAL) -> None:
    """Print the costs, also of all held-out recordings together, why figures are missing, and warnings."""
    table = lay_out(cost_table(evaluations, title, weighting))
    table.columns[0].min_width = min(14, max(len(e.name) for e in evaluations))
    table.columns[1].no_wrap = True
    table.rows[-1].end_section = True
    if (pooled := _pool_held_out(evaluations)) is not None:
        use = f"{VALIDATION} {pooled.scored_s:.1f} s"
        table.add_row("all held out", use, percent(pooled.cost, pooled.interval), interval_text(pooled.interval))
    print_table(table)
    for line in explain_missing(evaluations, floors=any(e.floor is not None for e in evaluations)):
        print(f"{NONE}: {line}")
    for text in (text for e in evaluations for text in e.warnings):
        print_warning(text)


def cost_rows(evaluations: Sequence[Evaluation], weighting: Weighting = EQUAL) -> list[dict[str, Any]]:
    """Return the costs for --json, not rounded: an object for each evaluation.

    Its keys are `recording`, `role`, `scored_s`, `J_percent` and `ci95_percent` (both null if the run
    diverged), `floor_percent` (null where cycles do not repeat), `weighted_J_percent` (null without weights), `rms_N`,
    `outside_envelope` and `force_held` (shares) and `inside_band` (share; null without a band).
    """
    return [
        {
            "recording": e.name,
            "role": e.role,
            "scored_s": e.scored_s,
            "J_percent": e.cost,
            "ci95_percent": _interval_as_list(e.interval),
            "floor_percent": e.floor,
            "weighted_J_percent": e.weighted_cost(weighting) if weighting else None,
            "rms_N": e.rms_N,
            "outside_envelope": e.outside_share,
            "force_held": e.held_share,
            "inside_band": e.coverage,
        }
        for e in evaluations
    ]


def held_out_row(evaluations: Sequence[Evaluation]) -> dict[str, Any] | None:
    """Return J and interval of all validation recordings together; None below two."""
    pooled = _pool_held_out(evaluations)
    if pooled is None:
        return None
    return {"J_percent": pooled.cost, "ci95_percent": _interval_as_list(pooled.interval)}


def fold_table(result: CrossValidation) -> Table[Sequence[str]]:
    """Return a table with a row for each held-out recording, and the mean and spread of J."""
    rows = [
        (r.recording, str(r.fold), percent(r.cost, r.interval), interval_text(r.interval), r.model) for r in result.rows
    ]
    spread = f"spread {result.spread:.2f}" if math.isfinite(result.spread) else NONE
    heads = ("recording", "fold", "J %", "95 %", "model")
    table = text_table(heads, [*rows, ("mean", "", percent(result.mean), spread, "")], "each recording held out once")
    return replace(table, group=lambda row: row[0] == "mean")


def fold_rows(folds: CrossValidation) -> dict[str, Any]:
    """Return the held-out costs of a cross-validation."""
    rows = [
        {
            "recording": row.recording,
            "fold": row.fold,
            "J_percent": row.cost,
            "ci95_percent": _interval_as_list(row.interval),
            "model": row.model,
        }
        for row in folds.rows
    ]
    return {"rows": rows, "mean_J_percent": folds.mean, "spread_J_percent": folds.spread}


def model_facts(model: Model) -> dict[str, Any]:
    """Return a model's size, rate, delay, proof and band level for a document."""
    return {
        "size": model.size,
        "rate_Hz": model.sampling.rate_Hz,
        "delay_s": model.sampling.delay_s,
        "proved_stable": model.certificate is not None,
        "band_level": None if model.band is None else model.band.level,
    }


def print_band(model: Model, evaluations: Sequence[Evaluation]) -> None:
    """Print what the column `band %` shows, if the model has a band there."""
    halves = (e.half_width[e.series.scored] for e in evaluations if e.half_width is not None)
    widths = [float(known.mean()) for half in halves if len(known := half[np.isfinite(half)])]
    if model.band is None or not widths:
        return
    print(
        f"band: meant to hold {100 * model.band.level:.0f} % of the measured forces, sensor noise included; column "
        f"'band %' is the share it holds; mean half-width {describe_range(min(widths), max(widths))} N"
    )


def describe_range(low: float, high: float) -> str:
    """Return two numbers without decimals as a range, or as one number if they read the same."""
    return f"{low:.0f}" if f"{low:.0f}" == f"{high:.0f}" else f"{low:.0f} to {high:.0f}"


def _pool_held_out(evaluations: Sequence[Evaluation]) -> PooledCost | None:
    return pool_evaluations([e for e in evaluations if e.role == VALIDATION and math.isfinite(e.cost)])


def _interval_as_list(interval: CostInterval | None) -> list[float] | None:
    return None if interval is None else [interval.low, interval.high]


STEPS = (0.0005, 0.002, 0.01, 0.03)  # shares of time at which the next darker block begins
BLOCKS = "·░▒▓█"
CELL = 2  # width of a cell in characters


def terminal_picture(coverage: Coverage) -> Text:
    """Return the map as text: speed to the right, current upwards, darker for more time."""
    rows, columns = coverage.share.shape
    centres = (coverage.current_edges[:-1] + coverage.current_edges[1:]) / 2
    lines = ["share of time over speed and current", f"{'A':>8}"]
    for row in reversed(range(rows)):
        blocks = np.searchsorted(STEPS, coverage.share[row], side="right")
        drawn = [BLOCKS[k] if share > 0.0 else " " for k, share in zip(blocks, coverage.share[row], strict=True)]
        cells = "".join(block * CELL for block in drawn)
        lines.append(f"{centres[row]:8.3f} ┤{cells}")
    top = coverage.speed_edges[-1]
    half = CELL * columns // 2
    lines.append(f"{'':8} └{'─' * (half - 1)}┬{'─' * half}")
    lines.append(f"{'':9}{-top:<+{half - 1}.2f} 0{top:>+{half - 1}.2f} m/s")
    lines.append(f"{'':9}{'rebound':<{half}}{'compression':>{half}}")
    legend = " ".join(f"{block} > {100 * step:g} %" for block, step in zip(BLOCKS[1:], STEPS, strict=True))
    lines.append(f"{'':9}{BLOCKS[0]} less  {legend}")
    lines.append(f"{'':9}the outermost columns include all higher speeds")
    return Text("\n".join(lines), no_wrap=True)
