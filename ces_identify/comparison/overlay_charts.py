"""The charts of a comparison for one recording: forces and errors over time, and loops of force over speed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from markupsafe import Markup

from ces_identify.comparison.aligned_recording import MAX_GAP_S, AlignedRecording
from ces_identify.comparison.comparison import Comparison
from ces_identify.numerics.arrays import F
from ces_identify.report.plot import Plot, PlotArea, PlotLine, draw_plot, series_css, share_points

WINDOW_S = 1.5  # shown first
LOOP_POINTS = 900
LINES_OF_MODEL, LINES_OF_RECORDING = 4, 3  # in the charts of a recording


@dataclass(frozen=True)
class OverlayCharts:
    """The charts of one recording, and the window [s] that they show first."""

    over_time: Markup
    over_speed: Markup
    from_s: float
    to_s: float


def draw_overlay(comparison: Comparison, number: int) -> OverlayCharts:
    """Return the charts of the recording `number`."""
    whole = comparison.recordings[number]
    recording = replace(whole, forces=whole.forces[list(comparison.drawn)])
    names = [comparison.models[i].name for i in comparison.drawn]
    first, last = choose_window(recording)
    lines = len(comparison.drawn_recordings) * (LINES_OF_RECORDING + LINES_OF_MODEL * len(names))
    points = share_points(lines)
    view = (float(recording.time_s[first]), float(recording.time_s[last - 1]))
    return OverlayCharts(
        draw_plot(_time_plot(recording, names, number, view), points),
        draw_plot(_loop_plot(recording, names, number, slice(first, last)), points),
        *view,
    )


def choose_window(recording: AlignedRecording) -> tuple[int, int]:
    """Return the samples [first, last) of a window where the damper works and the errors are typical.

    Of the windows whose force varies at least as much as in the median one, it is that with the median error of all
    models together.
    """
    length = max(2, round(WINDOW_S * recording.rate_Hz))
    n = len(recording.time_s)
    if length >= n:
        return 0, n
    scored = recording.scored
    force = np.where(scored, recording.measured, 0.0)
    squares = np.where(scored, np.nansum((recording.measured - recording.forces) ** 2, axis=0), 0.0)
    count, one, two, error = (_sliding(v, length) for v in (scored.astype(float), force, force**2, squares))
    variance = np.where(count >= count.max(), two / count.max() - (one / count.max()) ** 2, -1.0)
    able = np.flatnonzero(variance >= np.median(variance[variance >= 0.0]))
    first = int(able[np.argsort(error[able], kind="stable")[len(able) // 2]])
    return first, first + length


def _sliding(values: F, length: int) -> F:
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[length:] - total[:-length])


def _time_plot(recording: AlignedRecording, names: list[str], number: int, view: tuple[float, float]) -> Plot:
    t, breaks = recording.time_s, np.diff(recording.time_s, prepend=recording.time_s[0]) > MAX_GAP_S
    measured = PlotLine("measured", t, recording.measured, "measured reference", breaks)
    forces = [
        PlotLine(name, t, f, series_css(i), breaks)
        for i, (name, f) in enumerate(zip(names, recording.forces, strict=True))
    ]
    errors = [
        PlotLine(name, t, np.where(recording.scored, recording.measured - f, np.nan), series_css(i), breaks)
        for i, (name, f) in enumerate(zip(names, recording.forces, strict=True))
    ]
    areas = [
        PlotArea("Force [N]", [measured, *forces], 190),
        PlotArea("Measured minus simulated [N]", errors, 110, around_zero=True),
        PlotArea("The same over the whole recording [N]", errors, 50, around_zero=True, whole=True),
    ]
    text = f"Measured force of {recording.name} and the free runs of {len(names)} models, with their errors below."
    return Plot(f"time{number}", f"Force over time, {recording.name}", text, "Time [s]", areas, 660, view, f"r{number}")


def _loop_plot(recording: AlignedRecording, names: list[str], number: int, window: slice) -> Plot:
    some = slice(window.start, window.stop, -(-(window.stop - window.start) // LOOP_POINTS))
    v = recording.speed[some]
    lines = [PlotLine("measured", v, recording.measured[some], "measured reference")]
    lines += [
        PlotLine(name, v, f[some], series_css(i))
        for i, (name, f) in enumerate(zip(names, recording.forces, strict=True))
    ]
    text = f"Force of {recording.name} over piston speed, measured and simulated, in the window shown first."
    area = PlotArea("Force [N]", lines, 380)
    return Plot(
        f"loop{number}", f"Force over speed, {recording.name}", text, "Speed [m/s]", [area], 440, free=True, x_ticks=5
    )
