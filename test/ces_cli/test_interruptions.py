"""Ctrl-C at any moment and a full disk: one clear line, and nothing is ever half written. And too little data."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from programs import NO_SHORT_FITS, ces, error_line
from shared_results import SharedResults
from small_recordings import make_columns, write_columns

from ces_cli.terminal import terminal
from ces_cli.terminal.progress import SearchProgress
from ces_identify.numerics.search import SearchResult
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically
from ces_observer.model import load_model

pytestmark = pytest.mark.slow
COLLINEAR = """\
force: {lags: [1]}
speed: {lags: [0, 0], powers: [1.0, 1.0], forms: [signed]}
position: {lags: [0], powers: [1.0], forms: [signed]}
current: {lags: [0], powers: [1.0], forms: [signed, magnitude]}
products: [[], [speed], [position], [current], [speed, current], [force]]
"""


@pytest.fixture
def work(shared_model: SharedResults, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder with the shared model; `ces identify` does without fits of other structures."""
    monkeypatch.setattr(*NO_SHORT_FITS)
    return shared_model.folder


def identify(folder: Path, *bags: Path | str, terms: int = 4) -> list[object]:
    words = ["identify", *(folder / name for name in bags), "--candidates", folder / "rules.yaml", "--terms", terms]
    return [*words, "--starts", 1, "--threads", 1]


def interrupt(*_: object, **__: object) -> None:
    raise KeyboardInterrupt


# ------------------------------------------------------------------------------------------------- insufficient data


def test_more_terms_than_candidates_gives_fewer_terms(work: Path, tmp_path: Path) -> None:
    assert ces(*identify(work, "one", terms=200), "--out", tmp_path / "m.json") == 0
    assert 1 <= len(load_model(tmp_path / "m.json").body.terms) <= 10


@pytest.mark.parametrize("driven", [lambda x: 0.5 + 0.0 * x, lambda x: 0.5 + 20.0 * x], ids=["constant", "as position"])
def test_collinear_candidates_give_a_model_with_finite_coefficients(
    work: Path, tmp_path: Path, driven: Callable[[object], object]
) -> None:
    (tmp_path / "rules.yaml").write_text(COLLINEAR)
    t, columns = make_columns(8.0, 1, 250.0)
    current = np.asarray(driven(columns["position"]))
    force = columns["force"] * (400 + 1500 * current) / (400 + 1500 * columns["current"])
    write_columns(tmp_path / "one", t, {**columns, "current": current, "force": force})
    assert ces(*identify(tmp_path, "one", terms=8), "--out", tmp_path / "m.json") == 0
    model = load_model(tmp_path / "m.json")
    assert max(abs(term.coefficient) for term in model.body.terms) < 1e6
    assert len({term.factors for term in model.body.terms}) == len(model.body.terms)


# --------------------------------------------------------------------------------------------- Ctrl-C at any moment


@pytest.mark.parametrize(
    "moment",
    [
        "ces_cli.terminal.terminal.read_recording",
        "ces_identify.structures.polynomial.assemble_problem",
        "ces_identify.identification.evaluate",
        "ces_observer.json_text.os.fsync",
        "ces_identify.report.page.page_template",
    ],
)
def test_ctrl_c_leaves_nothing_half_written(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    monkeypatch.setattr(moment, interrupt)
    words = [*identify(work, "one"), "--out", tmp_path / "m.json", "--report", tmp_path / "r.html"]
    assert error_line(capsys, *words, status=130) == "ces identify: interrupted"
    finished = ["m.json"] if moment == "ces_identify.report.page.page_template" else []
    assert [path.name for path in tmp_path.iterdir()] == finished


def test_ctrl_c_in_the_search_writes_the_best_so_far(
    work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pressed: list[bool] = []

    def listen(self: SearchProgress, news: object) -> None:
        if not pressed and isinstance(news, SearchResult) and len(news.chosen):
            pressed.append(True)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(SearchProgress, "listen", listen)
    words = ["identify", work / "one", "--terms", 60, "--time", 600, "--starts", 4, "--threads", 2]
    assert ces(*words, "--out", tmp_path / "m.json", "--report", tmp_path / "r.html") == 0
    model = load_model(tmp_path / "m.json")
    assert model.certificate is not None and model.provenance["selection"]["ended"] == "interrupted"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.json", "r.html"]


WRITING = {
    "replay": ("replay", "model.json", "one", "--out"),
    "simulate": ("simulate", "--sim", "model.json", "one", "--out"),
    "export": ("export", "model.json", "--out"),
    "export an FMU": ("export", "model.json", "--sources-only", "--out"),
    "validate": ("validate", "model.json", "one", "--report"),
}


def test_programs_turn_ctrl_c_into_an_exception_whatever_it_was_before() -> None:
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        assert terminal.run("x", lambda _: os.kill(os.getpid(), signal.SIGINT) or 0) == 130
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as under nohup and in background shells
        assert terminal.run("x", lambda _: os.kill(os.getpid(), signal.SIGINT) or 0) == 0
    finally:
        signal.signal(signal.SIGINT, before)


def test_ctrl_c_in_compiled_code_is_ctrl_c() -> None:
    """numba makes SystemErrors of it, each the cause of the next; others are errors of the program."""
    first = SystemError("returned a result with an exception set")
    first.__cause__ = KeyboardInterrupt()

    def fail(cause: Exception | None) -> int:
        raise SystemError("again") from cause

    assert terminal.run("x", lambda _: fail(first)) == 130
    with pytest.raises(SystemError):
        terminal.run("x", lambda _: fail(None))


def test_a_second_ctrl_c_spares_the_cleaning_up_but_does_not_wait_for_work(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[object] = []
    monkeypatch.setattr(terminal, "PATIENCE_S", 0.2)
    monkeypatch.setattr(terminal, "end_process", ended.append)

    def press(times: int) -> None:
        for _ in range(times):
            os.kill(os.getpid(), signal.SIGINT)

    def work(_: object) -> int:
        try:
            press(1)
        finally:
            press(3)
            assert not ended
            time.sleep(0.21)
            press(1)
        return 0

    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        assert terminal.run("x", work) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert ended == [signal.SIGINT]


@pytest.mark.parametrize(("name", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
@pytest.mark.parametrize("kind", ["export an FMU", "simulate", "replay"])
def test_a_signal_that_ends_leaves_nothing(work: Path, tmp_path: Path, name: str, status: int, kind: str) -> None:
    code = (
        "import os, signal, sys; from ces_cli.main import main; import ces_data.bags.writer as writer\n"
        f"signal.signal(signal.{name}, signal.SIG_DFL)\n"  # nohup and shells leave some ignored
        f"def end(*_): os.kill(os.getpid(), signal.{name})\n"
        "os.fsync = writer._move_into_place = end; sys.exit(main(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, *WRITING[kind], tmp_path / "m.fmu"]
    how: dict[str, Any] = {"cwd": work, "env": {**os.environ, "TMPDIR": str(tmp_path)}, "capture_output": True}
    done = subprocess.run(words, check=False, text=True, **how)
    said = f"ended by {name}; finished results are kept" if name != "SIGINT" else "interrupted"
    last = done.stderr.splitlines()[-1]  # those before say on a busy computer that it is starting
    assert (done.returncode, last.partition(": ")[2]) == (status, said)
    assert list(tmp_path.iterdir()) == []


# ------------------------------------------------------------------------------------------------------- a full disk


@contextmanager
def files_of_at_most(size: int) -> Iterator[None]:
    """Limit the files of this process to `size` bytes, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("name", "out", "size"),
    [
        ("simulate", "x.csv", 5000),
        ("replay", "x", 5000),
        ("export", "x.c", 6000),
        ("export an FMU", "x.fmu", 3000),
        ("validate", "x.html", 5000),
    ],
)
def test_a_full_disk_gives_one_line_and_leaves_nothing(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, name: str,
    out: str, size: int,
) -> None:  # fmt: skip
    monkeypatch.chdir(work)
    with files_of_at_most(size):
        line = error_line(capsys, *WRITING[name], tmp_path / out)
    assert "cannot be written: File too large" in line
    assert str(tmp_path / "x") in line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ctrl_c", [False, True])
def test_the_old_model_stays_as_it_was(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, ctrl_c: bool
) -> None:
    def fail(*_: object) -> None:
        raise KeyboardInterrupt if ctrl_c else OSError(28, "No space left on device")

    old = '{"schema": "ces-model/1"}'
    (tmp_path / "m.json").write_text(old)
    monkeypatch.setattr(Path, "replace", fail)
    words = [*identify(work, "one"), "--out", tmp_path / "m.json", "--overwrite"]
    line = error_line(capsys, *words, status=130 if ctrl_c else 2)
    if not ctrl_c:
        assert line.endswith(
            "m.json: cannot be written: No space left on device; free space there and run the same command"
        )
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("m.json", old)]


def test_several_files_are_written_together_or_not_at_all(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("old")
    with pytest.raises(CesError, match="missing/b: cannot be written"):
        write_all_atomically({tmp_path / "a": "new", tmp_path / "missing" / "b": b"new"})
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]
    write_all_atomically({tmp_path / "a": "new", tmp_path / "b": b"\x00"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"new", "b": b"\x00"}


# -------------------------------------------------------------------------------------------------- times of messages


def test_a_current_without_a_header_is_said_once_and_only_of_other_recorders(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ces("validate", work / "model.json", work / "one", work / "two") == 0
    assert "has no header" not in capsys.readouterr().err
    files = [tmp_path / "one.mcap", tmp_path / "two.mcap"]
    for file in files:  # a file alone does not say who wrote it
        shutil.copyfile(work / file.stem / file.name, file)
    assert ces("validate", work / "model.json", *files) == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "has no header" in line]
    assert said == [
        "warning: one: current: std_msgs/msg/Float64 on /valve_current has no header; stamped with the bag's log time "
        "(said once for all recordings)"
    ]
