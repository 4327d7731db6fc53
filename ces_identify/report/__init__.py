"""The report: a model and its evaluations go in, one self-contained HTML page for screen and print comes out.

The page has no scripts and loads nothing; figures are inline SVG with the page's colours.
"""

from __future__ import annotations

from ces_identify.report.page import write_report

__all__ = ["write_report"]
