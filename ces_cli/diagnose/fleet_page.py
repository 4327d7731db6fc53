"""The rows of a fleet as one self-contained page with links to all reports."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path

from ces_cli.diagnose.fleet_tables import format_number, shrink_text, sort_rows, verdict_text
from ces_identify.jobs.job import DONE
from ces_identify.jobs.row_log import Row
from ces_observer.json_checks import write_atomically

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Sim-to-real gap of a fleet</title><style>
:root {{ color-scheme: light dark; --ink: #1c2430; --pale: #667080; --line: #dde2e8; --paper: #fff; --bar: #2a6fb0;
  --rest: #9fc0df }}
@media (prefers-color-scheme: dark) {{ :root {{ --ink: #e6eaf0; --pale: #98a2b0; --line: #2c343f; --paper: #14181d;
  --bar: #6aa9e4; --rest: #34577a }} }}
body {{ font: 15px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper); margin: 2.5rem auto;
  max-width: 64rem; padding: 0 1.2rem }}
h1 {{ font-size: 1.5rem; margin: 0 }} p {{ color: var(--pale); margin: .2rem 0 1.6rem }} a {{ color: var(--bar) }}
table {{ border-collapse: collapse; width: 100% }}
th {{ text-align: left; font-weight: 600; color: var(--pale); font-size: .85rem }}
th, td {{ padding: .45rem .7rem .45rem 0; border-bottom: 1px solid var(--line); vertical-align: middle }}
.n {{ text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap }}
.gap {{ width: 26%; min-width: 9rem }} .gap div {{ position: relative; height: .8rem; background: none }}
.gap i {{ position: absolute; inset: 0 auto 0 0; background: var(--rest); border-radius: 2px }}
.gap i + i {{ background: var(--bar) }}
.key i {{ display: inline-block; width: .8rem; height: .8rem; border-radius: 2px; margin: 0 .3rem 0 .9rem;
  vertical-align: -1px }}
.failed {{ color: var(--pale) }}
</style></head><body>
<h1>Sim-to-real gap of a fleet</h1>
<p>{summary}<span class="key"><i style="background:var(--rest)"></i>gap
<i style="background:var(--bar)"></i>left after adding the effects</span></p>
<table><thead><tr><th>vehicle or recording</th><th>verdict</th><th class="n">probability</th><th>gap</th>
<th class="n">N RMS</th><th class="n">left</th><th class="n">shrink</th></tr></thead><tbody>
{rows}
</tbody></table></body></html>
"""


def write_page(rows: Sequence[Row], path: Path) -> None:
    """Write the page, largest gap first."""
    largest = max([row.get("gap_N") or 0.0 for row in rows], default=0.0) or 1.0
    body = "\n".join(_row(row, largest) for row in sort_rows(rows))
    write_atomically(path, PAGE.format(summary=escape(_summary(rows)), rows=body))


def _summary(rows: Sequence[Row]) -> str:
    done = [row for row in rows if row["status"] == DONE]
    counts = Counter(verdict_text(row) for row in done)
    verdicts = "; ".join(f"{count} × {verdict}" for verdict, count in counts.most_common(6))
    return f"{len(done)} of {len(rows)} diagnosed. {verdicts}"


def _row(row: Row, largest: float) -> str:
    if row["status"] != DONE:
        return f'<tr class="failed"><td>{escape(row["name"])}</td><td colspan="6">{escape(row["reason"])}</td></tr>'
    gap, after = row["gap_N"] or 0.0, row["gap_after_N"] or 0.0
    bars = "".join(f'<i style="width:{100.0 * min(value / largest, 1.0):.1f}%"></i>' for value in (gap, after))
    cells = (format_number(row["gap_N"], ".1f"), format_number(row["gap_after_N"], ".1f"), shrink_text(row))
    return (
        f'<tr title="{escape(row["sentence"])}"><td><a href="{escape(row["folder"])}/report.html">'
        f"{escape(row['name'])}</a></td><td>{escape(verdict_text(row))}</td>"
        f'<td class="n">{format_number(row["probability"], ".2f")}</td><td class="gap"><div>{bars}</div></td>'
        + "".join(f'<td class="n">{cell}</td>' for cell in cells)
        + "</tr>"
    )
