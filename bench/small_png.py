"""Saves a figure of matplotlib as a PNG with few colours, at a third of the size."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from matplotlib import pyplot as plt
from PIL import Image

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def save_small(figure: Figure, path: Path, colours: int) -> None:
    """Save and close a figure; the file appears under its name only when it is complete."""
    pixels = BytesIO()
    figure.savefig(pixels, dpi=130)
    plt.close(figure)
    part = path.with_name(f".{path.stem}.part{path.suffix}")
    Image.open(pixels).convert("RGB").quantize(colours, dither=Image.Dither.NONE).save(part, optimize=True)
    part.replace(path)
