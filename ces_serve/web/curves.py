"""The charts of the pages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from markupsafe import Markup


def campaign_chart(bags: str, rows: Sequence[dict[str, Any]]) -> list[Markup]:
    """Return the Pareto chart."""
    return []


def iteration_chart(rows: Sequence[dict[str, Any]]) -> list[Markup]:
    """Return costs against recorded seconds."""
    return []


def stroke_chart(runs: Sequence[dict[str, Any]], repeatability_m: float) -> list[Markup]:
    """Return the error of each run."""
    return []


def recording_chart(channels: Sequence[dict[str, Any]]) -> list[Markup]:
    """Return the signals against time."""
    return []


def search_chart(rows: Sequence[dict[str, Any]], seconds: float) -> list[Markup]:
    """Return the best cost against time."""
    return []
