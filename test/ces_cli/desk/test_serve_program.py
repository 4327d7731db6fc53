"""`ces serve` as a process: the address it prints, its end at Ctrl-C, and one line for each mistake."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from patience import PATIENCE_S, wait_until
from programs import error_line
from served_folders import BAGS

from ces_cli.desk.program import make_parser

HEARTBEAT = re.compile(r"^ *[0-9]+ s  ces serve: starting\n", re.MULTILINE)  # on a busy machine

pytestmark = pytest.mark.slow
pytest.importorskip("flask", reason="Flask is not installed")


@contextmanager
def serving(folder: Path, *words: str, **environment: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Yield the running program and its address."""
    code = (  # else ignored in the background, and under nohup
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
        f"import sys; from ces_cli.main import main; sys.exit(main({['serve', str(folder), '--port', '0', *words]!r}))"
    )
    command = [sys.executable, "-c", code]
    pipe = subprocess.PIPE
    env = {**os.environ, **environment}
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, start_new_session=True, env=env) as process:
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().split()[1]
        finally:
            if process.poll() is None:
                process.kill()


def test_it_serves_until_ctrl_c(tmp_path: Path) -> None:
    with serving(tmp_path) as (process, url):
        with urllib.request.urlopen(url) as answer:
            assert (answer.status, answer.headers["Server"]) == (200, "ces")
            assert tmp_path.name in answer.read().decode()
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out, HEARTBEAT.sub("", err)) == (0, "stopped\n", "")


def test_it_ends_in_order_when_its_connection_breaks(tmp_path: Path) -> None:
    shutil.copytree(BAGS / "sine_4hz", tmp_path / "results" / "sine_4hz")
    running = serving(tmp_path / "results", TMPDIR=str(tmp_path))
    with running as (process, url), urllib.request.urlopen(f"{url}view/recording/sine_4hz") as answer:
        assert b"eading the bag" in answer.read()
        wait_until(lambda: bool(list(tmp_path.glob("ces-serve-*"))), "the work has begun")
        process.send_signal(signal.SIGHUP)
        out, err = process.communicate(timeout=PATIENCE_S)
        assert (out, HEARTBEAT.sub("", err)) == ("stopped\n", "")
    assert list(tmp_path.glob("ces-serve-*")) == []


def test_another_address_gives_a_warning(tmp_path: Path) -> None:
    with serving(tmp_path, "--host", "0.0.0.0") as (process, url):
        assert url.startswith(f"http://{socket.gethostname()}:")
        port = urlsplit(url).port
        asked = urllib.request.Request(f"http://127.0.0.1:{port}/", headers={"Host": url.split("/")[2]})
        with urllib.request.urlopen(asked) as answer:
            assert answer.status == 200
        process.terminate()
        errors = HEARTBEAT.sub("", process.communicate(timeout=PATIENCE_S)[1]).splitlines()
    assert errors == [f"warning: --host 0.0.0.0: everyone on that network can read {tmp_path}"]


def test_a_port_in_use_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        said = f"cannot listen on 127.0.0.1, port {port}: Address already in use; choose another with --port"
        assert said in error_line(capsys, "serve", tmp_path, "--port", port)


def test_without_flask_it_names_the_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ces_cli.desk.program.find_spec", lambda name: None)
    assert "pip install 'ces_observer[serve]'" in error_line(capsys, "serve", tmp_path)


def test_it_listens_on_this_computer_only_by_default() -> None:
    assert make_parser().parse_args(["."]).host == "127.0.0.1"
