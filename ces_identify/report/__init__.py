"""The report: a model and its evaluations go in, one self-contained HTML page for screen and print comes out.

The page loads nothing; figures are inline SVG with the page's colours. The name below is imported on its first use, so
that a chart (`plot.py`) can be drawn without what the report of a model needs.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ces_observer.lazy_names import import_on_use

if TYPE_CHECKING:
    from ces_identify.report.page import write_report

__getattr__ = import_on_use(__name__, {"ces_identify.report.page": ("write_report",)})

__all__ = ["write_report"]
