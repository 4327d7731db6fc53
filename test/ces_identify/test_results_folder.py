"""Results on disk: whole lines only, models before their rows, one run at a time."""

import json
from dataclasses import dataclass

import pytest

from ces_identify import jobs as results
from ces_identify.jobs import CRASHED, DONE, FAILED, JobResult
from ces_observer.errors import CesError


@dataclass(frozen=True)
class ModelJob:
    key: str

    @property
    def identity(self):
        return {"key": self.key}

    @property
    def output(self):
        return f"models/{self.key}.json"


def result(key, status=DONE):
    files = {ModelJob(key).output: "{}\n"} if status == DONE else {}
    return JobResult({"key": key, "status": status, "bags": "µ"}, files)


def open_results(folder):
    return results.open_results(folder / "results.jsonl", "a campaign")


def test_rows_and_models_come_back(tmp_path):
    with open_results(tmp_path / "new" / "out") as results:
        results.add(result("a"))
        assert (tmp_path / "new/out/results.jsonl").read_bytes().endswith(b"}\n")
    with open_results(tmp_path / "new" / "out") as results:
        assert results.rows == {"a": {"key": "a", "status": DONE, "bags": "µ"}}
        assert (results.folder / ModelJob("a").output).read_text() == "{}\n"


@pytest.mark.parametrize("cut", [1, 7, 20])
def test_a_torn_last_line_is_dropped_and_the_next_one_whole(tmp_path, cut):
    with open_results(tmp_path) as results:
        results.add(result("a"))
        results.add(result("b"))
    path = tmp_path / "results.jsonl"
    path.write_bytes(path.read_bytes()[:-cut])
    with open_results(tmp_path) as results:
        assert list(results.rows) == ["a"]
        results.add(result("c"))
    assert [json.loads(line)["key"] for line in path.read_text().splitlines()] == ["a", "c"]


def test_a_broken_line_in_the_middle_is_named(tmp_path):
    (tmp_path / "results.jsonl").write_text('{"key": "a"}\nnonsense\n{"key": "b"}\n')
    with pytest.raises(CesError, match=r"results\.jsonl:2: is not a result"), open_results(tmp_path):
        pass


def test_what_need_not_be_computed_again(tmp_path):
    with open_results(tmp_path) as results:
        for key, status in (("done", DONE), ("lost", DONE), ("failed", FAILED), ("crashed", CRASHED)):
            results.add(result(key, status))
        (results.folder / ModelJob("lost").output).unlink()
        there = {key: results.has(ModelJob(key)) for key in ("done", "lost", "failed", "crashed", "new")}
    assert there == {"done": True, "lost": False, "failed": True, "crashed": False, "new": False}


def test_a_second_run_is_refused(tmp_path):
    pytest.importorskip("fcntl")
    with open_results(tmp_path), pytest.raises(CesError, match="another run is writing"), open_results(tmp_path):
        pass


def test_a_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CesError, match="cannot be written"), open_results(tmp_path / "file" / "out"):
        pass
