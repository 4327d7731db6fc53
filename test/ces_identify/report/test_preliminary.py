"""The page that stands in the report's place while a search runs."""

from xml.etree import ElementTree

import numpy as np
import pytest

from ces_identify.polynomial.search_limits import SearchResult
from ces_identify.report import preliminary
from ces_identify.report.preliminary import PreliminaryReport


def result(cost, size=3):
    return SearchResult(np.arange(size), np.ones(size), cost, 1, 10, "running")


@pytest.mark.parametrize("before", [None, "the old report"])
def test_a_page_shows_better_models_until_the_report_replaces_it(tmp_path, monkeypatch, before):
    path = tmp_path / "report.html"
    if before:
        path.write_text(before)
    with pytest.raises(KeyboardInterrupt), PreliminaryReport() as page:
        page.begin(path, "Model <m>.json", {"recordings": "noise, sweep"})
        first = path.read_text()
        assert "Preliminary, as of" in first
        assert "No model yet" in first
        assert ElementTree.fromstring(first).find(".//{*}head/{*}meta[@http-equiv='refresh']") is not None
        page.listen(result(29.394))
        assert '<td class="n">29.39</td>' in path.read_text()
        monkeypatch.setattr(preliminary, "EVERY_S", 0.0)
        page.listen(result(31.0))
        page.listen(result(12.0, size=5))
        text = path.read_text()
        assert "31.00" not in text
        assert text.index("12.00") < text.index("29.39")
        raise KeyboardInterrupt
    assert [one.read_text() for one in tmp_path.iterdir()] == ([before] if before else [])


def test_the_report_stays_and_a_page_that_cannot_be_written_stops_nothing(tmp_path):
    with PreliminaryReport() as page:
        page.listen(result(30.0))  # without --report
    with PreliminaryReport() as page:
        page.begin(tmp_path / "report.html", "m", {})
        (tmp_path / "report.html").write_text("the report")
    assert (tmp_path / "report.html").read_text() == "the report"
    with PreliminaryReport() as page:
        page.begin(tmp_path / "no folder" / "report.html", "m", {})
