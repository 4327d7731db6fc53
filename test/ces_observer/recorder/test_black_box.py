"""Recordings out of the last seconds: what is in them, what they cost, and what may go wrong."""

from __future__ import annotations

import os
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from patience import PATIENCE_S
from raw_messages import CURRENT, MS, SECOND, TOPICS, channels, drive
from rosbags.rosbag2 import Reader

from ces_cli import main
from ces_cli.terminal.simulations import open_simulation, with_predictions
from ces_identify.recordings.bag_reader import read_recording
from ces_observer.recorder import record_folder
from ces_observer.recorder.black_box import OVERHEAD_BYTES, BlackBox
from ces_observer.signals import Signals

START = 1_700_000_000 * SECOND
NAME = "rear_damper_drift_2023-11-14-22-13"
Message = tuple[int, int, bytes]


def black_box(folder: Path, **options: float) -> BlackBox:
    return BlackBox(channels(), folder, **{"seconds": 2.0, "tail_s": 1.0, "pause_s": 10.0, **options})  # type: ignore[arg-type]


def keep(box: BlackBox, messages: list[Message]) -> None:
    """Keep messages as they come, with the watch every tenth of a second."""
    watched = 0
    for message in messages:
        box.add(*message)
        if message[1] >= watched + 100 * MS:
            watched = message[1]
            box.work(1e-3, watched)


def finish(box: BlackBox, now_ns: int) -> None:
    end = time.monotonic() + PATIENCE_S
    while box.busy:
        assert time.monotonic() < end
        box.work(1e-2, now_ns)


def test_the_bag_holds_the_seconds_before_and_after(tmp_path: Path) -> None:
    box = black_box(tmp_path / "records")
    messages = drive(START, 8.0)
    keep(box, [m for m in messages if m[1] < START + 5 * SECOND])
    assert box.save("rear damper: drift", START + 5 * SECOND, {"why": "J is 40%"})
    assert box.busy
    keep(box, [m for m in messages if m[1] >= START + 5 * SECOND])
    finish(box, START + 8 * SECOND)
    assert box.problem == ""
    assert box.saved == tmp_path / "records" / f"{NAME}-25"
    with Reader(box.saved) as reader:
        read = [(connection.topic, log_ns, bytes(raw)) for connection, log_ns, raw in reader.messages()]
    sent = [(TOPICS[channel][0], log_ns, raw) for channel, log_ns, raw in messages]
    assert '"why": "J is 40%"' in (box.saved / "metadata.yaml").read_text()
    first, last = sent.index(read[0]), sent.index(read[-1])
    assert read == sent[first : last + 1]
    assert START + 3 * SECOND - 200 * MS < read[0][1] <= START + 3 * SECOND + 200 * MS
    assert START + 6 * SECOND - 2 * MS < read[-1][1] <= START + 6 * SECOND + 200 * MS


@pytest.mark.filterwarnings("ignore::ces_identify.recordings.bag_reader.RecordingWarning")  # a Float64 has no stamp
def test_the_offline_programs_open_the_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    box = black_box(tmp_path)
    keep(box, drive(START, 3.0))
    box.save("drift", START + 3 * SECOND, {})
    box.close()
    assert box.saved is not None
    defaults, believed = Signals.from_mapping({}, "defaults"), open_simulation("topic:/observer/estimate")
    recording = read_recording(box.saved, defaults, ("position", "current", "force"))
    recording = with_predictions(believed, box.saved, recording, defaults)
    position, force = recording.channel("position"), recording.channel("force")
    assert len(position.values) == len(force.values) == pytest.approx(3000, abs=200)
    assert position.values.max() == pytest.approx(0.02, rel=1e-3)
    assert force.values.max() == pytest.approx(500.0, rel=1e-3)
    assert np.nanmax(believed.force(recording)) == pytest.approx(400.0, rel=1e-3)
    assert set(recording.channel("current").values) == {0.5}
    assert set((position.stamps_ns - START) % MS) == {0}  # header stamps, not times of arrival
    assert main.main(["info", str(box.saved)]) == 0
    text = capsys.readouterr().out
    assert "/measured_force" in text and "/observer/estimate" in text


def test_memory_is_bounded_by_bytes_and_by_time(tmp_path: Path) -> None:
    size = 100
    box = black_box(tmp_path, max_bytes=1000 * (size + OVERHEAD_BYTES))
    for k in range(5000):
        box.add(CURRENT, START + k * MS, bytes(size))
    assert 990 <= len(box._ring) <= 1000
    assert box._ring[-1][1] == START + 4999 * MS
    assert box._bytes == len(box._ring) * (size + OVERHEAD_BYTES)
    box.work(1e-3, START + 60 * SECOND)
    assert (len(box._ring), box._bytes) == (0, 0)


def test_time_set_back_empties_the_ring(tmp_path: Path) -> None:
    box = black_box(tmp_path)
    keep(box, drive(START, 0.3))
    box.work(1e-3, START - 3600 * SECOND)
    assert (len(box._ring), box._bytes) == (0, 0)


def test_time_set_back_in_the_tail_ends_it(tmp_path: Path) -> None:
    box = black_box(tmp_path)
    keep(box, drive(START, 0.5))
    box.save("drift", START + SECOND // 2, {})
    finish(box, START - 3600 * SECOND)
    assert box.problem == ""


def test_one_recording_at_a_time_and_a_pause_between(tmp_path: Path) -> None:
    box = black_box(tmp_path)
    keep(box, drive(START, 0.2))
    assert box.save("drift", START, {})
    assert not box.save("drift", START + 30 * SECOND, {})
    finish(box, START + 2 * SECOND)
    assert not box.save("drift", START + 9 * SECOND, {})
    assert box.save("drift", START + 10 * SECOND, {})


def test_names_are_free_and_only_so_many_bags_are_left(tmp_path: Path) -> None:
    box = black_box(tmp_path, pause_s=0.0, max_bags=3)
    saved = []
    for k in (0, 0, 0, 1, 2):
        keep(box, drive(START, 0.1))
        box.save("drift", START + k * SECOND, {})
        finish(box, START + (k + 1) * SECOND)
        saved.append(box.saved)
    assert [path.name[-4:] for path in saved if path] == ["3-20", "20_2", "20_3", "3-21", "3-22"]
    assert sorted(tmp_path.iterdir()) == sorted(path for path in saved[2:] if path)


def test_only_bags_of_its_own_are_removed(tmp_path: Path) -> None:
    for name in ("drift_2020-01-01-00-00-00", "drift_mine", "other_2020-01-01-00-00-00"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "metadata.yaml").touch()
        (tmp_path / name / f"{name}.mcap").touch()
    (tmp_path / "drift_2020-01-01-00-00-00" / "notes.txt").touch()
    box = black_box(tmp_path, max_bags=1)
    keep(box, drive(START, 0.1))
    box.save("drift", START, {})
    finish(box, START + SECOND)
    assert len(list(tmp_path.iterdir())) == 4


def test_what_an_interrupted_recording_left_is_removed(tmp_path: Path) -> None:
    box = black_box(tmp_path, pause_s=0.0)
    keep(box, drive(START, 1.0))
    box.save("drift", START, {})
    box.work(1e-6, START + SECOND)
    box.work(1e-6, START + SECOND)
    assert box._bag is not None
    box._bag._file.abandon()  # as the end of a process does
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".drift_")
    again = black_box(tmp_path, pause_s=0.0)
    again.save("drift", START + SECOND, {})
    finish(again, START + 3 * SECOND)
    assert sorted(tmp_path.iterdir()) == sorted([left, again.saved])  # another observer may be at it
    os.utime(left, (time.time() - 2 * 3600,) * 2)
    again.save("drift", START + 9 * SECOND, {})
    finish(again, START + 12 * SECOND)
    assert len(list(tmp_path.iterdir())) == 2
    assert not left.exists()


def test_an_impossible_folder_is_reported_and_survived(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    box = black_box(tmp_path / "file" / "records", pause_s=0.0)
    for _ in range(2):
        keep(box, drive(START, 0.1))
        assert box.save("drift", START, {})
        finish(box, START + SECOND)
        assert box.problem == f"{tmp_path}/file/records: a recording cannot be written: Not a directory"
        assert box.saved is None


def test_a_full_disk_is_reported_and_survived(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(record_folder.shutil, "disk_usage", lambda path: SimpleNamespace(free=100 << 20))
    box = black_box(tmp_path, pause_s=0.0)
    box.save("drift", START, {})
    finish(box, START + SECOND)
    assert "nearly full" in box.problem
    monkeypatch.undo()
    box.save("drift", START, {})
    finish(box, START + SECOND)
    assert (box.problem, box.saved is None) == ("", False)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_a_disk_that_fills_up_while_writing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    box = black_box(tmp_path, pause_s=0.0)
    keep(box, drive(START, 1.0))
    box.save("drift", START, {})
    box.work(1e-6, START + SECOND)
    assert box._bag is not None
    full = os.open("/dev/full", os.O_WRONLY)  # no write to it finds space
    os.dup2(full, box._bag._file._file.fileno())
    os.close(full)
    finish(box, START + SECOND)
    assert box.problem.endswith("No space left on device")
    assert list(tmp_path.iterdir()) == []


def test_older_bags_that_cannot_be_removed_do_not_hide_the_new_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(path: Path) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(record_folder, "remove_bag", refuse)
    box = black_box(tmp_path, pause_s=0.0, max_bags=1)
    for k in range(2):
        box.save("drift", START + k * SECOND, {})
        finish(box, START + (k + 1) * SECOND)
    assert box.saved is not None and box.saved.name.endswith("13-21")
    assert box.problem == f"{tmp_path}: an older recording cannot be removed: Permission denied"


def test_close_completes_a_started_recording(tmp_path: Path) -> None:
    box = black_box(tmp_path)
    box.close()
    assert list(tmp_path.iterdir()) == []
    keep(box, drive(START, 0.5))
    box.save("drift", START + SECOND // 2, {})
    box.close()
    assert box.saved is not None and box.saved.is_dir()
    assert not box.busy
