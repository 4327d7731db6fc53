"""`ces validate`: a model's free run judged on recordings."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ces_cli import terminal
from ces_cli.cost_picture import save_cost_picture
from ces_cli.coverage_picture import require_picture_name
from ces_cli.tables import cost_table
from ces_identify.evaluate import IDENTIFICATION, VALIDATION, evaluate
from ces_identify.series import prepare
from ces_observer.model import load_model


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = _parser().parse_args(argv)
    if options.picture is not None:
        require_picture_name(options.picture)
    model = load_model(options.model)
    recordings = terminal.read_all(options.bags, terminal.signals_of(options), ("position", "current", "force"))
    shares = _seen(model.provenance)
    evaluations = []
    for recording in recordings:
        seen = _overlap(shares.get(recording.sha256, (0.0, 0.0)), options.part)
        if seen:
            terminal.note(f"{recording.name}: the model was identified on part of this")
        series = prepare(recording, model.sampling).part(*options.part)
        evaluations += evaluate(model, [series], IDENTIFICATION if seen else VALIDATION)
    terminal.out.print(cost_table(evaluations, f"{options.model}: {model.size}"))
    if options.picture is not None:
        save_cost_picture(evaluations, options.picture)
    if options.report is not None:
        from ces_identify.report import write_report

        facts = {"command": shlex.join(["ces", "validate", *(sys.argv[2:] if argv is None else argv)])}
        write_report(options.report, f"Validation of {options.model.name}", model, evaluations, facts)
        print(f"report: {options.report}")
    return 0


def _overlap(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return max(one[0], other[0]) < min(one[1], other[1])


def _seen(provenance: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the shares of the recordings the model was identified on, by hash."""
    rows = provenance.get("identification")
    shares = {}
    for row in rows if isinstance(rows, list) else []:
        match row:
            case {"sha256": str(digest), "share": [int() | float() as first, int() | float() as last]} if digest:
                shares[digest] = (float(first), float(last))
    return shares


def _parser() -> terminal.Parser:
    p = terminal.parser(
        "validate",
        "Judge a model by the cost J of its free run on recordings with a measured force.",
        "ces validate model.json bags/road --report validation.html",
    )
    p.add_argument("model", type=Path, metavar="MODEL.json")
    p.add_argument("bags", nargs="+", type=Path, metavar="BAG", help="recordings with a measured force")
    terminal.add_signals(p)
    terminal.add_part(p)
    p.add_argument("--report", type=Path, metavar="FILE", help="write a report page (HTML)")
    p.add_argument("--picture", type=Path, metavar="FILE", help="draw speed-force and time plots (.png, .svg, .pdf)")
    return p
