"""Who is answered: pages of the desk, in the browser that has its token; what is sent, and the headers of it."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

from pathlib import Path
from typing import Any

from flask.testing import FlaskClient
from served_folders import OWN, fill_folder, open_desk, write_report_page

from ces_cli.desk.app import Desk, is_own_name


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("served") / "root"
    root.mkdir()
    write_report_page(root.parent / "secret.html", "secret")
    (root / "linked.html").symlink_to(root.parent / "secret.html")
    (root / "outside").symlink_to(root.parent)
    write_report_page(root / ".hidden.html", "secret")
    (root / "notes.txt").write_text("private notes")
    (root / "other.html").write_text("<title>not ours</title><script>alert(1)</script>")
    return fill_folder(root)


@pytest.fixture
def client(root: Path) -> FlaskClient:
    client: FlaskClient = open_desk(root)[1]
    return client


def test_without_the_token_nothing_is_answered(root: Path) -> None:
    desk = Desk(root)
    client = desk.app.test_client()
    for path in (
        "/",
        "/?token=wrong",
        "/?token=",
        "/files/first.html",
        "/assets/desk.js",
        "/traces",
        f"/assets/desk.js?token={desk.token}",
    ):
        answer = client.get(path)
        assert (answer.status_code, "Set-Cookie" in answer.headers) == (403, False), path
    assert client.post("/run/info", headers=OWN).status_code == 403
    entry = client.get(f"/?token={desk.token}")
    assert entry.status_code == 200
    assert all(word in entry.headers["Set-Cookie"] for word in ("HttpOnly", "SameSite=Strict", desk.token))
    assert client.get("/").status_code == 200


REFUSED: dict[str, tuple[int, dict[str, Any]]] = {
    "another name": (421, {"headers": {"Host": "evil.example"}}),
    "another way": (405, {"method": "PUT"}),
    "another site": (403, {"headers": {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}}),
    "another port": (403, {"headers": {"Sec-Fetch-Site": "same-site", "Sec-Fetch-Mode": "no-cors"}}),
    "change without origin": (403, {"method": "POST", "path": "/run/info"}),
    "change from a report": (403, {"method": "POST", "path": "/run/info", "headers": {"Origin": "null"}}),
    "change from elsewhere": (403, {"method": "POST", "path": "/upload", "headers": {"Origin": "http://localhost:9"}}),
}


@pytest.mark.parametrize("who", REFUSED)
def test_who_is_refused_gets_nothing_of_the_folder(client: FlaskClient, root: Path, who: str) -> None:
    status, request = REFUSED[who]
    answer = client.open(**{"path": "/", **request})
    assert answer.status_code == status
    assert str(root) not in answer.text and "first.json" not in answer.text
    assert "Content-Security-Policy" in answer.headers


def test_only_names_of_this_computer_are_its_own() -> None:
    own = ("127.0.0.1:8000", "localhost:9999", "LOCALHOST", "[::1]:8000")
    assert all(is_own_name(name) for name in own)
    assert not any(
        is_own_name(name) for name in ("evil.example:80", "127.0.0.1.evil.example", "", "192.168.0.7:80", "[")
    )


def test_every_answer_has_the_headers(client: FlaskClient) -> None:
    for path in ("/", "/files/first.html", "/nothing", "/assets/desk.js"):
        headers = client.get(path).headers
        assert headers["X-Content-Type-Options"] == "nosniff", path
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin", path
        for part in ("default-src 'none'", "base-uri 'none'"):
            assert part in headers["Content-Security-Policy"], path
        assert not [name for name in headers.keys() if name.startswith("Access-Control")], path  # noqa: SIM118


def test_pages_run_only_the_scripts_of_the_desk(client: FlaskClient) -> None:
    answer = client.get("/?open=recordings/sine_4hz")
    assert "script-src 'self'; style-src 'self'" in answer.headers["Content-Security-Policy"]
    assert b"<style" not in answer.data and b" style=" not in answer.data and b"onclick" not in answer.data


def test_reports_are_sent_as_they_are_in_a_sandbox(client: FlaskClient, root: Path) -> None:
    answer = client.get("/files/first.html")
    assert answer.data == (root / "first.html").read_bytes()
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("sandbox allow-scripts") and "frame-ancestors 'self'" in policy
    assert "allow-same-origin" not in policy and "connect-src" not in policy  # none, by default-src
    assert client.get("/files/first.json").status_code == 200


NOT_SENT = (
    "notes.txt", "other.html", "linked.html", "missing.html", "../secret.html", "..%2fsecret.html", "/etc/passwd",
    "%2e%2e/secret.html", "worn/..%2f..%2fsecret.html", "%2fetc%2fpasswd", "first.html%00", "worn",
    "outside/secret.html", ".hidden.html", "x" * 5000, "..%5csecret.html", "worn/gap.json",
    "recordings/sine_4hz", "recordings/sine_4hz/metadata.yaml",
)  # fmt: skip


def test_nothing_else_is_sent(client: FlaskClient) -> None:
    for path in NOT_SENT:
        answer = client.get(f"/files/{path}", follow_redirects=True)
        assert answer.status_code == 404, path
        assert not [s for s in (b"private", b"root:", b"not ours", b">secret<") if s in answer.data], path
    for path in ("..%2fsecret.html", "%2fetc%2fpasswd", "outside/secret.html"):
        assert client.get(f"/traces?open={path}&pixels=9").status_code == 404
        assert client.post("/run/info", data={"recording": path}, headers=OWN).status_code == 404
