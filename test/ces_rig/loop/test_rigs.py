"""The rigs of an iteration: virtual, a folder of logs, set points of a rig behind topics."""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from iterate_examples import LIMITS, make_plan, sine_commands, small_rig

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError
from ces_rig.errors import RigError
from ces_rig.experiments.commands import RigCommands
from ces_rig.experiments.virtual import parse_experiment, run
from ces_rig.loop.rigs import DROP, FolderRig, RosRigSettings, RunWatch, VirtualRig, open_rig, smooth_move
from ces_rig.sensors import GRID_S


def test_it_records_what_ces_rig_records(tmp_path: Path) -> None:
    experiment = parse_experiment(
        {
            "duration_s": 2.0,
            "stroke": {"kind": "sine", "amplitude_m": 0.01, "frequency_Hz": 2.0},
            "current": {"kind": "constant", "current_A": 0.5},
        },
        "sine",
    )
    time = np.arange(2001) * 1e-3
    commands = RigCommands("experiment", experiment.stroke.samples(time, np.random.default_rng(0)), np.full(2001, 0.5))
    mine, theirs = VirtualRig().run(commands, tmp_path).channels, run(experiment).channels
    for name in ("position", "current", "force"):
        assert np.array_equal(mine[name].stamps_ns, theirs[name].stamps_ns)
    assert np.abs(mine["force"].values - theirs["force"].values).max() <= 2.0  # two quanta of the load cell
    assert pytest.approx(0.5e-3) == GRID_S


def test_it_repeats_exactly_and_its_noise_depends_on_the_seed(tmp_path: Path) -> None:
    rig, commands = small_rig(), sine_commands(duration_s=1.0)
    first, again = (rig.run(commands, tmp_path).channel("force").values for _ in range(2))
    other = rig.run(commands.repeat("sine", 2, 0.0), tmp_path).channel("force").values
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("limits", "rig", "part"),
    [
        ({"high_A": 9.0}, {"kind": "virtual"}, "set limits: low_A and high_A"),
        ({"stroke_m": 0.4}, {"kind": "virtual"}, "lower limits: stroke_m"),
        ({}, {"kind": "virtual", "damper": "missing.yaml"}, "missing.yaml: cannot be read"),
        ({}, {"kind": "virtual", "dampr": "x"}, "unknown key 'dampr'"),
        ({}, {"kind": "robot"}, "expected one of virtual, folder, ros"),
        ({}, {"kind": "folder", "mapping": "missing.yaml"}, "missing.yaml: cannot be read"),
    ],
)
def test_a_rig_that_cannot_do_it_is_refused_in_one_line(tmp_path: Path, limits: dict, rig: dict, part: str) -> None:
    plan = make_plan(tmp_path, limits={**LIMITS, **limits}, rig=rig)
    with pytest.raises(CesError, match=part) as error:
        open_rig(plan)
    assert "\n" not in str(error.value)


@pytest.mark.skipif(find_spec("rclpy") is not None, reason="ROS 2 is sourced")
def test_a_rig_behind_topics_needs_ros(tmp_path: Path) -> None:
    with pytest.raises(CesError, match="rclpy is missing; source ROS 2 first"):
        open_rig(make_plan(tmp_path, rig={"kind": "ros"}))


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


SETTINGS = RosRigSettings(rate_hz=100.0)


def test_a_run_has_the_strokes_of_the_experiment() -> None:
    commands = sine_commands()
    stroke_m, current_A = commands.at(0.01)
    assert stroke_m == pytest.approx(commands.stroke_m[::10], abs=1e-12)
    assert len(current_A) == 301


def test_a_move_begins_and_ends_at_rest() -> None:
    stroke_m = smooth_move(-0.01, 0.02, 1.0, 100.0)
    steps = np.diff(stroke_m)
    assert (stroke_m[0], stroke_m[-1]) == pytest.approx((-0.01, 0.02))
    assert steps.min() >= 0.0
    assert max(steps[0], steps[-1]) < 1e-6


def test_a_rig_that_lags_a_little_passes() -> None:
    watch, late = RunWatch(SETTINGS, "run", 0.0), 5
    strokes, _ = sine_commands().at(0.01)
    for k in range(late, len(strokes)):
        watch.check(0.01 * k, float(strokes[k]), (0.01 * k, float(strokes[k - late])))


def test_a_rig_that_does_not_follow_is_stopped() -> None:
    watch = RunWatch(SETTINGS, "run", 0.0)
    with pytest.raises(RigError, match=r"run: the stroke is 11\.\d mm from its set points"):
        for k in range(100):
            watch.check(0.01 * k, 0.001 * k, (0.01 * k, 0.0))


def test_a_silent_rig_is_stopped() -> None:
    watch = RunWatch(SETTINGS, "run", 10.0)
    watch.check(10.2, 0.0, None)
    with pytest.raises(RigError, match=r"no position for 0.60 s"):
        watch.check(10.6, 0.0, None)
