"""`ces serve` as a process: the address it prints, its end at Ctrl-C, and one line for each mistake."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from patience import PATIENCE_S

from ces_cli.main import main
from ces_cli.serve.program import make_parser

pytest.importorskip("flask", reason="Flask is not installed")


@contextmanager
def serving(folder: Path, *words: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Yield the running program and its address."""
    code = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # else ignored in the background
    code += (
        f"import sys; from ces_cli.main import main; sys.exit(main({['serve', str(folder), '--port', '0', *words]!r}))"
    )
    command = [sys.executable, "-c", code]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().split()[1]
        finally:
            if process.poll() is None:
                process.kill()


def error_line(capsys: pytest.CaptureFixture[str], *words: object) -> str:
    assert main(["serve", *map(str, words)]) == 2
    line, *more = capsys.readouterr().err.splitlines()
    assert more == []
    return line


def test_it_serves_until_ctrl_c(tmp_path: Path) -> None:
    with serving(tmp_path) as (process, url):
        with urllib.request.urlopen(url) as answer:
            assert (answer.status, answer.headers["Server"]) == (200, "ces")
            assert tmp_path.name in answer.read().decode()
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out, err) == (0, "stopped\n", "")


def test_another_address_gives_a_warning(tmp_path: Path) -> None:
    with serving(tmp_path, "--host", "0.0.0.0") as (process, url):
        assert url.startswith("http://0.0.0.0:")
        process.terminate()
        assert f"warning: --host 0.0.0.0: everyone on that network can read {tmp_path}" in process.communicate()[1]


def test_a_port_in_use_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        assert f"port {port} of 127.0.0.1 is in use; choose another with --port" in error_line(
            capsys, tmp_path, "--port", port
        )


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert "no such folder" in error_line(capsys, tmp_path / "missing", "--port", 0)
    assert "is not a folder" in error_line(capsys, tmp_path / "file", "--port", 0)
    assert "cannot listen on 203.0.113.7" in error_line(capsys, tmp_path, "--port", 0, "--host", "203.0.113.7")
    assert "cannot listen on no name at all" in error_line(capsys, tmp_path, "--port", 0, "--host", "no name at all")
    with pytest.raises(SystemExit):
        main(["serve", str(tmp_path), "--port", "0", "--observer", "not a name"])
    assert "'not a name' is not the name of a node" in capsys.readouterr().err
    assert "signals.yaml" in error_line(capsys, tmp_path, "--port", 0, "--signals", tmp_path / "signals.yaml")


def test_without_flask_it_names_the_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ces_cli.serve.program.find_spec", lambda name: None)
    assert "pip install 'ces_observer[serve]'" in error_line(capsys, tmp_path)


def test_it_listens_on_this_computer_only_by_default() -> None:
    assert make_parser().parse_args(["."]).host == "127.0.0.1"
