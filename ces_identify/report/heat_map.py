"""Heat maps: cells whose darkness shows a value, and their scale."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from markupsafe import escape

from ces_identify.numerics.arrays import F
from ces_identify.report.drawing import Panel, label

FAINTEST = 0.10  # opacity of a cell with a shade of 0
RAMP_CELLS = 24
RAMP_WIDTH = 300.0  # [px]


def cells(p: Panel, edges: tuple[F, F], values: F, shade: F, css: str, describe: Callable[[int, int], str]) -> str:
    """Return a rectangle for each cell (x, y) with `values` above 0, darker with `shade` (0 to 1).

    `edges` (x + 1,), (y + 1,) are on the panel's axes; `describe` returns the text of a cell.
    """
    out = []
    for a, b in zip(*np.nonzero(np.nan_to_num(values) > 0.0), strict=True):
        x, y = edges[0][a : a + 2], edges[1][b : b + 2]
        box = p.rect(x[0], x[1], f"{css} value", y[0], y[1]).removesuffix("/>")
        out.append(f'{box} fill-opacity="{_opacity(shade[a, b]):.2f}"><title>{escape(describe(a, b))}</title></rect>')
    return "\n".join(out)


def ramp(left: float, top: float, values: Sequence[float], css: str, unit: str, width: float = RAMP_WIDTH) -> str:
    """Return the scale from the faintest to the darkest cell with evenly spaced `values`."""
    step = width / RAMP_CELLS
    out = []
    for i in range(RAMP_CELLS):
        box = f'x="{left + i * step:.1f}" y="{top:.1f}" width="{step:.1f}" height="11"'
        out.append(f'<rect class="{css}" {box} fill-opacity="{_opacity(i / (RAMP_CELLS - 1)):.2f}"/>')
    for i, value in enumerate(values):
        text = f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"
        out.append(label(left + width * i / (len(values) - 1), top + 27, text, "tick mid"))
    return "\n".join([*out, label(left + width + 20, top + 10, unit, "name")])


def _opacity(shade: float) -> float:
    return FAINTEST + (1.0 - FAINTEST) * shade
