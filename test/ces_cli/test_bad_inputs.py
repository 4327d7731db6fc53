"""What goes wrong in practice: insufficient data, recordings that do not belong together, Ctrl-C at
any moment, a full disk. Each ends in one clear line, and nothing is ever half written."""

import os
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from ces_cli.main import main
from ces_cli.terminal import terminal
from ces_cli.terminal.progress import SearchProgress
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically
from ces_observer.model import load_model
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
INPUTS = ("speed", "current", "position")
RULES = """\
force: {lags: [1]}
speed: {lags: [0], powers: [0.5, 1.0], forms: [signed, magnitude]}
current: {lags: [0], powers: [1.0], forms: [magnitude]}
products: [[], [speed], [speed, current], [force]]
"""
COLLINEAR = """\
force: {lags: [1]}
speed: {lags: [0, 0], powers: [1.0, 1.0], forms: [signed]}
position: {lags: [0], powers: [1.0], forms: [signed]}
current: {lags: [0], powers: [1.0], forms: [signed, magnitude]}
products: [[], [speed], [position], [current], [speed, current], [force]]
"""


def make_channels(seconds=12.0, seed=1, rate=500.0, driven=None, **scales):
    """Return the channels of an invented damper, multiplied by `scales`; `driven` computes the current."""
    dice = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    x = 0.01 * np.sin(2 * np.pi * 3 * t) + 0.004 * np.sin(2 * np.pi * 7.3 * t + seed)
    v = np.gradient(x, t)
    i = 0.5 + 0.15 * np.sin(2 * np.pi * 0.7 * t) if driven is None else driven(x)
    force = np.sign(v) * np.abs(v) ** 0.5 * (400 + 1500 * i) + 100 * v + dice.normal(0, 3, len(t))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": (x, "m"), "current": (i, "A"), "force": (force, "N")}
    return {n: Channel(n, unit, stamps, scales.get(n, 1.0) * values) for n, (values, unit) in columns.items()}


def bag(path, **how):
    write_bag(path, recording_topics(Recording(path.name, make_channels(**how)), DEFAULT))
    return path


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with two bags that belong together, rules, and a model."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "rules.yaml").write_text(RULES)
    bag(folder / "one"), bag(folder / "two", seed=2)
    assert ces(*identify(folder, "one"), "--out", folder / "model.json") == 0
    return folder


def ces(*words):
    return main([str(word) for word in words])


def identify(folder, *bags, terms=4):
    words = ["identify", *(folder / name for name in bags), "--candidates", folder / "rules.yaml", "--terms", terms]
    return [*words, "--starts", 2, "--time", 10, "--threads", 2]


def run_and_get_line(capsys, status, *words):
    """Run a program that must end with `status`; return its error line without warnings."""
    capsys.readouterr()
    assert ces(*words) == status
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1
    return lines[0]


# ------------------------------------------------------------------------------------------------- insufficient data


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"seconds": 0.6}, "0 ticks with a measured force past warm-up; expected at least 50"),
        ({"seconds": 1.2}, "too short for estimation and selection; expected more than 4 s"),
        ({"seconds": 6.0, "rate": 40.0}, "estimation ticks; expected at least 200: record longer"),
    ],
)
def test_too_few_samples(work, tmp_path, capsys, how, message):
    bag(tmp_path / "short", **how)
    words = [*identify(work, tmp_path / "short", terms=100), "--out", tmp_path / "m.json"]
    assert message in run_and_get_line(capsys, 2, *words)
    assert not (tmp_path / "m.json").exists()


def test_more_terms_than_candidates_gives_fewer_terms(work, tmp_path):
    assert ces(*identify(work, "one", terms=200), "--out", tmp_path / "m.json") == 0
    assert 1 <= len(load_model(tmp_path / "m.json").body.terms) <= 10


@pytest.mark.parametrize("driven", [lambda x: 0.5 + 0.0 * x, lambda x: 0.5 + 20.0 * x], ids=["constant", "as position"])
def test_collinear_candidates_give_a_model_with_finite_coefficients(tmp_path, driven):
    (tmp_path / "rules.yaml").write_text(COLLINEAR)
    bag(tmp_path / "one", driven=driven)
    assert ces(*identify(tmp_path, "one", terms=8), "--out", tmp_path / "m.json") == 0
    model = load_model(tmp_path / "m.json")
    assert max(abs(term.coefficient) for term in model.body.terms) < 1e6
    assert len({term.factors for term in model.body.terms}) == len(model.body.terms)


def test_rules_that_explode_are_refused_with_their_count(work, tmp_path, capsys):
    lags, powers = list(range(200)), [0.5, 1.0, 1.5, 2.0]
    rows = [f"{name}: {{lags: {lags}, powers: {powers}, forms: [signed, magnitude]}}" for name in INPUTS]
    (tmp_path / "rules.yaml").write_text(
        "\n".join(["force: {lags: [1]}", *rows, "products: [[speed, current, position]]"])
    )
    line = run_and_get_line(
        capsys, 2, *identify(work, "one"), "--candidates", tmp_path / "rules.yaml", "--out", tmp_path / "m.json"
    )
    assert f"{1600**3} terms; at most" in line.replace(",", "")


# ------------------------------------------------------------------------- recordings that do not belong together


@pytest.mark.parametrize(
    ("scales", "message"),
    [
        ({"position": 1000.0}, "odd: position: spans 27"),
        ({"current": 1000.0}, "odd: current: reaches 6"),
        ({"force": 1e-3}, "by 1000 if it is in kN"),
        ({"force": -1.0}, "odd: force: acts with the motion"),
        ({"position": -1.0}, "odd: force: acts with the motion"),
    ],
)
def test_recordings_in_other_units_or_of_another_sign_are_refused(work, tmp_path, capsys, scales, message):
    odd = bag(tmp_path / "odd", seed=2, **scales)
    for words in ([*identify(work, "one", odd)], [*identify(work, "one"), "--validate", odd]):
        line = run_and_get_line(capsys, 2, *words, "--out", tmp_path / "m.json")
        assert message in line
        assert " odd" in line
        assert "--ignore-findings" in line
    assert not (tmp_path / "m.json").exists()


def test_with_force_such_recordings_are_a_warning(work, tmp_path, capsys):
    bag(tmp_path / "odd", force=-1.0, position=1000.0)
    assert ces(*identify(work, tmp_path / "odd"), "--ignore-findings", "--out", tmp_path / "m.json") == 0
    err = capsys.readouterr().err
    assert "warning: odd: position: spans 27" in err
    assert "warning: odd: force: acts with the motion" in err


# --------------------------------------------------------------------------------------------- Ctrl-C at any moment


def interrupt(*_, **__):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    "moment",
    [
        "ces_cli.terminal.terminal.read_recording",
        "ces_identify.identification.choose_sampling",
        "ces_identify.structures.polynomial.assemble_problem",
        "ces_identify.identification.evaluate",
        "ces_observer.json_text.os.fsync",
        "ces_identify.report.page.page_template",
    ],
)
def test_ctrl_c_leaves_nothing_half_written(work, tmp_path, capsys, monkeypatch, moment):
    monkeypatch.setattr(moment, interrupt)
    words = [*identify(work, "one"), "--out", tmp_path / "m.json", "--report", tmp_path / "r.html"]
    assert run_and_get_line(capsys, 130, *words) == "ces identify: interrupted"
    finished = ["m.json"] if moment == "ces_identify.report.page.page_template" else []
    assert [path.name for path in tmp_path.iterdir()] == finished


def test_ctrl_c_leaves_an_old_file_as_it_was(work, tmp_path, capsys, monkeypatch):
    (tmp_path / "m.json").write_text("old")
    monkeypatch.setattr(Path, "replace", interrupt)
    run_and_get_line(capsys, 130, *identify(work, "one"), "--out", tmp_path / "m.json", "--overwrite")
    assert (tmp_path / "m.json").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_ctrl_c_in_the_search_writes_the_best_so_far(work, tmp_path, monkeypatch):
    pressed = []

    def listen(self, result):
        if not pressed:
            pressed.append(True)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(SearchProgress, "listen", listen)
    words = ["identify", work / "one", "--terms", 60, "--time", 600, "--starts", 4, "--threads", 2]
    assert ces(*words, "--out", tmp_path / "m.json", "--report", tmp_path / "r.html") == 0
    model = load_model(tmp_path / "m.json")
    assert model.certificate is not None and model.provenance["selection"]["ended"] == "interrupted"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["m.json", "r.html"]


@pytest.mark.parametrize(
    "words", [("replay", "model.json", "one", "--out"), ("simulate", "--sim", "model.json", "one", "--out")]
)
def test_ctrl_c_while_a_bag_or_table_is_written(work, tmp_path, capsys, monkeypatch, words):
    monkeypatch.setattr("ces_data.bags.writer._move_into_place", interrupt)
    monkeypatch.setattr("ces_observer.json_text.os.fsync", interrupt)
    paths = [work / word if word in ("model.json", "one") else word for word in words]
    assert run_and_get_line(capsys, 130, *paths, tmp_path / "out") == f"ces {words[0]}: interrupted"
    assert list(tmp_path.iterdir()) == []


def test_programs_turn_ctrl_c_into_an_exception_whatever_it_was_before():
    before = signal.signal(signal.SIGINT, lambda *_: None)
    try:
        assert terminal.run("x", lambda _: os.kill(os.getpid(), signal.SIGINT) or 0) == 130
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as under nohup and in background shells
        assert terminal.run("x", lambda _: os.kill(os.getpid(), signal.SIGINT) or 0) == 0
    finally:
        signal.signal(signal.SIGINT, before)


# ------------------------------------------------------------------------------------------------------- a full disk


@contextmanager
def files_of_at_most(size):
    """Limit the files of this process to `size` bytes, as a full disk would."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    ("words", "name", "size"),
    [
        (("simulate", "--sim", "model.json", "one", "--out"), "x.csv", 5000),
        (("replay", "model.json", "one", "--out"), "x", 5000),
        (("export", "model.json", "--out"), "x.c", 6000),
        (("export", "model.json", "--sources-only", "--out"), "x.fmu", 3000),
        (("validate", "model.json", "one", "--report"), "x.html", 5000),
    ],
)
def test_a_full_disk_gives_one_line_and_leaves_nothing(work, tmp_path, capsys, words, name, size):
    given = [work / word if word in ("model.json", "one") else word for word in words]
    with files_of_at_most(size):
        line = run_and_get_line(capsys, 2, *given, tmp_path / name)
    assert "cannot be written: File too large" in line
    assert str(tmp_path / "x") in line
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_keeps_the_old_model(work, tmp_path, capsys, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    (tmp_path / "m.json").write_text("old")
    monkeypatch.setattr("ces_observer.json_text.os.fsync", full)
    line = run_and_get_line(capsys, 2, *identify(work, "one"), "--out", tmp_path / "m.json", "--overwrite")
    assert line.endswith("m.json: cannot be written: No space left on device; choose a writable folder")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("m.json", "old")]


def test_several_files_are_written_together_or_not_at_all(tmp_path):
    (tmp_path / "a").write_text("old")
    with pytest.raises(CesError, match="missing/b: cannot be written"):
        write_all_atomically({tmp_path / "a": "new", tmp_path / "missing" / "b": b"new"})
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("a", "old")]
    write_all_atomically({tmp_path / "a": "new", tmp_path / "b": b"\x00"})
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a": b"new", "b": b"\x00"}


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_output_stream_gives_one_line(work):
    with Path("/dev/full").open("w") as full:
        words = [sys.executable, "-m", "ces_cli.main", "info", str(work / "one")]
        done = subprocess.run(words, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert done.returncode == 2
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning: ")]
    assert lines == ["ces info: error: No space left on device, while reading or writing"]


# -------------------------------------------------------------------------------------------------- times of messages


def test_a_current_without_a_header_is_said_once_and_only_of_other_recorders(work, tmp_path, capsys):
    words = ["identify", work / "one", "--validate", work / "two", "--terms", 2, "--starts", 1, "--time", 1]
    assert ces(*words, "--candidates", work / "rules.yaml", "--out", tmp_path / "own.json") == 0
    assert "has no header" not in capsys.readouterr().err
    for name in ("one", "two"):  # a file alone does not say who wrote it
        shutil.copyfile(next((work / name).glob("*.mcap")), tmp_path / f"{name}.mcap")
    words[1], words[3] = tmp_path / "one.mcap", tmp_path / "two.mcap"
    assert ces(*words, "--candidates", work / "rules.yaml", "--out", tmp_path / "other.json") == 0
    said = [line for line in capsys.readouterr().err.splitlines() if "has no header" in line]
    assert said == [
        "warning: one: current: std_msgs/msg/Float64 on /valve_current has no header; stamped with the bag's log time "
        "(said once for all recordings)"
    ]
