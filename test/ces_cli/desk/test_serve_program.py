"""`ces serve` as a process: the address it prints, its end, and one line for each mistake."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from http.cookiejar import CookieJar
from pathlib import Path

import pytest
from patience import PATIENCE_S
from programs import error_line

HEARTBEAT = re.compile(r"^ *[0-9]+ s  ces serve: \w+\n", re.MULTILINE)  # on a busy machine


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "status", "out", "err"), [(signal.SIGINT, 0, "stopped", ""), (signal.SIGTERM, 143, "", "ces: ended")]
)
def test_it_serves_who_has_the_token_until_its_end(tmp_path: Path, end: int, status: int, out: str, err: str) -> None:
    for name in ("flask", "plotly"):
        pytest.importorskip(name, reason=f"{name} is not installed")
    code = (  # else ignored in the background
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        f"import sys; from ces_cli.main import main; sys.exit(main({['serve', str(tmp_path), '--port', '0']!r}))"
    )
    pipe, own = subprocess.PIPE, {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", code], stdout=pipe, stderr=pipe, text=True, env=own) as process:
        assert process.stdout is not None
        url = process.stdout.readline().split()[1]
        assert url.startswith("http://127.0.0.1:") and "/?token=" in url
        browser = urllib.request.build_opener(urllib.request.HTTPCookieProcessor(CookieJar()))
        assert tmp_path.name in browser.open(url).read().decode()
        assert b"Plotly" in browser.open(f"{url.partition('?')[0]}assets/plotly.js").read()
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(url.partition("?")[0])
        os.kill(process.pid, end)
        printed, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == status
    assert printed.startswith(out) and HEARTBEAT.sub("", said).startswith(err)
    assert list(tmp_path.iterdir()) == []


def test_mistakes_are_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ces_cli.desk.program.find_spec", lambda name: None)
    said = error_line(capsys, "serve", tmp_path)
    assert "flask and plotly: not installed; pip install 'ces_observer[serve]'" in said
    monkeypatch.setattr("ces_cli.desk.program.find_spec", lambda name: name)
    pytest.importorskip("flask", reason="Flask is not installed")
    assert "no such folder; expected one to work in" in error_line(capsys, "serve", tmp_path / "missing")
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        said = f"cannot listen on 127.0.0.1, port {port}: Address already in use; choose another with --port"
        assert said in error_line(capsys, "serve", tmp_path, "--port", port)
