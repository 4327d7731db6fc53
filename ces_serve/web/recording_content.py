"""The content of a recording's page, from what the inspection returned."""

from __future__ import annotations

from typing import Any

from ces_serve.web import curves
from ces_serve.web.tables import PageCell, PageContent, PageTable, cell


def recording_content(found: dict[str, Any]) -> PageContent:
    """Return signals with their statistics, findings, lines and other topics."""
    content = PageContent(
        facts=[("sha256", str(found["sha256"])[:16] + "…")],
        warnings=[f"{one['severity']}: {one['text']}" for one in found["findings"]],
        charts=curves.recording_chart(found["channels"]),
    )
    rows = [_signal(channel) for channel in found["channels"]]
    rows += [
        (PageCell(name), *[PageCell("–", numeric=True)] * 5, cell(value, ".4g"), cell(value, ".4g"))
        for name, value in found["constants"].items()
    ]
    headings = ("signal", "samples", "s", "Hz", "jitter ms", "gaps", "from", "to")
    content.tables = [PageTable("Signals", headings, tuple(rows))]
    topics = tuple((PageCell(t["name"]), PageCell(t["type"]), cell(t["count"], "d")) for t in found["topics"])
    if topics:
        content.tables.append(PageTable("Other topics", ("topic", "type", "messages"), topics))
    return content


def _signal(channel: dict[str, Any]) -> tuple[PageCell, ...]:
    return (
        PageCell(f"{channel['name']} [{channel['unit']}]"),
        cell(channel["count"], "d"),
        cell(channel["duration_s"], ".2f"),
        cell(channel["rate_Hz"], ".1f"),
        cell(channel["jitter_s"], ".3f", 1e3),
        cell(channel["gaps"], "d"),
        cell(channel["low"], ".4g"),
        cell(channel["high"], ".4g"),
    )
