"""What a request must pass: own names, reading only, no other site; and the headers of every response."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

from itertools import product
from pathlib import Path
from typing import Any

from flask.testing import FlaskClient
from served_folders import described_model, fill_folder, write_report_page

from ces_cli.desk.app import Site, is_own_name, make_app
from ces_cli.desk.catalogue import NotServedError, ServedFolder


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("served") / "root"
    root.mkdir()
    (root.parent / "secret.html").write_text("secret")
    write_report_page(root.parent / "secret_report.html", "secret")
    (root / "linked.html").symlink_to(root.parent / "secret_report.html")
    (root / "outside").symlink_to(root.parent)
    (root / "inside").symlink_to(root / "worn")
    write_report_page(root / ".hidden.html", "secret")
    (root / "notes.txt").write_text("private notes")
    (root / "script.py").write_text("private code")
    (root / "other.html").write_text("<title>not ours</title><script>alert(1)</script>")
    return fill_folder(root, bags=False)


@pytest.fixture
def client(root: Path) -> FlaskClient:
    return make_app(Site(root), "127.0.0.1").test_client()


def test_only_reading_is_allowed(client: FlaskClient) -> None:
    for method in ("POST", "PUT", "DELETE", "PATCH", "OPTIONS", "TRACE"):
        for path in ("/", "/files/first.html", "/compare/result"):
            assert client.open(path, method=method).status_code == 405, (method, path)
    answer = client.head("/")
    assert (answer.status_code, answer.data) == (200, b"")


NAMES = (
    ("127.0.0.1:8000", "127.0.0.1", True),
    ("localhost:9999", "127.0.0.1", True),  # through a tunnel
    ("LOCALHOST", "127.0.0.1", True),
    ("[::1]:8000", "::1", True),
    ("evil.example:8000", "127.0.0.1", False),
    ("127.0.0.1.evil.example", "127.0.0.1", False),
    ("", "127.0.0.1", False),
    ("192.168.0.7:8000", "0.0.0.0", True),
    ("evil.example", "0.0.0.0", False),
    ("rig-pc:8000", "rig-pc", True),
)


def test_only_own_names_are_answered() -> None:
    for header, bound, own in NAMES:
        assert is_own_name(header, bound) is own, header


REFUSED: dict[int, dict[str, Any]] = {
    421: {"headers": {"Host": "evil.example"}},
    405: {"method": "POST"},
    403: {"headers": {"Sec-Fetch-Site": "cross-site", "Sec-Fetch-Mode": "cors"}},
}


def test_who_is_refused_gets_nothing_of_the_folder(client: FlaskClient, root: Path) -> None:
    for status, request in REFUSED.items():
        answer = client.open("/", **request)
        assert answer.status_code == status
        assert str(root) not in answer.text and "Models" not in answer.text  # neither its place nor what it holds
        assert "Content-Security-Policy" in answer.headers


def test_other_sites_can_link_here_and_nothing_else(client: FlaskClient) -> None:
    other = {"Sec-Fetch-Site": "same-site"}
    assert client.get("/list/model", headers={**other, "Sec-Fetch-Mode": "cors"}).status_code == 403
    assert client.get("/files/first.json", headers={**other, "Sec-Fetch-Mode": "no-cors"}).status_code == 403
    assert client.get("/", headers={**other, "Sec-Fetch-Mode": "navigate"}).status_code == 200


def test_every_response_has_the_headers(client: FlaskClient) -> None:
    for path in ("/", "/files/first.html", "/nothing", "/assets/plots.js"):
        headers = client.get(path).headers
        assert headers["X-Content-Type-Options"] == "nosniff", path
        assert headers["Referrer-Policy"] == "no-referrer", path
        assert headers["Cross-Origin-Resource-Policy"] == "same-origin", path
        for part in ("default-src 'none'", "frame-ancestors 'none'"):
            assert part in headers["Content-Security-Policy"], path
        assert not [name for name in headers.keys() if name.startswith("Access-Control")], path  # noqa: SIM118


def test_pages_run_only_the_scripts_of_this_server(client: FlaskClient) -> None:
    answer = client.get("/")
    assert "script-src 'self'; style-src 'self'" in answer.headers["Content-Security-Policy"]
    assert b"<style" not in answer.data and b" style=" not in answer.data and b"onclick" not in answer.data


def test_reports_are_served_as_they_are_in_a_sandbox(client: FlaskClient, root: Path) -> None:
    answer = client.get("/files/first.html")
    assert answer.data == (root / "first.html").read_bytes()
    assert answer.headers["Content-Security-Policy"].startswith("sandbox allow-scripts")
    assert "allow-same-origin" not in answer.headers["Content-Security-Policy"]
    assert "connect-src" not in answer.headers["Content-Security-Policy"]  # none, by default-src


NOT_SERVED = (
    "notes.txt", "script.py", "other.html", "linked.html", "missing.html", "../secret.html", "..%2fsecret.html",
    "%2e%2e/secret.html", "sizes/..%2f..%2fsecret.html", "....//secret.html", "/etc/passwd", "%2fetc%2fpasswd",
    "first.html%00", "loop/iterations.jsonl%00.html", "file:///etc/passwd", "sizes", "outside/secret_report.html",
    ".hidden.html", "x" * 5000, "..%5csecret.html", "sizes/../../secret.html",
)  # fmt: skip


def test_nothing_else_is_served(client: FlaskClient) -> None:
    for path in NOT_SERVED:
        answer = client.get(f"/files/{path}", follow_redirects=True)
        assert answer.status_code in (404, 405), path
        assert not [s for s in (b"private", b"root:", b"not ours", b">secret<") if s in answer.data], path


@pytest.mark.parametrize("path", [".hidden.html", "..", "", "/etc/passwd", "sub/\0", "x" * 5000, "outside/secret.html"])
def test_there_is_no_way_out_of_the_folder(root: Path, path: str) -> None:
    with pytest.raises(NotServedError):
        ServedFolder(root).find(path)


def test_no_page_leaves_the_folder(client: FlaskClient) -> None:
    pages, ways = ("view/model", "view/recording"), ("..%2fsecret.html", "%2fetc%2fpasswd", "linked.html")
    for page, path in product(pages, ways):
        answer = client.get(f"/{page}/{path}", follow_redirects=True)
        assert answer.status_code in (200, 404), (page, path)
        assert b"root:" not in answer.data and b">secret<" not in answer.data


def test_names_are_escaped(tmp_path: Path) -> None:
    described_model().save(tmp_path / "<img src=x onerror=alert(1)>.json")
    (tmp_path / "<b>.json").write_text("")
    text = make_app(Site(tmp_path), "127.0.0.1").test_client().get("/").text
    assert "<img" not in text and "&lt;img src=x" in text and "&lt;b&gt;" in text


def test_nothing_is_written(client: FlaskClient, root: Path) -> None:
    before = {path: path.lstat().st_mtime_ns for path in root.rglob("*")}
    for path in ("/", "/view/result/sizes/results.jsonl", "/files/first.html", "/compare?model=first.json"):
        assert client.get(path).status_code == 200
    assert {path: path.lstat().st_mtime_ns for path in root.rglob("*")} == before
