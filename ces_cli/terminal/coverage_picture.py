"""Coverage of speed and current as a map: characters on the terminal, or an image file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.text import Text

from ces_identify.recordings.coverage import Coverage
from ces_observer.errors import CesError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STEPS = (0.0005, 0.002, 0.01, 0.03)  # shares of time at which the next darker block begins
BLOCKS = "·░▒▓█"
CELL = 2  # width of a cell in characters
SUFFIXES = (".png", ".svg", ".pdf")


def terminal_picture(coverage: Coverage) -> Text:
    """Return the map as text: speed to the right, current upwards, darker for more time."""
    rows, columns = coverage.share.shape
    centres = (coverage.current_edges[:-1] + coverage.current_edges[1:]) / 2
    lines = ["share of time over speed and current", f"{'A':>8}"]
    for row in reversed(range(rows)):
        cells = "".join(_block(share) * CELL for share in coverage.share[row])
        lines.append(f"{centres[row]:8.3f} ┤{cells}")
    top = coverage.speed_edges[-1]
    half = CELL * columns // 2
    lines.append(f"{'':8} └{'─' * (half - 1)}┬{'─' * half}")
    lines.append(f"{'':9}{-top:<+{half - 1}.2f} 0{top:>+{half - 1}.2f} m/s")
    lines.append(f"{'':9}{'rebound':<{half}}{'compression':>{half}}")
    legend = " ".join(f"{block} > {100 * step:g} %" for block, step in zip(BLOCKS[1:], STEPS, strict=True))
    lines.append(f"{'':9}{BLOCKS[0]} less  {legend}")
    lines.append(f"{'':9}the outermost columns include all higher speeds")
    return Text("\n".join(lines), no_wrap=True)


def _block(share: float) -> str:
    return BLOCKS[int(np.searchsorted(STEPS, share, side="right"))] if share > 0.0 else " "


def require_picture_name(path: Path) -> None:
    """Raise CesError if the suffix is not a picture format."""
    if path.suffix.lower() not in SUFFIXES:
        raise CesError(f"{path}: cannot draw a '{path.suffix}' picture; use one of {', '.join(SUFFIXES)}")


def save_picture(coverage: Coverage, title: str, path: Path) -> None:
    """Draw the map into an image file."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.colors import LogNorm

    figure, axes = plt.subplots(figsize=(8.0, 4.5), layout="constrained")
    percent = np.ma.masked_equal(100 * coverage.share, 0.0)
    norm = LogNorm(vmin=0.01, vmax=max(1.0, float(percent.max()) if percent.count() else 1.0))
    edges = (coverage.speed_edges, coverage.current_edges)
    mesh = axes.pcolormesh(*edges, percent, cmap="Blues", norm=norm, edgecolors="0.9", linewidth=0.5)
    axes.axvline(0.0, color="0.5", linewidth=0.8)
    axes.set(xlabel="speed [m/s], positive in compression", ylabel="current [A]")
    axes.set_title(title, loc="left", fontsize=10)
    axes.spines[["top", "right"]].set_visible(False)
    figure.colorbar(mesh, label="share of time per cell [%]", format="%g")
    write_picture(figure, path)


def style_axis(axis: Axes) -> None:
    """Apply the common look: a light grid, no frame above and on the right, small labels."""
    axis.grid(alpha=0.25, lw=0.6)
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=8)


def write_picture(figure: Figure, path: Path) -> None:
    """Save and close a figure; the image file appears under its name only when it is complete."""
    from matplotlib import pyplot as plt

    part = path.with_name(f".{path.stem}.part{path.suffix}")
    try:
        figure.savefig(part, dpi=150)
        part.replace(path)
    finally:
        plt.close(figure)
        part.unlink(missing_ok=True)
