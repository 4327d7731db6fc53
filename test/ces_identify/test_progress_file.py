"""The progress file: what a search writes is read while it runs, and gone after it; no failure of it stops the work."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from ces_identify.polynomial.search_limits import SearchResult
from ces_identify.progress_file import ProgressFile, SearchProgressFile, progress_path, read_progress


def found(cost: float, seed: int = 1, ended: str = "running", size: int = 3) -> SearchResult:
    return SearchResult(np.arange(size), np.ones(size), cost, seed, 10, ended)


def costs(path: Path) -> list[float]:
    progress = read_progress(path)
    assert progress is not None
    return [row["cost"] for row in progress.rows if "cost" in row]


def test_a_search_is_there_while_it_runs_and_gone_after_it(tmp_path: Path) -> None:
    path = tmp_path / ".model.json.progress"
    with SearchProgressFile("identify", tmp_path / "model.json", {"starts": 2}) as file:
        file.listen(found(9.0))
        file.listen(found(7.5))
        progress = read_progress(path)
        assert progress is not None and progress.alive
        assert (progress.head["output"], progress.head["starts"], progress.head["pid"]) == (
            "model.json",
            2,
            os.getpid(),
        )
        assert [row["cost"] for row in progress.rows] == [9.0, 7.5]
        assert progress.rows[0]["elapsed_s"] <= progress.rows[1]["elapsed_s"]
    assert list(tmp_path.iterdir()) == []


def test_it_is_gone_after_an_error_too(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), ProgressFile("identify", tmp_path / "model.json", {}):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_of_two_programs_with_one_output_the_later_keeps_its_file(tmp_path: Path) -> None:
    first, later = (SearchProgressFile("identify", tmp_path / "model.json", {}) for _ in range(2))
    with contextlib.ExitStack() as stack:
        with first:
            stack.enter_context(later)
            first.listen(found(9.0))
            later.listen(found(8.0))
        assert costs(tmp_path / ".model.json.progress") == [8.0]
    assert list(tmp_path.iterdir()) == []


def test_only_what_is_new_is_written(tmp_path: Path) -> None:
    with SearchProgressFile("identify", tmp_path / "m", {}) as file:
        for result in (found(9.0), found(9.5, seed=2), found(9.5, seed=2, ended="no candidates left")):
            file.listen(result)
        assert costs(progress_path(tmp_path / "m")) == [9.0, 9.5]
        file.begin_step("the next search")
        file.listen(found(20.0))
        assert costs(progress_path(tmp_path / "m"))[-1] == 20.0


def test_many_threads_write_whole_lines(tmp_path: Path) -> None:
    with ProgressFile("jobs", tmp_path, {}) as file:
        threads = [threading.Thread(target=lambda: [file.write({"cost": 1.0}) for _ in range(50)]) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(costs(tmp_path / ".progress")) == 200


def test_a_folder_that_cannot_be_written_does_not_stop_the_work(tmp_path: Path) -> None:
    with SearchProgressFile("identify", tmp_path / "missing" / "model.json", {}) as file:
        file.listen(found(9.0))


@pytest.mark.slow
def test_a_killed_program_is_not_alive_even_before_its_parent_asks(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from ces_identify.progress_file import ProgressFile\n"
        f"ProgressFile('identify', Path({str(tmp_path / 'm')!r}), {{}}).__enter__(); print(); sys.stdin.read()"
    )
    with subprocess.Popen([sys.executable, "-uc", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None and process.stdout.readline()
        alive = read_progress(tmp_path / ".m.progress")
        assert alive is not None and alive.alive
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)  # it stays
        killed = read_progress(tmp_path / ".m.progress")
        assert killed is not None and not killed.alive
    gone = read_progress(tmp_path / ".m.progress")
    assert gone is not None and not gone.alive


def test_another_process_with_the_same_number_is_not_the_one(tmp_path: Path) -> None:
    with ProgressFile("identify", tmp_path / "m", {}):
        path = tmp_path / ".m.progress"
        head = json.loads(path.read_text())
        path.write_text(json.dumps({**head, "process_start": "1"}) + "\n")
        progress = read_progress(path)
        assert progress is not None and not progress.alive


def test_a_link_in_its_place_is_replaced_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "notes").write_text("mine")
    (tmp_path / ".m.progress").symlink_to(tmp_path / "notes")
    with ProgressFile("identify", tmp_path / "m", {}):
        assert read_progress(tmp_path / ".m.progress") is not None
    assert (tmp_path / "notes").read_text() == "mine"
    assert not (tmp_path / ".m.progress").is_symlink()


def test_a_name_that_is_not_text_does_not_stop_the_work(tmp_path: Path) -> None:
    with ProgressFile("identify", tmp_path / "m", {"recordings": ["caf\udce9"]}):
        progress = read_progress(tmp_path / ".m.progress")
    assert progress is not None and progress.head["recordings"] == ["caf?"]


def test_what_is_not_a_progress_file_is_none(tmp_path: Path) -> None:
    for n, content in enumerate(
        (b"", b"\xff\x00\n", b"[]\n", b'{"schema": "other"}\n', b'{"schema": "ces-progress/1"')
    ):
        path = tmp_path / f"{n}"
        path.write_bytes(content)
        assert read_progress(path) is None
    assert read_progress(tmp_path) is None
    assert read_progress(tmp_path / "missing") is None
