"""The rows of a fleet as one self-contained page with links to all reports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ces_cli.diagnose.fleet_tables import explain_dashes, format_number, shrink_text, sort_rows, verdict_text
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_identify.report.shell import page_template, replace_unencodable
from ces_observer.json_checks import write_atomically


def write_page(rows: Sequence[Row], path: Path, simulation: str = "the simulation") -> None:
    """Write the page, largest gap first; `simulation` is its name in the title."""
    largest = max([row.get("gap_N") or 0.0 for row in rows], default=0.0) or 1.0
    page = page_template("fleet.html.j2", __package__, ("fleet.css",)).render(
        title=f"Gap of {simulation} against a fleet of {len(rows)}",
        headline=_summary(rows),
        rows=[_row(row, largest) for row in sort_rows(rows)],
        note=explain_dashes(rows),
    )
    write_atomically(path, replace_unencodable(page))


def _summary(rows: Sequence[Row]) -> str:
    done = [row for row in rows if row["status"] == DONE]
    counts = Counter(verdict_text(row) for row in done)
    verdicts = "; ".join(f"{count} × {verdict}" for verdict, count in counts.most_common(6))
    return f"{len(done)} of {len(rows)} diagnosed. {verdicts}"


def _row(row: Row, largest: float) -> dict[str, Any]:
    """Return a row as texts, with the lengths [%] of its bars."""
    if row["status"] != DONE:
        return {"name": row["name"], "failed": row["reason"]}
    lengths = {"gap-before": row["gap_N"] or 0.0, "gap-after": row["gap_after_N"] or 0.0}
    return {
        "name": row["name"],
        "link": f"{row['folder']}/report.html",
        "verdict": verdict_text(row),
        "sentence": row["sentence"],
        "probability": format_number(row["probability"], ".2f"),
        "bars": [(css, f"{100.0 * min(value / largest, 1.0):.1f}") for css, value in lengths.items()],
        "gap": format_number(row["gap_N"], ".1f"),
        "left": format_number(row["gap_after_N"], ".1f"),
        "shrink": shrink_text(row),
    }
