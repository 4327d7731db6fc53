"""The data of a chart as compact JSON: values as 16-bit steps in base64, long lines as extremes of groups."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ces_identify.numerics.arrays import F, I, Mask
from ces_identify.report.drawing import Panel
from ces_identify.report.plot_marks import Plot, PlotBand, PlotBars, PlotDots, PlotLine, PlotMark, PlotShade
from ces_identify.report.plot_svg import find_name_x, has_x_axis, x_range

MAX_POINTS = 60_000  # of a line
PAGE_BYTES = 2_700_000  # of a page with the data of all its charts
FIGURE_BYTES = 200_000  # of the figures of a recording, without data
MIN_BYTES = 300_000  # of the data of all charts of a page
POINT_BYTES = 2 / 3 * 4  # of one value of a line in base64
MISSING = 65535  # stands for a value that is not finite
STEPS = MISSING - 1
GAP = 3.0  # of the usual step of x: a longer one interrupts the extremes


@dataclass(frozen=True)
class PackedPlot:
    """The JSON text of a plot's data, and the largest number of samples that one point stands for."""

    text: str
    samples: int


def share_points(lines: int, recordings: int = 4) -> int:
    """Return the points that each line may have on a page of `lines` lines in all, so that it stays below 3 MB.

    A band counts as two lines. `recordings` is the number of those with figures of their own.
    """
    data = max(PAGE_BYTES - FIGURE_BYTES * recordings, MIN_BYTES)
    return int(min(MAX_POINTS, data / (POINT_BYTES * max(lines, 1))))


def pack(plot: Plot, panels: Sequence[Panel], max_points: int = MAX_POINTS) -> PackedPlot:
    """Return the data of a plot whose areas were drawn in `panels`; longer lines keep their extremes."""
    packer = _Packer(max_points)
    areas = []
    for number, (area, p) in enumerate(zip(plot.areas, panels, strict=True)):
        box = [p.x.start, p.y.stop, p.x.stop - p.x.start, p.y.start - p.y.stop]
        areas.append(
            {
                "box": [round(v, 1) for v in box],
                "label": area.y_label,
                "y": [p.y.low, p.y.high],
                "fixed": area.y_range is not None,
                "zero": area.around_zero,
                "whole": area.whole,
                "yTicks": area.y_ticks,
                "nameX": find_name_x(plot, p),
                "xLabel": plot.x_label if has_x_axis(plot, number) else "",
                "marks": [packer.mark(mark) for mark in area.marks],
            }
        )
    first = next((p for a, p in zip(plot.areas, panels, strict=True) if not a.whole), panels[0])
    full = panels[0].x if plot.free else None
    content = {
        "x": plot.x_label,
        "xTicks": plot.x_ticks,
        "free": plot.free,
        "view": [first.x.low, first.x.high],
        "full": [full.low, full.high] if full else list(x_range(plot)),
        "areas": areas,
        "arrays": packer.arrays,
    }
    return PackedPlot(_as_text(content), packer.samples)


class _Packer:
    """The arrays of a plot's marks; an array that several marks share is packed once."""

    def __init__(self, max_points: int) -> None:
        self.arrays: list[dict[str, Any]] = []
        self.samples = 1
        self._max_points = max_points
        self._known: dict[tuple[bool, bytes], int] = {}

    def mark(self, mark: PlotMark) -> dict[str, Any]:
        """Return a mark with the numbers of its arrays."""
        head = {"name": mark.name, "css": mark.css}
        if isinstance(mark, PlotBars):
            return {**head, "kind": "bars", "x": self._add(mark.edges, wide=True), "y": self._add(mark.values)}
        if isinstance(mark, PlotDots):
            return {**head, "kind": "dots", "x": self._add(mark.x, wide=True), "y": self._add(mark.y)}
        if isinstance(mark, PlotShade):
            return {**head, "kind": "shade", "spans": _spans(mark)}
        return {**head, **(self._line(mark) if isinstance(mark, PlotLine) else self._band(mark))}

    def _line(self, mark: PlotLine) -> dict[str, Any]:
        starts, size = self._groups(mark.x, mark.breaks)
        breaks = np.zeros(0) if mark.breaks is None else np.flatnonzero(mark.breaks)
        if size == 1:
            x, y = mark.x, mark.y
        else:
            x, y = _centres(mark.x, starts), _extremes(mark.y, starts)
            breaks = 2 * np.searchsorted(starts, breaks)
        return {
            "kind": "line",
            "x": self._add(x, wide=True),
            "y": self._add(y),
            "breaks": [int(b) for b in breaks if b],
        }

    def _band(self, mark: PlotBand) -> dict[str, Any]:
        starts, size = self._groups(mark.x, None)
        x, low, high = mark.x, mark.low, mark.high
        if size > 1:
            x = _centres(x, starts)
            low, high = np.repeat(np.fmin.reduceat(low, starts), 2), np.repeat(np.fmax.reduceat(high, starts), 2)
        return {"kind": "band", "x": self._add(x, wide=True), "low": self._add(low), "high": self._add(high)}

    def _groups(self, x: F, breaks: Mask | None) -> tuple[I, int]:
        """Return the first sample of each group that becomes two points, and the size of the groups (1: none)."""
        size = 1 if len(x) <= self._max_points else -(-2 * len(x) // self._max_points)
        self.samples = max(self.samples, size)
        return _group_starts(x, breaks, size), size

    def _add(self, values: F, wide: bool = False) -> int:
        key = wide, values.tobytes()
        if key not in self._known:
            self._known[key] = len(self.arrays)
            self.arrays.append(_encode(np.asarray(values, np.float64), wide))
        return self._known[key]


def _group_starts(x: F, breaks: Mask | None, size: int) -> I:
    """Return the first sample of each group; no group spans a gap of x or a break."""
    step = np.diff(x)
    usual = float(np.median(np.abs(step))) if len(step) else 0.0
    apart = np.concatenate([[True], np.abs(step) > GAP * usual])[: len(x)]
    if breaks is not None:
        apart = apart | breaks
    first = np.flatnonzero(apart)
    since = np.arange(len(x)) - np.repeat(first, np.diff(np.append(first, len(x))))
    return np.flatnonzero(since % size == 0)


def _centres(x: F, starts: I) -> F:
    """Return the two values of x of each group: at its first and at its middle sample."""
    middle = (starts + np.append(starts[1:], len(x))) // 2
    return np.stack([x[starts], x[middle]], axis=1).ravel()


def _extremes(y: F, starts: I) -> F:
    """Return the lowest and the highest value of each group, in the order in which the line rises or falls."""
    low, high = np.fmin.reduceat(y, starts), np.fmax.reduceat(y, starts)
    falls = y[np.append(starts[1:], len(y)) - 1] < y[starts]
    return np.where(falls[:, None], np.stack([high, low], 1), np.stack([low, high], 1)).ravel()


def _encode(values: F, wide: bool) -> dict[str, Any]:
    """Return an array as a start and a step if it is even, else as 16-bit (`wide`: 32-bit) steps of its range."""
    n = len(values)
    finite = np.isfinite(values)
    if not finite.any():
        return {"n": n, "even": [None, 0.0]}
    if finite.all():
        step = float(values[-1] - values[0]) / max(n - 1, 1)
        if np.abs(values - values[0] - step * np.arange(n)).max() <= 1e-6 * abs(step):
            return {"n": n, "even": [float(values[0]), step]}
    steps, kind = (2**32 - 2, "<u4") if wide else (STEPS, "<u2")
    low, high = float(values[finite].min()), float(values[finite].max())
    unit = (high - low) / steps or 1.0
    whole = np.where(finite, np.rint((np.where(finite, values, low) - low) / unit), steps + 1).astype(kind)
    return {
        "n": n,
        "low": low,
        "unit": unit,
        "bits": 32 if wide else 16,
        "data": base64.b64encode(whole.tobytes()).decode(),
    }


def _spans(mark: PlotShade) -> list[list[float]]:
    """Return the ranges of x of a shade; what is closer than the finest pixel is one."""
    room = float(np.ptp(mark.x)) / MAX_POINTS if len(mark.x) else 0.0
    return [[float(a), float(b)] for a, b in mark.spans(room)]


def _as_text(content: dict[str, Any]) -> str:
    """Return JSON that is the same text in HTML and in XML."""
    text = json.dumps(content, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
