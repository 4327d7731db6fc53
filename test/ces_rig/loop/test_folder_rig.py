"""A dyno behind a folder: a log is read when it is complete, never before; what cannot be used is reported once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from iterate_examples import sine_commands, small_rig

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_rig.loop.rigs import DROP, FolderRig

MAPPING = "time: {column: t}\nposition: {column: x, scale: 0.001}\ncurrent: {column: i}\nforce: {column: f}\n"


def dyno_log(recording: Recording, share: float = 1.0) -> str:
    """Return the log of a dyno that samples all three at the stamps of the position."""
    position = recording.channel("position")
    count = int(share * len(position))
    at = position.stamps_ns[:count]
    columns = [
        (at - at[0]) * 1e-9,
        1e3 * position.values[:count],
        *(np.interp(at, recording.channel(n).stamps_ns, recording.channel(n).values) for n in ("current", "force")),
    ]
    return "t,x,i,f\n" + "".join(",".join(f"{v:.6f}" for v in row) + "\n" for row in zip(*columns, strict=True))


class Operator:
    """Stands for the operator: does one thing at each look of the rig, and keeps the rig's notes."""

    def __init__(self, *acts: Callable[[], object]) -> None:
        self.acts, self.notes = list(acts), []

    def rig(self, mapping: Path | None) -> FolderRig:
        loaded = load_dyno_mapping(mapping) if mapping else None
        return FolderRig(loaded, load_signals(), 0.0, self.notes.append, self._sleep)

    def _sleep(self, seconds: float) -> None:
        assert self.acts, "the rig waits for a log that it should have read"
        self.acts.pop(0)()


@pytest.fixture
def mapping(tmp_path: Path) -> Path:
    path = tmp_path / "dyno.yaml"
    path.write_text(MAPPING)
    return path


def test_a_growing_log_is_read_when_it_is_complete(tmp_path: Path, mapping: Path) -> None:
    commands = sine_commands()
    text = dyno_log(small_rig().run(commands, tmp_path))
    log = tmp_path / DROP / "run 1.csv"
    half = len(text) // 2
    grow = [lambda: log.write_text(text[:half]), lambda: None, lambda: log.write_text(text), lambda: None]
    operator = Operator(*grow)
    recording = operator.rig(mapping).run(commands, tmp_path)
    assert len(recording.channel("force")) == len(text.splitlines()) - 1
    assert operator.acts == []
    assert len(operator.notes) == 2  # where to put the log, and why the half was not used
    assert "not used" in operator.notes[1]


def test_names_of_copies_in_progress_are_ignored(tmp_path: Path, mapping: Path) -> None:
    commands = sine_commands()
    text = dyno_log(small_rig().run(commands, tmp_path))
    part = tmp_path / DROP / "run.csv.part"
    acts = [lambda: part.write_text(text), lambda: None, lambda: part.rename(part.with_suffix("")), lambda: None]
    operator = Operator(*acts)
    operator.rig(mapping).run(commands, tmp_path)
    assert operator.acts == []


def test_a_log_that_is_too_short_is_reported_once_and_replaced(tmp_path: Path, mapping: Path) -> None:
    commands = sine_commands()
    recording = small_rig().run(commands, tmp_path)
    log = tmp_path / DROP / "run.csv"
    acts = [
        lambda: log.write_text(dyno_log(recording, 0.5)), *[lambda: None] * 4,
        lambda: log.write_text(dyno_log(recording)), lambda: None,
    ]  # fmt: skip
    operator = Operator(*acts)
    operator.rig(mapping).run(commands, tmp_path)
    assert ["1.5 s long; expected the whole of 3.0 s" in note for note in operator.notes] == [False, True]


def test_a_bag_needs_no_mapping_and_its_metadata(tmp_path: Path) -> None:
    commands = sine_commands()
    recording = small_rig().run(commands, tmp_path)
    bag = tmp_path / DROP / "bag"
    hidden = tmp_path / "metadata.yaml"

    def record() -> None:
        write_bag(bag, recording_topics(recording, load_signals()))
        (bag / "metadata.yaml").rename(hidden)

    operator = Operator(record, lambda: None, lambda: None, lambda: hidden.rename(bag / "metadata.yaml"), lambda: None)
    again = operator.rig(None).run(commands, tmp_path)
    assert np.array_equal(again.channel("force").values, recording.channel("force").values)
    assert operator.acts == []


def test_the_instructions_name_the_rest_the_range_and_the_place(tmp_path: Path, mapping: Path) -> None:
    commands = sine_commands().repeat("experiment_07", 1, 42.0)
    log = tmp_path / DROP / "run.csv"
    text = dyno_log(small_rig().run(commands, tmp_path))
    Operator(lambda: log.write_text(text), lambda: None).rig(mapping).run(commands, tmp_path)
    words = (tmp_path / "INSTRUCTIONS.txt").read_text()
    assert all(part in words for part in ("experiment_07", "rest for 42 s", "-10.0 to 10.0 mm", str(tmp_path / DROP)))
