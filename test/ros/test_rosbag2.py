"""Bags that `ros2 bag record` writes, in every storage and however it ends, and their replay by `ros2 bag play`."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml

pytest.importorskip("rclpy", reason="ROS 2 is not sourced")

from bag_recorders import (
    NEEDS_ROSBAG2,
    Experiment,
    Recorder,
    SnapshotRecorder,
    assert_published,
    described_signals,
    lossless_node,
    play,
    run_ces,
    signals_mapping,
)
from conftest import new_namespace
from node_process import NodeProcess
from patience import PATIENCE_S
from vehicle import JOINT, STAMPED_CURRENT, Vehicle, stamp_of, wait

from ces_data.bags.reader import read_recording
from ces_data.findings import findings
from ces_observer.signals import Signals

pytestmark = NEEDS_ROSBAG2

SECONDS = 3.5
BY_MESSAGE = ("--compression-mode", "message", "--compression-format", "zstd", "--compression-queue-size", "0")
BY_FILE = ("--compression-mode", "file", "--compression-format", "zstd")
SQLITE = ("--storage", "sqlite3")
FINISHED = {
    "mcap": (),
    "sqlite": SQLITE,
    "mcap by message": (*BY_MESSAGE, "--compression-threads", "8"),
    "sqlite by message": (*SQLITE, *BY_MESSAGE),
    "split by duration, by file": (*BY_FILE, "--max-bag-duration", "1"),
    "split by size": ("--max-bag-size", "200000"),
    "fastwrite": ("--storage-preset-profile", "fastwrite"),
    "zstd_fast": ("--storage-preset-profile", "zstd_fast"),
}
KILLED = {  # and the least share of the samples that must have been stored
    "killed mcap": ((), 0.5),
    "killed fastwrite": (("--storage-preset-profile", "fastwrite"), 0.9),
    "killed zstd_fast": (("--storage-preset-profile", "zstd_fast"), 0.5),
    "killed by message": (BY_MESSAGE, 0.5),
    "killed split, by file": ((*BY_FILE, "--max-bag-duration", "1"), 0.4),
    "killed sqlite": (SQLITE, 0.8),
    "killed sqlite resilient": ((*SQLITE, "--storage-preset-profile", "resilient"), 0.8),
}


@pytest.fixture(scope="module")
def experiment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Experiment, dict[str, Recorder]]]:
    """Yield what was published once, and the ended recorders that all heard it."""
    folder = tmp_path_factory.mktemp("bags")
    options = {**FINISHED, **{name: words for name, (words, _) in KILLED.items()}}
    with Experiment(new_namespace()) as published:
        recorders = {
            name: Recorder(folder / name.replace(",", "").replace(" ", "_"), published.topics, words)
            for name, words in options.items()
        }
        try:
            published.meets(recorders.values())
            published.run(SECONDS)
            for name, recorder in recorders.items():
                recorder.ends(signal.SIGKILL if name in KILLED else signal.SIGINT)
        finally:
            for recorder in recorders.values():
                recorder.kill()
        yield published, recorders


def read(path: Path, signals: Signals) -> tuple[dict[str, tuple[np.ndarray, np.ndarray]], list[str]]:
    """Return the stamps and values of each signal, and the warnings; nothing may hinder the use of the recording."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(path, signals, ("position", "current", "force"))
    assert [finding for finding in findings(recording) if finding.severity == "error"] == []
    return {name: (c.stamps_ns, c.values) for name, c in recording.channels.items()}, [str(w.message) for w in caught]


@pytest.mark.parametrize("name", FINISHED)
def test_a_finished_recording_has_every_sample(experiment: tuple[Experiment, dict[str, Recorder]], name: str) -> None:
    published, recorders = experiment
    channels, texts = read(recorders[name].path, described_signals(published.namespace))
    for signal_name, (stamps, values) in channels.items():
        assert len(stamps) == len(published.published[signal_name])
        assert_published(published.published[signal_name], stamps, values)
    late = [text for text in texts if "sorted by stamp" in text]
    assert texts == late
    assert name.endswith("by message") or not late


@pytest.mark.parametrize("name", KILLED)
def test_a_killed_recorder_leaves_what_it_stored(experiment: tuple[Experiment, dict[str, Recorder]], name: str) -> None:
    published, recorders = experiment
    channels, texts = read(recorders[name].path, described_signals(published.namespace))
    for signal_name, (stamps, values) in channels.items():
        values_by_stamp = published.published[signal_name]
        assert len(stamps) >= KILLED[name][1] * len(values_by_stamp)
        if name == "killed by message":  # threads may not have stored the last ones in order
            known = {stamp: values_by_stamp[stamp] for stamp in stamps.tolist()}
            assert_published(known, stamps, values)
        else:
            assert_published(values_by_stamp, stamps, values)
    count = sum(len(stamps) for stamps, _ in channels.values())
    assert f"the {count} messages that it had stored are read" in texts[0]


def test_a_reindexed_recording_is_read_alike(
    experiment: tuple[Experiment, dict[str, Recorder]], tmp_path: Path
) -> None:
    published, recorders = experiment
    copy = shutil.copytree(recorders["killed zstd_fast"].path, tmp_path / "copy")
    before = read(copy, described_signals(published.namespace))[0]
    subprocess.run(["ros2", "bag", "reindex", str(copy)], check=True, timeout=PATIENCE_S, capture_output=True)
    assert (copy / "metadata.yaml").exists()
    after = read(copy, described_signals(published.namespace))[0]
    for name, (stamps, values) in before.items():
        np.testing.assert_array_equal(after[name][0], stamps)
        np.testing.assert_array_equal(after[name][1], values)


def test_the_programs_read_them_all_alike(experiment: tuple[Experiment, dict[str, Recorder]], tmp_path: Path) -> None:
    published, recorders = experiment
    signals = tmp_path / "signals.yaml"
    signals.write_text(yaml.safe_dump({"/**": {"ros__parameters": signals_mapping(published.namespace)}}))
    result = run_ces("info", *(r.path for r in recorders.values()), "--signals", signals, "--json")
    assert result.returncode == 0, result.stderr
    for recording in json.loads(result.stdout)["recordings"]:
        assert not [finding for finding in recording["findings"] if finding["severity"] == "error"]
        assert min(channel["count"] for channel in recording["channels"].values()) > 0.4 * 1000 * SECONDS


@pytest.fixture(scope="module")
def replayed(
    experiment: tuple[Experiment, dict[str, Recorder]], model_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> dict[int, tuple[float, float, float]]:
    published, recorders = experiment
    return replay_offline(recorders["mcap"].path, published.namespace, model_path, tmp_path_factory.mktemp("replayed"))


@pytest.mark.parametrize("options", [("--rate", "10"), ("--clock", "1000", "--rate", "3")])
def test_playing_a_bag_equals_the_offline_replay(
    experiment: tuple[Experiment, dict[str, Recorder]], replayed: dict[int, tuple[float, float, float]],
    options: tuple[str, ...], model_path: Path,
) -> None:  # fmt: skip
    published, recorders = experiment
    namespace, path, expected = published.namespace, recorders["mcap"].path, replayed
    given = {
        "model": model_path,
        "use_sim_time": "--clock" in options,
        "max_age_s": 0.0,
        "wait_for_current_s": 10.0,
        **STAMPED_CURRENT,
        **lossless_node(namespace),
    }
    node = NodeProcess.from_source(namespace, given)
    try:
        with Vehicle(namespace) as vehicle:
            vehicle.meets_node()
            play(path, published.topics, "--delay", "1", "--remap", f"/clock:={namespace}/clock", *options)
            wait(lambda: len(vehicle.estimates) >= len(expected), f"{len(expected)} estimates")
            vehicle.hears_value("jumps of time", "0, the last: none")
            heard = {stamp_of(m): (m.position[0], m.velocity[0], m.effort[0]) for m in vehicle.estimates}
    finally:
        node.kill()
    assert list(heard) == list(expected)
    np.testing.assert_allclose(list(heard.values()), list(expected.values()), rtol=1e-9, atol=1e-12)
    assert len(expected) > 0.9 * 1000 * SECONDS
    assert max(abs(force) for _, _, force in expected.values()) > 100.0


def replay_offline(path: Path, namespace: str, model: Path, folder: Path) -> dict[int, tuple[float, float, float]]:
    """Return position, speed and force by stamp from `ces replay`."""
    signals = folder / "signals.yaml"
    signals.write_text(yaml.safe_dump({"/**": {"ros__parameters": signals_mapping(namespace)}}))
    result = run_ces("replay", model, path, "--signals", signals, "--out", folder / "replayed")
    assert result.returncode == 0, result.stderr
    columns = [read_estimates(folder / "replayed", key) for key in ("position", "velocity", "effort")]
    return dict(zip(columns[0], zip(*(column.values() for column in columns), strict=True), strict=True))


def read_estimates(path: Path, key: str) -> dict[int, float]:
    """Return one of the numbers of the estimates in a bag, by stamp."""
    described = {"position": {"topic": "/observer/estimate", "field": f"{key}[{JOINT}]"}}
    channel = read_recording(path, Signals.from_mapping(described, "estimates"), ("position",)).channel("position")
    return dict(zip(channel.stamps_ns.tolist(), channel.values.tolist(), strict=True))


def test_a_recorder_in_snapshot_mode_writes_the_seconds_around_a_drift(
    vehicle: Vehicle, start: Callable[..., NodeProcess], tmp_path: Path
) -> None:
    recorder = SnapshotRecorder(vehicle, tmp_path / "drift")
    try:
        start(snapshot_service=recorder.service, snapshot_after_s=2.0, cost_window_s=3, cost_warn_J=20.0)
        vehicle.meets_node()
        recorder.meets(vehicle)
        with vehicle.driving(), vehicle.measuring(1.5):
            vehicle.hears_value("snapshot", "due within")
            asked_ns = time.time_ns()
            vehicle.hears_value("snapshot", "taken: the recorder has written")
        recorder.has_estimates_around(asked_ns, vehicle)
    finally:
        recorder.kill()
