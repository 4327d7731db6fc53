"""The report: a diagnosis goes in, one self-contained HTML page for screen and paper comes out."""

from __future__ import annotations

from ces_gap.report.page import report_page

__all__ = ["report_page"]
