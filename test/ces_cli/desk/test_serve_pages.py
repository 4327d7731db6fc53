"""The pages: every thing has one, lists filter and sort, damaged files never make a server error."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import re
from dataclasses import replace
from pathlib import Path

from flask.testing import FlaskClient
from patience import wait_until
from served_folders import described_model, fill_folder

from ces_cli.desk.app import Site, make_app


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill_folder(tmp_path_factory.mktemp("results"))


@pytest.fixture
def client(root: Path) -> FlaskClient:
    return open_client(root)


@pytest.fixture(autouse=True)
def _always_new(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_cli.desk.catalogue.FRESH_S", 0.0)
    monkeypatch.setattr("ces_cli.desk.catalogue.WALKS", 0.0)  # of a slow walk, as on a busy computer


def open_client(folder: Path) -> FlaskClient:
    return make_app(Site(folder), "127.0.0.1").test_client()


def text_of(client: FlaskClient, path: str) -> str:
    answer = client.get(path)
    assert answer.status_code == 200, answer.text
    return answer.text


def names(page: str) -> list[str]:
    """Return the names in a list, in its order."""
    return re.findall(r'<td class="item" data-value="([^"]+)"', page)


def test_all_links_of_the_overview_and_of_the_lists_lead_somewhere(client: FlaskClient) -> None:
    waiting, seen = ["/"], set()
    while waiting:
        path = waiting.pop()
        if path in seen or "sort=" in path:
            continue
        seen.add(path)
        page = client.get(path)
        assert page.status_code == 200, path
        if page.mimetype == "text/html" and not path.startswith("/files"):
            waiting += [link.replace("&amp;", "&") for link in re.findall(r'href="(/[^"]*)"', page.text)]
    assert {"/list/model", "/view/result/sizes/results.jsonl", "/files/worn/report.html"} <= seen
    assert len([path for path in seen if path.startswith("/view/")]) == 12


def test_filter_of_a_list(client: FlaskClient) -> None:
    assert sorted(names(text_of(client, "/list/model?q=FIRST json"))) == ["first.json"]
    assert names(text_of(client, "/list/model?q=nothing+like+this")) == []
    assert "aa11.json" not in names(text_of(client, "/"))  # what is inside results: only by the filter
    assert names(text_of(client, "/?q=aa11")) == ["aa11.json"]


CONTENT = {
    "/view/model/first.json": ("Polynomial, 3 terms", "sine_4hz", "4.00", "1000 Hz", "estimates are held within"),
    "/view/result/sizes/results.jsonl": ("2 models, 1 failed", "/view/model/sizes/models/bb22.json"),
    "/view/result/worn/gap.json": ("riction", "/files/worn/report.html"),
    "/view/result/fleet/fleet.jsonl": ("2 units: 1 named", "/view/result/fleet/units/car_1/gap.json"),
    "/view/result/loop/iterations.jsonl": ("9.00 %", "/view/model/loop/iteration_02/model.json"),
}


@pytest.mark.parametrize("path", CONTENT)
def test_a_page_shows_what_its_file_says(client: FlaskClient, path: str) -> None:
    page = text_of(client, path)
    assert [words for words in CONTENT[path] if words not in page] == []


def test_damaged_files_are_named_and_never_an_error_of_the_server(tmp_path: Path) -> None:
    client = open_client(fill_folder(tmp_path, bags=False))
    files = [path for path in tmp_path.rglob("*") if path.suffix in (".json", ".jsonl")]
    assert len(files) == 11
    for damage in (b"", b"\x00\xff\xfe" * 50, b'{"schema": "ces-gap/1", "gap": []}', b"[]\n{}\n"):
        for path in files:
            path.write_bytes(damage)
        for page in ("/", "/list/unreadable", *CONTENT):
            assert client.get(page).status_code in (200, 404), (damage, page)
        assert "unreadable" in client.get("/").text


def test_an_error_of_the_program_is_logged(
    root: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("ces_cli.desk.contents.content_of", lambda *_: {}["no such key"])
    assert "cannot be read now" in text_of(open_client(root), "/view/model/first.json")
    assert "Traceback" in caplog.text and "no such key" in caplog.text


def test_a_file_that_changes_between_list_and_page_says_so(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_cli.desk.catalogue.FRESH_S", 60.0)
    client, path = open_client(root), root / "first.json"
    text_of(client, "/")
    before = path.read_text()
    try:
        path.write_text(before[:100])
        assert "cannot be read now" in text_of(client, "/view/model/first.json")
        path.unlink()
        assert "cannot be read now" in text_of(client, "/view/model/first.json")
    finally:
        path.write_text(before)


def test_an_empty_folder_says_what_to_do(tmp_path: Path) -> None:
    assert "ces identify BAG --out model.json" in text_of(open_client(tmp_path), "/")


def wait_for(client: FlaskClient, path: str) -> str:
    """Return a page once it no longer asks again."""
    found: list[str] = []

    def has_ended() -> bool:
        found.append(client.get(path, follow_redirects=True).text)
        return 'http-equiv="refresh"' not in found[-1]

    wait_until(has_ended)
    return found[-1]


@pytest.mark.slow
def test_a_recording_is_read_once(client: FlaskClient, monkeypatch: pytest.MonkeyPatch) -> None:
    page = wait_for(client, "/view/recording/recordings/sine_4hz")
    assert "1000.0" in page and "position [m]" in page and 'id="signals-plot"' in page
    monkeypatch.setattr("ces_cli.desk.work.Works._start", lambda *_: pytest.fail("read again"))
    assert wait_for(client, "/view/recording/recordings/sine_4hz") == page


@pytest.mark.slow
def test_a_damaged_bag_says_why(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("nonsense: [")
    client = open_client(tmp_path)
    assert "bag" in names(text_of(client, "/list/recording"))
    assert "cannot be opened as a bag" in wait_for(client, "/view/recording/bag")


def test_what_cannot_be_compared_is_said(client: FlaskClient) -> None:
    first = "/compare/result?model=first.json"
    assert "Models chosen: 1; choose 2 to 8" in text_of(client, f"{first}&bag=recordings/sine_4hz")
    assert "Recordings chosen: 0; choose 1 to 12" in text_of(client, f"{first}&model=second.json&bag=none")
    page = text_of(client, "/compare?model=first.json&model=second.json&model=../x")
    assert re.search(r'value="recordings/sine_4hz" checked', page)  # both were validated on it


def test_the_page_of_a_model_with_a_delay_says_when_the_force_is_known(tmp_path: Path) -> None:
    one = described_model(4.0)
    replace(one, sampling=replace(one.sampling, delay_s=0.003)).save(tmp_path / "late.json")
    assert "3 ms later" in text_of(open_client(tmp_path), "/view/model/late.json")
