"""Recordings over time: the extremes in each pixel whatever the window, read once, in a process with limits."""

from __future__ import annotations

import shutil
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from patience import wait_until
from served_folders import BAGS

from ces_cli.desk.traces import BLOCK, SignalTrace, Traces
from ces_data.recording import Channel
from ces_observer.errors import CesError

N = 200_000


@pytest.fixture(scope="module")
def trace() -> SignalTrace:
    values = np.random.default_rng(1).normal(size=N)
    values[77_777], values[150_000:160_000] = 50.0, np.nan  # a spike of one sample, and force that was not measured
    stamps = np.arange(N) * 1_000_000 + 5
    stamps[120_000:] += 30_000_000_000  # a pause
    order = np.random.default_rng(2).permutation(N)
    return SignalTrace.of(Channel("force", "N", stamps[order], values[order]), 5)


@pytest.mark.parametrize("bounds", [(0.0, 230.0), (70.0, 90.0), (77.7, 77.9), (100.0, 160.0), (-50.0, 20.0)])
@pytest.mark.parametrize("pixels", [10, 300])
def test_the_extremes_of_each_pixel_are_those_of_its_samples(
    trace: SignalTrace, bounds: tuple[float, float], pixels: int
) -> None:
    time_s, values = trace.window(bounds, pixels)
    inside = (trace.time_s >= bounds[0]) & (trace.time_s <= bounds[1])
    if inside.sum() <= 2 * pixels:
        assert inside.sum() <= len(values) <= inside.sum() + 2
        return
    assert len(values) == 2 * pixels
    assert np.nanmax(values) == trace.values[inside][~np.isnan(trace.values[inside])].max()
    width = (bounds[1] - bounds[0]) / pixels + BLOCK * 1e-3
    for at, low, high in zip(time_s[::2], values[::2], values[1::2], strict=True):
        near = trace.values[(trace.time_s > at - width) & (trace.time_s < at + width)]
        assert np.isnan(low) or (low >= np.nanmin(near) and high <= np.nanmax(near))
    if bounds == (100.0, 160.0):
        assert np.isnan(values[(time_s > 122.0) & (time_s < 148.0)]).all()  # a pause is no line


def test_ten_million_samples_are_cut_in_milliseconds() -> None:
    stamps = np.arange(10_000_000) * 1_000_000
    whole = SignalTrace.of(Channel("force", "N", stamps, np.sin(stamps * 1e-9)), 0)
    began = time.perf_counter()
    for start in np.linspace(0.0, 5000.0, 10):
        whole.draw((start, start + 5000.0), 3000)
    assert (time.perf_counter() - began) / 10 < 0.5  # 0.01 s where nothing else runs


def read(traces: Traces, path: Path, *window: Any) -> dict[str, Any]:
    """Return the traces of a recording once they are read."""
    return wait_until(lambda: "traces" in (found := traces.ask(path, *(window or (None, 100)))) and found) or {}


@pytest.mark.slow
def test_a_recording_is_read_once_and_again_when_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(BAGS / "sine_4hz", tmp_path / "bag")
    traces = Traces()
    assert "so far" in traces.ask(tmp_path / "bag", None, 100)["reading"]
    found = read(traces, tmp_path / "bag")
    assert [(one["name"], one["unit"]) for one in found["traces"]] == [
        ("position", "m"),
        ("current", "A"),
        ("force", "N"),
    ]
    assert found["whole"][1] == pytest.approx(20.0, abs=0.1)
    monkeypatch.setattr("ces_cli.desk.traces._Reader", lambda *_: pytest.fail("read again"))
    part = traces.ask(tmp_path / "bag", (2.0, 2.01), 100)
    assert 10 <= len(part["traces"][0]["x"]) <= 13 and 1.9 < part["traces"][0]["x"][0] <= 2.0
    (tmp_path / "bag" / "metadata.yaml").touch()
    (reader,) = traces._readers.values()
    reader.until = np.inf
    traces.ask(tmp_path / "bag", None, 100)  # one that grows is shown for a while
    reader.until = 0.0
    with pytest.raises(BaseException, match="read again"):
        traces.ask(tmp_path / "bag", None, 100)


@pytest.mark.slow
def test_a_log_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    (tmp_path / "notes.csv").write_text("a,b\nx,y\n")
    with pytest.raises(CesError, match=r"notes\.csv"):
        read(Traces(), tmp_path / "notes.csv")
