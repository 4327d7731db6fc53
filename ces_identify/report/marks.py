"""Marks in a panel: curves, dots, bands and corridors, each with at most a few thousand points."""

from __future__ import annotations

import numpy as np

from ces_identify.numerics.arrays import F, I, Mask
from ces_identify.report.drawing import Panel


def line(p: Panel, x: F, y: F, css: str, breaks: Mask | None = None) -> str:
    """Return the curve through the finite points (n,), interrupted before each tick where `breaks` is true."""
    if len(x) > 3 * abs(p.x.stop - p.x.start):
        return band(p, x, y, css)
    finite = np.isfinite(y)
    lift = ~np.concatenate([[False], finite[:-1]]) | (np.zeros(len(x), bool) if breaks is None else breaks)
    points = zip(np.where(lift, "M", "L")[finite], p.x.px(x)[finite], p.y.px(y)[finite], strict=True)
    return _path(css, "".join(f"{pen}{a:.1f},{b:.1f}" for pen, a, b in points))


def band(p: Panel, x: F, y: F, css: str) -> str:
    """Return the area between the extremes of y (n,) in each pixel column, interrupted at columns without a point.

    A column reaches to the first point of the next one, so a jump between two columns is drawn as well.
    """
    finite = np.flatnonzero(np.isfinite(y))
    column = np.floor(p.x.px(x[finite])).astype(int)
    starts = np.flatnonzero(np.diff(column, prepend=column[:1] - 1))
    if not len(starts):
        return ""
    pixels = p.y.px(y[finite])
    top, bottom = np.minimum.reduceat(pixels, starts), np.maximum.reduceat(pixels, starts)
    after = starts[1:]
    joined = (column[after] - column[after - 1] == 1) & (finite[after] - finite[after - 1] == 1)
    top[:-1] = np.where(joined, np.minimum(top[:-1], pixels[after]), top[:-1])
    bottom[:-1] = np.where(joined, np.maximum(bottom[:-1], pixels[after]), bottom[:-1])
    return _area(css, column[starts], top - 0.5, bottom + 0.5)


def corridor(p: Panel, x: F, low: F, high: F, css: str) -> str:
    """Return the area between `low` and `high` (n,), interrupted at pixel columns without a finite point."""
    finite = np.flatnonzero(np.isfinite(low + high))
    column = np.floor(p.x.px(x[finite])).astype(int)
    starts = np.flatnonzero(np.diff(column, prepend=column[:1] - 1))
    if not len(starts):
        return ""
    top = np.minimum.reduceat(p.y.px(np.minimum(high[finite], p.y.high)), starts)
    bottom = np.maximum.reduceat(p.y.px(np.maximum(low[finite], p.y.low)), starts)
    return _area(css, column[starts], top, bottom)


def ribbon(p: Panel, x: F, low: F, high: F, css: str) -> str:
    """Return the area between two curves over x (n,); nothing if it has no height."""
    if not (high > low).any():
        return ""
    there, back = zip(p.x.px(x), p.y.px(high), strict=True), zip(p.x.px(x)[::-1], p.y.px(low)[::-1], strict=True)
    return _path(css, "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in (*there, *back)) + "Z")


def dots(p: Panel, x: F, y: F, css: str) -> str:
    """Return a dot at each finite point (n,)."""
    finite = np.isfinite(y)
    points = zip(p.x.px(x[finite]), p.y.px(y[finite]), strict=True)
    return _path(css, "".join(f"M{a:.1f},{b:.1f}h0" for a, b in points))


def _area(css: str, column: I, top: F, bottom: F) -> str:
    """Return the area between two edges [px] over some pixel columns."""
    filled = np.split(np.arange(len(column)), np.flatnonzero(np.diff(column) > 1) + 1)
    return _path(css + " area", "".join(_loop(column[c], top[c], bottom[c]) for c in filled))


def _loop(column: I, top: F, bottom: F) -> str:
    x = np.concatenate([[column[0]], column + 0.5, [column[-1] + 1]])
    there = zip(x, np.pad(top, 1, "edge"), strict=True)
    back = zip(x[::-1], np.pad(bottom, 1, "edge")[::-1], strict=True)
    return "M" + "L".join(f"{a:.1f},{b:.1f}" for a, b in (*there, *back)) + "Z"


def _path(css: str, d: str) -> str:
    return f'<path class="{css}" d="{d}"/>' if d else ""
