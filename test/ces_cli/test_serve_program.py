"""`ces serve` as a process: the address it prints, its end at Ctrl-C, and one line for each mistake."""

from __future__ import annotations

import os
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
from served_folders import BAGS

from ces_cli.main import main
from ces_cli.serve import make_parser

pytest.importorskip("flask", reason="Flask is not installed")

BROWSER = """\
import sys, urllib.request
with urllib.request.urlopen(sys.argv[1]) as answer:
    assert answer.status == 200
from pathlib import Path
Path(__file__).with_name("seen.part").write_text(sys.argv[1])
Path(__file__).with_name("seen.part").rename(Path(__file__).with_name("seen"))
"""


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


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_it_ends_in_order_when_its_connection_breaks(tmp_path: Path, number: signal.Signals) -> None:
    shutil.copytree(BAGS / "sine_4hz", tmp_path / "results" / "sine_4hz")
    running = serving(tmp_path / "results", TMPDIR=str(tmp_path))
    with running as (process, url), urllib.request.urlopen(f"{url}view/recording/sine_4hz") as answer:
        assert b"eading the bag" in answer.read()
        wait_until(lambda: bool(list(tmp_path.glob("ces-serve-*"))), "the work has begun")
        process.send_signal(number)
        assert process.communicate(timeout=PATIENCE_S) == ("stopped\n", "")
    assert list(tmp_path.glob("ces-serve-*")) == []


def test_open_starts_the_chosen_browser_while_it_serves(tmp_path: Path) -> None:
    browser = tmp_path / "browser"
    browser.write_text(f"#!{sys.executable}\n{BROWSER}")
    browser.chmod(0o755)
    with serving(tmp_path, "--open", BROWSER=str(browser)) as (process, url):
        wait_until((tmp_path / "seen").exists, "the browser has the page")
        assert (tmp_path / "seen").read_text() == url
        process.terminate()
        assert process.communicate(timeout=PATIENCE_S) == ("stopped\n", "")


def test_open_without_a_desktop_says_how_to_see_the_page(tmp_path: Path) -> None:
    with serving(tmp_path, "--open", BROWSER="", DISPLAY="", WAYLAND_DISPLAY="") as (process, url):
        port = urlsplit(url).port
        assert process.stderr is not None
        line = process.stderr.readline()
    tunnel = f"ssh -N -L {port}:localhost:{port} {socket.gethostname()} and open http://localhost:{port}/"
    assert line == f"warning: --open: no desktop here; on yours, run {tunnel}\n"


def test_another_address_gives_a_warning(tmp_path: Path) -> None:
    with serving(tmp_path, "--host", "0.0.0.0") as (process, url):
        assert url.startswith(f"http://{socket.gethostname()}:")
        local = f"http://127.0.0.1:{url.rpartition(':')[2]}"
        asked = urllib.request.Request(local, headers={"Host": url.split("/")[2]})
        with urllib.request.urlopen(asked) as answer:
            assert answer.status == 200
        process.terminate()
        assert f"warning: --host 0.0.0.0: everyone on that network can read {tmp_path}" in process.communicate()[1]


def test_a_port_in_use_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        said = f"cannot listen on 127.0.0.1, port {port}: Address already in use; choose another with --port"
        assert said in error_line(capsys, tmp_path, "--port", port)


def test_mistakes_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert "no such folder" in error_line(capsys, tmp_path / "missing", "--port", 0)
    assert "is not a folder" in error_line(capsys, tmp_path / "file", "--port", 0)
    assert "cannot listen on 203.0.113.7" in error_line(capsys, tmp_path, "--port", 0, "--host", "203.0.113.7")
    assert "cannot listen on no name at all" in error_line(capsys, tmp_path, "--port", 0, "--host", "no name at all")
    assert "signals.yaml" in error_line(capsys, tmp_path, "--port", 0, "--signals", tmp_path / "signals.yaml")


def test_without_flask_it_names_the_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ces_cli.serve.find_spec", lambda name: None)
    assert "pip install 'ces_observer[serve]'" in error_line(capsys, tmp_path)


def test_it_listens_on_this_computer_only_by_default() -> None:
    assert make_parser().parse_args(["."]).host == "127.0.0.1"
