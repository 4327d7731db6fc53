"""The report: a diagnosis in, one self-contained HTML page out, understood in a minute, for screen and paper."""

from __future__ import annotations

from ces_gap.report.page import report_page

__all__ = ["report_page"]
