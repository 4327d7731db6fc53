"""What the charts show in which colour: levels of current, sources, and the test points whose loops are shown."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from ces_identify.characteristics.motion import MEASURED
from ces_identify.characteristics.results import Characteristics
from ces_identify.characteristics.rows import ConditionRow
from ces_identify.report.plot import curve_css, series_css
from ces_identify.report.plot_marks import CURVES

MAX_TEST_POINTS = 3  # amplitudes and frequencies whose loops are shown
SAME_TEST = 0.06  # relative difference of amplitude and frequency within a test point
MANY_SOURCES = 3


@dataclass(frozen=True)
class Palette:
    """The classes of a line by source and current."""

    sources: tuple[str, ...]
    currents: tuple[float, ...]

    def css(self, source: str, current: float) -> str:
        """Return the classes of a line."""
        number = self.sources.index(source)
        if len(self.sources) >= MANY_SOURCES:
            return "measured" if source == MEASURED else series_css(number)
        curve = _shade(int(np.argmin(np.abs(np.array(self.currents) - current))), len(self.currents))
        return curve if source == MEASURED else f"{curve} beyond"

    def name(self, source: str, current: float) -> str:
        """Return the entry of the legend."""
        if len(self.sources) >= MANY_SOURCES:
            return source
        return f"{current:.3g} A" + ("" if source == MEASURED else f", {source}")


@dataclass(frozen=True)
class TestPoint:
    """An amplitude [m] and a frequency [Hz] that were run at one or several currents."""

    amplitude_m: float
    frequency_Hz: float

    @property
    def speed_m_s(self) -> float:
        """The peak speed of a sine [m/s]."""
        return 2.0 * np.pi * self.amplitude_m * self.frequency_Hz

    def holds(self, row: ConditionRow) -> bool:
        """Return whether a row belongs to this point."""
        close = abs(np.log(row.amplitude_m / self.amplitude_m)) <= SAME_TEST
        return bool(close and abs(np.log(row.frequency_Hz / self.frequency_Hz)) <= SAME_TEST)


def make_palette(results: Characteristics) -> Palette:
    """Return the palette of all levels of current."""
    return Palette(results.sources, tuple(sorted({row.current_A for row in results.peak_velocity})))


def choose_test_points(results: Characteristics) -> list[TestPoint]:
    """Return the points whose loops are shown: slowest, middle and fastest of those run at the most currents."""
    points: dict[TestPoint, set[float]] = {}
    for row in results.work:
        point = next((p for p in points if p.holds(row)), as_test_point(row))
        points.setdefault(point, set()).add(row.current_A)
    most = max((len(currents) for currents in points.values()), default=0)
    full = sorted((p for p, currents in points.items() if len(currents) == most), key=attrgetter("speed_m_s"))
    chosen = np.unique(np.rint(np.linspace(0, len(full) - 1, min(MAX_TEST_POINTS, len(full)))).astype(int))
    return [full[k] for k in chosen]


def as_test_point(row: ConditionRow) -> TestPoint:
    """Return the test point of a row."""
    return TestPoint(row.amplitude_m, row.frequency_Hz)


def _shade(number: int, count: int) -> str:
    """Return the classes of a curve; more than CURVES curves take shades halfway between two colours, too."""
    if count <= CURVES:
        return curve_css(number, count)
    step = round(number * 2 * (CURVES - 1) / (count - 1))
    return f"curve c{step // 2}{' half' if step % 2 else ''}"
