"""Work that takes seconds, each in a process of its own: pages ask for it again until its result is there.

`Works` is the server's side; run as a program, this module is the process, which reads a recording or compares models:
a task as JSON in, a file with the result out. Its memory, files and time are limited: a small recording may unpack to
any size.
"""

from __future__ import annotations

import json
import logging
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import warnings
from collections import OrderedDict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ces_cli.desk.contents import PageContent, PageTable
from ces_cli.desk.items import format_number
from ces_data.bags.reader import list_topics, read_recording
from ces_data.checks.check import find_all_faults
from ces_data.findings import Finding, require_usable
from ces_data.recording import Recording, describe_days
from ces_data.samples import channel_stats
from ces_data.signals_file import load_signals
from ces_identify.comparison.compared_models import make_compared_model
from ces_identify.comparison.comparison import compare, name_sources
from ces_identify.comparison.comparison_report import comparison_page
from ces_identify.simulations.simulation import ModelSimulation
from ces_observer.errors import CesError
from ces_observer.model import load_model
from ces_report.plot import Plot, PlotArea, PlotLine, draw_plot, series_css
from ces_report.shell import PageHead

MAX_RUNNING, MAX_KEPT = 2, 32
LIMIT_S = 180  # [s] for each
LIMITS = ((resource.RLIMIT_AS, 8 << 30), (resource.RLIMIT_FSIZE, 8 << 30), (resource.RLIMIT_CORE, 0))
NEED = ("position", "current", "force")
FORMS = {  # of the columns: the statistic, its heading and its form
    "count": ("samples", "d"),
    "duration_s": ("s", ".2f"),
    "rate_Hz": ("Hz", ".1f"),
    "jitter_s": ("jitter s", ".2g"),
    "gaps": ("gaps", "d"),
    "low": ("from", ".4g"),
    "high": ("to", ".4g"),
}
MAX_POINTS = 5000  # of a line


@dataclass(frozen=True)
class WorkState:
    """How far some work is: its result, or why it failed, or neither while it runs or waits."""

    result: str | None = None
    problem: str = ""


class Works:
    """Runs work by key and keeps the latest results; may be used by many threads. `close` ends what runs."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._scratch = Path(tempfile.mkdtemp(prefix="ces-serve-"))
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        self._ended: OrderedDict[str, WorkState] = OrderedDict()

    def ask(self, key: str, task: Mapping[str, Any]) -> WorkState:
        """Return the state of the work `key`; it is begun when it is asked for first and a process is free."""
        with self._lock:
            for other, process in list(self._running.items()):
                if process.poll() is not None:
                    self._ended[other] = self._collect(other, self._running.pop(other).returncode)
            while len(self._ended) > MAX_KEPT:
                self._ended.popitem(last=False)
            if key not in self._ended and key not in self._running and len(self._running) < MAX_RUNNING:
                self._running[key] = self._start(key, task)
            return self._ended.get(key, WorkState())

    def close(self) -> None:
        """End all processes and remove their files."""
        with self._lock:
            for process in self._running.values():
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            shutil.rmtree(self._scratch, ignore_errors=True)

    def _start(self, key: str, task: Mapping[str, Any]) -> subprocess.Popen[bytes]:
        """Start a process in a group of its own, so that Ctrl-C at the terminal reaches the server alone."""
        folder = self._scratch / key
        folder.mkdir(parents=True, exist_ok=True)
        words = [sys.executable, "-m", "ces_cli.desk.work", json.dumps(task), str(folder / "result")]
        with (folder / "errors").open("wb") as errors:
            own = os.environ | {"TMPDIR": str(folder)}
            nothing = subprocess.DEVNULL
            return subprocess.Popen(words, stdin=nothing, stdout=errors, stderr=errors, start_new_session=True, env=own)

    def _collect(self, key: str, status: int) -> WorkState:
        """Return what a process has left, and remove its files."""
        folder = self._scratch / key
        try:
            if status == 0:
                return WorkState((folder / "result").read_text(encoding="utf-8"))
            if status == -signal.SIGALRM:
                return WorkState(problem=f"stopped: it took longer than {LIMIT_S} s")
            lines = (folder / "errors").read_text(encoding="utf-8", errors="replace").splitlines()
            if len(lines) > 1:  # a traceback
                logging.getLogger(__name__).error("%s", "\n".join(lines))
            return WorkState(problem=lines[-1] if lines else f"the process ended without a result (status {status})")
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def main(task: str, out: str) -> int:
    """Do a task and write its result to the file `out`; returns 0, or 1 with the reason on standard error."""
    for kind, limit in LIMITS:
        hard = resource.getrlimit(kind)[1]
        value = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (value, value))
    signal.alarm(LIMIT_S)
    given = json.loads(task)
    try:
        if "models" in given:
            text = compare_files(given["models"], given["bags"], given["signals"])
        else:
            text = json.dumps(asdict(inspect_recording(given["bags"][0], given["signals"])))
        Path(out).write_text(text, encoding="utf-8")
    except (CesError, OSError, MemoryError) as error:
        print(str(error) or "not enough memory", file=sys.stderr)
        return 1
    return 0


def compare_files(models: list[str], bags: list[str], signals: str | None) -> str:
    """Return the page that compares model files on bags; raises CesError."""
    described = load_signals(Path(signals) if signals else None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of stamps; the pages of the recordings show them
        recordings = [read_recording(Path(bag), described, NEED) for bag in bags]
    for recording in recordings:
        require_usable(recording)
    named = zip(name_sources(models), models, strict=True)
    compared = [make_compared_model(name, ModelSimulation(load_model(path)), path) for name, path in named]
    return comparison_page(compare(compared, recordings), PageHead(recorded=describe_days(recordings)))


def inspect_recording(path: str, signals: str | None) -> PageContent:
    """Return signals with statistics, findings, a chart and the other topics of a recording. Raises CesError."""
    described = load_signals(Path(signals) if signals else None)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(Path(path), described)
        topics = list_topics(Path(path))
    findings = (*find_all_faults(recording), *(Finding("warning", str(warning.message)) for warning in caught))
    rows = []
    for name, channel in recording.channels.items():
        stats = asdict(channel_stats(channel))
        texts = (format_number(stats[key], form).replace("nan", "–") for key, (_, form) in FORMS.items())
        rows.append((f"{name} [{channel.unit}]", *texts))
    rows += [(name, *["–"] * 5, *[format_number(value, ".4g")] * 2) for name, value in recording.constants.items()]
    headings = ("signal", *(heading for heading, _ in FORMS.values()))
    tables = [PageTable(caption="Signals", headings=headings, rows=rows)]
    used = described.list_topic_signals()
    others = [topic for topic in topics if not any(signal.matches(topic.name) for signal in used)]
    if others:
        cells = [(topic.name, topic.type, format_number(topic.count, "d")) for topic in others]
        tables.append(PageTable(caption="Other topics", headings=("topic", "type", "messages"), rows=cells))
    return PageContent(
        facts=[("sha256", f"{recording.sha256[:16]}…")],
        warnings=[f"{finding.severity}: {finding.text}" for finding in findings],
        charts=_draw_signals(recording),
        tables=tables,
    )


def _draw_signals(recording: Recording) -> list[str]:
    """Return the signals against time, one area below the other."""
    start_ns = min((int(c.stamps_ns.min()) for c in recording.channels.values() if len(c)), default=0)
    areas = []
    for k, (name, channel) in enumerate(recording.channels.items()):
        if len(channel) < 2:
            continue
        order = np.argsort(channel.stamps_ns, kind="stable")
        time_s = 1e-9 * np.asarray(channel.stamps_ns[order] - start_ns, np.float64)
        line = PlotLine(name, time_s, np.asarray(channel.values[order], np.float64), series_css(k))
        areas.append(PlotArea(f"{name.capitalize()} [{channel.unit}]", [line], height=110.0))
    plot = Plot("signals", "Signals over time", "The signals as logged.", "Time [s]", areas, 760.0, legend=False)
    return [draw_plot(plot, MAX_POINTS)] if areas else []


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
