"""The pages: every thing has one, lists filter and sort, damaged files never make a server error."""

from __future__ import annotations

import pytest

pytest.importorskip("flask", reason="Flask is not installed")

import os
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from flask.testing import FlaskClient
from served_folders import described_model, fill_folder

from ces_identify.comparison import comparison
from ces_identify.progress_file import ProgressFile, SearchProgressFile
from ces_serve.web import compare
from ces_serve.web.app import make_app
from ces_serve.web.site import Site


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fill_folder(tmp_path_factory.mktemp("results"))


@pytest.fixture
def client(root: Path) -> FlaskClient:
    return open_client(root)


def test_as_many_models_can_be_chosen_as_charts_of_a_comparison_show() -> None:
    assert compare.MAX_MODELS == comparison.MAX_DRAWN


@pytest.fixture(autouse=True)
def _always_new(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_serve.files.catalogue.FRESH_S", 0.0)
    monkeypatch.setattr("ces_serve.files.catalogue.WALKS", 0.0)  # of a slow walk, as on a busy computer


def open_client(folder: Path) -> FlaskClient:
    return make_app(Site.open(folder), "127.0.0.1").test_client()


def text_of(client: FlaskClient, path: str) -> str:
    answer = client.get(path)
    assert answer.status_code == 200, answer.text
    return answer.text


def names(page: str) -> list[str]:
    """Return the names in a list, in its order."""
    return re.findall(r'<td class="item">(?:<a [^>]*>)?([^<]+)', page)


def read_events(client: FlaskClient, path: str, last: tuple[str, ...]) -> dict[str, list[str]]:
    """Return the data of a stream's events by name, until one of `last` has come."""
    found: dict[str, list[str]] = {}
    answer = client.get(path, buffered=False)
    for chunk in answer.response:
        match = re.match(rb"event: (\w+)\ndata: (.*)", chunk)  # type: ignore[arg-type]
        if match:
            found.setdefault(match[1].decode(), []).append(match[2].decode())
            if match[1].decode() in last:
                break
    answer.close()
    return found


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
    assert {
        "/list/model",
        "/view/model/first.json",
        "/view/campaign/sizes/results.jsonl",
        "/files/worn/report.html",
    } <= seen
    assert len([path for path in seen if path.startswith("/view/")]) == 13


def test_filter_and_order_of_a_list(client: FlaskClient) -> None:
    assert sorted(names(text_of(client, "/list/model?q=FIRST json"))) == ["first.json"]
    assert names(text_of(client, "/list/model?q=nothing+like+this")) == []
    rising = names(text_of(client, "/list/model?sort=cost_J"))
    assert rising[0] == "first.json" and rising[-1] == "aa11.json"
    assert names(text_of(client, "/list/model?sort=-cost_J")) == rising[::-1]
    assert 'aria-sort="descending"' in text_of(client, "/list/model?sort=-cost_J")
    assert names(text_of(client, "/list/model?sort=nonsense&page=-3")) != []


def test_the_overview_finds_what_is_inside_results_only_by_the_filter(client: FlaskClient) -> None:
    assert "aa11.json" not in names(text_of(client, "/"))
    assert names(text_of(client, "/?q=aa11")) == ["aa11.json"]


def test_long_lists_have_pages(tmp_path: Path) -> None:
    text = described_model().to_json()
    for number in range(201):
        (tmp_path / f"{number:03d}.json").write_text(text)
    client = open_client(tmp_path)
    first, second = (names(text_of(client, f"/?sort=name&page={page}")) for page in (1, 2))
    assert (len(first), second) == (200, ["200.json"])
    assert names(text_of(client, "/?sort=name&page=99")) == second


CONTENT = {
    "/view/model/first.json": ("Polynomial, 3 terms", "sine_4hz", "4.00", "1000 Hz"),
    "/view/campaign/sizes/results.jsonl": ("recommended", "too few ticks", "/view/model/sizes/models/bb22.json"),
    "/view/diagnosis/worn/gap.json": ("friction", "Causes, most probable first", "/files/worn/report.html"),
    "/view/fleet/fleet/fleet.jsonl": ("car_1", "no force", "/view/diagnosis/fleet/units/car_1/gap.json", "40.0"),
    "/view/iteration/loop/iterations.jsonl": ("experiment_02", "9.00", "/view/model/loop/iteration_02/model.json"),
    "/view/stroke/stroke/result.json": ("2.3000", "the error above the bandwidth stays"),
}


@pytest.mark.parametrize("path", CONTENT)
def test_a_page_shows_what_its_file_says(client: FlaskClient, path: str) -> None:
    page = text_of(client, path)
    assert [words for words in CONTENT[path] if words not in page] == []


@pytest.mark.parametrize(
    "path", ["campaign/sizes/results.jsonl", "iteration/loop/iterations.jsonl", "stroke/stroke/result.json"]
)
def test_charts_are_figures_without_styles_that_the_policy_forbids(client: FlaskClient, path: str) -> None:
    page = text_of(client, f"/view/{path}")
    figure = page[page.index('<div class="plot"') : page.index("</figure>")]
    assert ElementTree.fromstring(figure).find(".//{http://www.w3.org/2000/svg}title") is not None
    assert " style=" not in figure


def test_damaged_files_are_named_and_never_an_error_of_the_server(tmp_path: Path) -> None:
    client = open_client(fill_folder(tmp_path, bags=False))
    files = [path for path in tmp_path.rglob("*") if path.suffix in (".json", ".jsonl")]
    assert len(files) == 12
    for damage in (
        b"",
        b"\x00\xff\xfe" * 50,
        b'{"schema": "ces-model/1"}',
        b'{"schema": "ces-gap/1", "gap": []}',
        b"[]\n{}\n",
    ):
        for path in files:
            path.write_bytes(damage)
        for page in ("/", "/list/unreadable", *CONTENT):
            assert client.get(page).status_code in (200, 404), (damage, page)
        assert "unreadable" in client.get("/").text


def test_a_file_that_changes_between_list_and_page_says_so(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_serve.files.catalogue.FRESH_S", 60.0)
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


def test_a_recording_is_inspected_once(client: FlaskClient, monkeypatch: pytest.MonkeyPatch) -> None:
    found = read_events(client, "/events/inspect/recordings/sine_4hz", ("result", "failed"))
    assert "1000.0" in found["result"][0] and "position [m]" in found["result"][0]
    monkeypatch.setattr("ces_serve.web.work_events.do_work", lambda *_: pytest.fail("read again"))
    assert read_events(client, "/events/inspect/recordings/sine_4hz", ("result",))["result"] == found["result"]


def test_a_damaged_bag_says_why(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    (tmp_path / "bag" / "metadata.yaml").write_text("nonsense: [")
    client = open_client(tmp_path)
    assert "bag" in names(text_of(client, "/list/recording"))
    found = read_events(client, "/events/inspect/bag", ("result", "failed"))
    assert "cannot be opened as a bag" in found["failed"][0]


@pytest.fixture
def search(tmp_path: Path) -> Iterator[SearchProgressFile]:
    facts = {"seconds": 60.0, "starts": 4, "structure": "polynomial", "recordings": ["noise"]}
    with SearchProgressFile("identify", tmp_path / "new.json", facts) as file:
        file.write({"seed": 1, "cost": 30.0, "size": 2, "ended": "running"})
        yield file


def test_a_running_search_is_shown_and_followed_to_its_end(tmp_path: Path, search: SearchProgressFile) -> None:
    client = open_client(tmp_path)
    assert "new.json: identify, best selection cost J = 30.00 %" in text_of(client, "/")
    search.write({"seed": 2, "cost": 12.5, "size": 5, "ended": "no candidates left"})
    page = text_of(client, "/search/new.json")
    assert "12.500" in page and "1 of 4" in page and "noise" in page and 'id="search-plot"' in page
    answer = client.get("/events/search/new.json", buffered=False)
    seen: list[bytes] = []
    for chunk in answer.response:
        assert isinstance(chunk, bytes)
        seen.append(chunk)
        if chunk.startswith(b"event: content"):
            described_model().save(tmp_path / "new.json")
            search.__exit__(None, None, None)
        if chunk.startswith(b"event: ended"):
            break
    answer.close()
    assert b"/view/model/new.json" in seen[-1]
    assert "not running" in text_of(client, "/search/new.json")


def test_a_search_that_ended_before_its_page_was_followed_is_said_to_have_ended(
    tmp_path: Path, search: SearchProgressFile
) -> None:
    site = Site.open(tmp_path)
    client = make_app(site, "127.0.0.1").test_client()
    assert "/events/search/new.json" in text_of(client, "/search/new.json")
    described_model().save(tmp_path / "new.json")
    search.__exit__(None, None, None)
    site.catalogue.listing(anew=True)
    found = read_events(client, "/events/search/new.json", ("content", "ended"))
    assert "/view/model/new.json" in found["ended"][0] and "content" not in found


def test_a_killed_search_does_not_claim_the_result_of_a_run_before(tmp_path: Path) -> None:
    described_model().save(tmp_path / "new.json")
    os.utime(tmp_path / "new.json", (1e9, 1e9))
    killed = SearchProgressFile("identify", tmp_path / "new.json", {})
    killed.__enter__()
    file = tmp_path / ".new.json.progress"
    client = open_client(tmp_path)
    answer = client.get("/events/search/new.json", buffered=False)
    seen: list[bytes] = []
    for chunk in answer.response:
        assert isinstance(chunk, bytes)
        seen.append(chunk)
        file.write_text(file.read_text().replace('"process_start": "', '"process_start": "9'))
        if chunk.startswith(b"event: ended"):
            break
    answer.close()
    assert b"killed before its end without a new result" in seen[-1] and b"/view/model/new.json" not in seen[-1]
    assert "killed before its end without a new result" in text_of(client, "/search/new.json")


def test_a_running_campaign_shows_its_results_so_far(tmp_path: Path) -> None:
    folder = fill_folder(tmp_path, bags=False)
    with ProgressFile("jobs", folder / "sizes", {"things": "cells", "total": 9, "done": 2}) as file:
        client = open_client(folder)
        assert "sizes: 2 of 9 cells" in text_of(client, "/")
        file.write({"done": 3, "failed": 1})
        page = text_of(client, "/search/sizes")
        assert "3 of 9 cells done" in page and "recommended" in page


def test_the_page_of_the_observer_without_ros_says_so(client: FlaskClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    monkeypatch.setattr("ces_serve.live.link.find_python", lambda: None)
    assert "/events/observer" in text_of(client, "/observer")
    assert "ROS 2 is not sourced" in read_events(client, "/events/observer", ("observer",))["observer"][0]


def test_what_cannot_be_compared_is_said(client: FlaskClient) -> None:
    assert "Models chosen: 1; choose 2 to 8" in text_of(
        client, "/compare/result?model=first.json&bag=recordings/sine_4hz"
    )
    assert "Recordings chosen: 0; choose 1 to 12" in text_of(
        client, "/compare/result?model=first.json&model=second.json&bag=none"
    )
    page = text_of(client, "/compare?model=first.json&model=second.json&model=../x")
    assert re.search(r'value="recordings/sine_4hz" checked', page)  # both were validated on it
    assert client.get("/events/compare?model=first.json").status_code == 400
    assert client.get("/compare/page/0123").status_code == 404


def test_an_error_in_a_stream_is_its_last_event(client: FlaskClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ces_serve.web.lists._fingerprint", lambda listing: 1 / 0)
    assert "terminal of ces serve" in read_events(client, "/events/overview", ("failed",))["failed"][0]


def test_a_stream_begins_with_the_state_of_the_list_that_a_page_can_be_behind(tmp_path: Path) -> None:
    described_model().save(tmp_path / "a.json")
    site = Site.open(tmp_path)
    client = make_app(site, "127.0.0.1").test_client()

    def shown() -> str:
        match = re.search(r'data-state="([^"]+)"', text_of(client, "/"))
        assert match is not None
        return f'"{match[1]}"'

    before = shown()
    assert read_events(client, "/events/overview", ("listed",))["listed"] == [before]
    described_model().save(tmp_path / "b.json")
    site.catalogue.listing(anew=True)
    assert read_events(client, "/events/overview", ("listed",))["listed"] == [shown()] != [before]
