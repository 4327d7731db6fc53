"""A running `ces identify` can be followed by other programs, and leaves nothing behind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from campaign_parts import RULES, made

from ces_cli.identify import program
from ces_cli.main import main
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.signals_file import load_signals
from ces_identify.progress_file import RunProgress, SearchProgressFile, read_progress


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    write_bag(tmp_path / "bag", recording_topics(made(1), load_signals()))
    (tmp_path / "rules.yaml").write_text(RULES)
    return tmp_path / "bag"


@pytest.mark.slow
def test_the_search_can_be_read_while_it_runs(bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[RunProgress] = []

    class WatchedFile(SearchProgressFile):
        def write(self, row: Mapping[str, Any]) -> None:
            super().write(row)
            progress = read_progress(tmp_path / ".model.json.progress")
            assert progress is not None
            seen.append(progress)

    monkeypatch.setattr(program, "SearchProgressFile", WatchedFile)
    words = ["--terms", "4", "--starts", "2", "--time", "60", "--threads", "1", "--no-band"]
    words += ["--candidates", str(tmp_path / "rules.yaml")]
    assert main(["identify", str(bag), "--out", str(tmp_path / "model.json"), *words]) == 0
    last = seen[-1]
    assert all(progress.alive for progress in seen)
    assert (last.head["program"], last.head["starts"], last.head["recordings"]) == ("identify", 2, ["bag"])
    costs = [row["cost"] for row in last.rows]
    assert costs and min(costs) < 50.0
    assert {row["seed"] for row in last.rows} <= {1, 2}
    assert sorted(one.name for one in tmp_path.iterdir()) == ["bag", "model.json", "rules.yaml"]
