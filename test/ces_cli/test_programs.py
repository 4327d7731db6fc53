"""The programs from end to end on small bags, and every bad input of the user: one clear line, exit status 2."""

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ces_cli.main import PROGRAMS, main
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_identify.prepare.series import prepare
from ces_identify.validation.evaluate import VALIDATION, evaluate
from ces_observer.model import load_model
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
RULES = """\
force: {lags: [1]}
speed: {lags: [0, 2], powers: [0.5, 1.0], forms: [signed, magnitude]}
current: {lags: [0], powers: [1.0], forms: [magnitude]}
products: [[], [speed], [speed, current], [force]]
"""
RATE = 500.0


def make_channels(seconds=12.0, seed=1, rate=RATE):
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * rate)) / rate
    x = 0.01 * np.sin(2 * np.pi * 3 * t) + 0.004 * np.sin(2 * np.pi * 7.3 * t + seed)
    v = np.gradient(x, t)
    i = 0.5 + 0.15 * np.sin(2 * np.pi * 0.7 * t)
    force = np.sign(v) * np.abs(v) ** 0.5 * (400 + 1500 * i) + 100 * v + random.normal(0, 3, len(t))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": (x, "m"), "current": (i, "A"), "force": (force, "N")}
    return {name: Channel(name, unit, stamps, values) for name, (values, unit) in columns.items()}


def bag(path, channels=None, more=()):
    recording = Recording(path.name, channels or make_channels())
    write_bag(path, (*recording_topics(recording, DEFAULT), *more))
    return path


def changed(name, values):
    channels = make_channels()
    c = channels[name]
    return {**channels, name: Channel(name, c.unit, c.stamps_ns, values(c.values.copy()))}


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with two bags, rules, and a model identified from one of them."""
    folder = tmp_path_factory.mktemp("work")
    (folder / "rules.yaml").write_text(RULES)
    bag(folder / "one"), bag(folder / "two", make_channels(seed=2))
    words = ["identify", folder / "one", "--validate", folder / "two", "--out", folder / "model.json"]
    words += ["--report", folder / "report.html", "--candidates", folder / "rules.yaml", "--terms", 5]
    words += ["--starts", 2, "--time", 20, "--threads", 2]
    assert main([str(word) for word in words]) == 0
    return folder


def ces(*words):
    return main([str(word) for word in words])


def error_line(capsys, *words):
    """Run a program that must fail; return its error line."""
    capsys.readouterr()
    try:
        status = ces(*words)
    except SystemExit as stop:
        status = stop.code
    printed = capsys.readouterr()
    lines = [line for line in printed.err.splitlines() if not line.startswith("warning: ")]
    assert status == 2
    assert len(lines) == 1, printed.err
    assert lines[0].startswith(f"ces {words[0]}: error: ")
    return lines[0]


def test_identify_writes_a_model_and_a_report(work):
    history = load_model(work / "model.json").provenance
    costs = {row["role"]: row["J"] for row in history["cost_J_percent"]}
    assert costs["validation"] < 6.0
    assert history["identification"][0]["sha256"]
    assert "<html" in (work / "report.html").read_text()


def test_validate_and_identify_agree_on_the_cost(work, capsys):
    expected = next(
        row["J"]
        for row in json.loads((work / "model.json").read_text())["provenance"]["cost_J_percent"]
        if row["role"] == "validation"
    )
    words = ("--report", work / "v.html", "--picture", work / "v.png")
    assert ces("validate", work / "model.json", work / "two", *words) == 0
    assert f"{expected:.2f}" in capsys.readouterr().out
    assert (work / "v.html").stat().st_size > 1000
    assert (work / "v.png").read_bytes().startswith(b"\x89PNG")


def test_validate_warns_of_identification_data(work, capsys):
    ces("validate", work / "model.json", work / "one")
    assert "one: the model was identified on seconds of this recording (as 'one')" in capsys.readouterr().err


def test_replay_and_simulate_agree(work):
    assert ces("replay", work / "model.json", work / "two", "--out", work / "replayed", "--overwrite") == 0
    assert ces("simulate", "--sim", work / "model.json", work / "two", "--out", work / "two.csv") == 0
    rows = list(csv.DictReader((work / "two.csv").open()))
    described = {"topic": "/observer/estimate", "type": "sensor_msgs/msg/JointState", "field": "effort[rear_damper]"}
    replayed = read_recording(work / "replayed", Signals.from_mapping({"sim_force": described}, "test"))
    position, estimate = replayed.channel("position"), replayed.channel("sim_force")
    assert len(rows) == len(position)
    assert rows[0]["time_s"] == "0.000000000"
    simulated = {round(float(r["time_s"]) * 1e9): float(r["force_N"]) for r in rows if r["force_N"] != "nan"}
    times = (estimate.stamps_ns - position.stamps_ns[0]).tolist()
    assert times == list(simulated)
    np.testing.assert_allclose(estimate.values, list(simulated.values()), rtol=1e-9, atol=1e-6)


def test_bounds_of_the_band_are_replayed_and_simulated(work):
    assert ces("replay", work / "model.json", work / "two", "--out", work / "bounds", "--overwrite") == 0
    assert ces("simulate", "--sim", work / "model.json", work / "two", "--out", work / "band.csv", "--band") == 0
    rows = [row for row in csv.DictReader((work / "band.csv").open()) if row["force_N"] != "nan"]
    for side, column in (("lower", "lower_N"), ("upper", "upper_N")):
        described = {"topic": "/observer/estimate_band", "type": "sensor_msgs/msg/JointState"}
        described["field"] = f"effort[rear_damper_{side}]"
        replayed = read_recording(work / "bounds", Signals.from_mapping({"sim_force": described}, "test"))
        simulated = [float(row[column]) for row in rows]
        np.testing.assert_allclose(replayed.channel("sim_force").values, simulated, rtol=1e-9, atol=1e-6)
    force, lower, upper = (np.array([float(row[c]) for row in rows]) for c in ("force_N", "lower_N", "upper_N"))
    assert (lower < force).all() and (force < upper).all()


def test_validate_shows_the_share_that_the_band_holds(work, capsys):
    assert ces("validate", work / "model.json", work / "two", "--report", work / "b.html") == 0
    printed = capsys.readouterr().out
    assert "band %" in printed and "meant to hold 90 % of the measured forces" in printed
    share = float(next(line for line in printed.splitlines() if "test" in line and "two" in line).split()[-1])
    model = load_model(work / "model.json")
    two = evaluate(model, [prepare(read_recording(work / "two", DEFAULT), model.sampling)], VALIDATION)[0]
    assert share == pytest.approx(100.0 * two.coverage, abs=0.06) and 80.0 < share < 99.0
    assert 'id="band"' in (work / "b.html").read_text()


def test_a_model_without_a_band_is_used_as_before(work, capsys):
    words = ("--candidates", work / "rules.yaml", "--terms", 5, "--starts", 1, "--time", 3, "--report", work / "n.html")
    assert ces("identify", work / "one", "--out", work / "plain.json", "--no-band", *words) == 0
    assert load_model(work / "plain.json").band is None
    assert ces("validate", work / "plain.json", work / "two") == 0
    assert ces("replay", work / "plain.json", work / "two", "--out", work / "plain", "--overwrite") == 0
    assert "band" not in capsys.readouterr().out
    assert 'id="band"' not in (work / "n.html").read_text()
    line = error_line(capsys, "simulate", "--sim", work / "plain.json", work / "two", "--out", work / "n.csv", "--band")
    assert "the model has no band; identify it again without --no-band" in line


def test_predictions_in_the_bag_are_a_simulation(work):
    topic = f"topic:{'/observer/estimate'}"
    assert ces("replay", work / "model.json", work / "two", "--out", work / "again", "--overwrite") == 0
    assert ces("simulate", "--sim", topic, work / "again", "--out", work / "p.csv") == 0
    forces = [float(row["force_N"]) for row in csv.DictReader((work / "p.csv").open())]
    assert np.isfinite(forces).mean() > 0.9


def test_a_function_is_a_simulation_and_a_teacher(work, monkeypatch, tmp_path):
    (tmp_path / "passive.py").write_text(
        "def force(time_s, position_m, current_A):\n    return 1e4 * position_m + 1.0\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert ces("simulate", "--sim", "passive:force", work / "one", "--out", "f.csv") == 0
    (tmp_path / "rules.yaml").write_text("position: {lags: [0], powers: [1]}\nproducts: [[], [position]]\n")
    words = ("--teacher", "passive:force", "--candidates", "rules.yaml", "--out", "taught.json", "--time", 5)
    assert ces("identify", work / "one", *words) == 0
    terms = {len(t.factors): t.coefficient for t in load_model(tmp_path / "taught.json").body.terms}
    assert terms[1] == pytest.approx(1e4, rel=0.01)


@pytest.mark.parametrize("name", PROGRAMS)
def test_help_reads_like_a_manual_page(name, capsys):
    with pytest.raises(SystemExit) as stop:
        ces(name, "--help")
    printed = capsys.readouterr().out
    assert stop.value.code == 0
    assert printed.startswith(f"usage: ces {name}")
    assert "example" in printed


def test_ces_lists_its_programs(capsys):
    assert main([]) == 0
    printed = capsys.readouterr().out
    assert all(name in printed for name in PROGRAMS)
    assert main(["nothing"]) == 2


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("position", lambda v: v * 0 + 0.01, "constant"),
        ("position", lambda v: np.where(np.arange(len(v)) % 3 == 0, np.nan, v), "NaN"),
        ("force", lambda v: v * np.inf, "force"),
        ("current", lambda v: v * np.nan, "current"),
    ],
)
def test_unusable_samples(work, tmp_path, capsys, name, values, expected):
    path = bag(tmp_path / "bad", changed(name, values))
    assert expected.lower() in error_line(capsys, "identify", path, "--out", tmp_path / "m.json").lower()
    assert not (tmp_path / "m.json").exists()


def test_a_few_bad_samples_are_left_out_with_a_warning(work, tmp_path, capsys):
    path = bag(tmp_path / "spoiled", changed("position", lambda v: np.where(np.arange(len(v)) == 700, np.inf, v)))
    assert ces("validate", work / "model.json", path) == 0
    assert "warning: spoiled: " in capsys.readouterr().err


def test_current_absent_for_part_of_the_time(tmp_path, capsys):
    channels = make_channels()
    c = channels["current"]
    half = len(c) // 2
    path = bag(tmp_path / "half", {**channels, "current": Channel("current", "A", c.stamps_ns[:half], c.values[:half])})
    assert "current" in error_line(capsys, "identify", path, "--out", tmp_path / "m.json")


def test_time_running_backwards(tmp_path, capsys):
    channels = make_channels()
    p = channels["position"]
    stamps = p.stamps_ns.copy()
    stamps[3000:] -= 2 * 10**9
    path = bag(tmp_path / "back", {**channels, "position": Channel("position", "m", stamps, p.values)})
    assert "backward" in error_line(capsys, "identify", path, "--out", tmp_path / "m.json")


def test_two_rates_a_hundred_times_apart(tmp_path, capsys):
    channels = make_channels()
    c = channels["position"]
    slow = Channel("position", "m", c.stamps_ns[::120], c.values[::120])
    path = bag(tmp_path / "rates", {**channels, "position": slow})
    assert "Hz" in error_line(capsys, "identify", path, "--out", tmp_path / "m.json")


def test_a_missing_topic_gives_the_existing_ones(tmp_path, capsys):
    stamps = np.arange(1, 100) * 10**7
    only = TopicData("/other", "std_msgs/msg/Float64", stamps, {"data": stamps * 1e-9})
    write_bag(tmp_path / "other", (only,))
    assert "/other (std_msgs/msg/Float64)" in error_line(capsys, "identify", tmp_path / "other")


def test_a_missing_field(work, tmp_path, capsys):
    (tmp_path / "s.yaml").write_text("position: {field: 'position[front_damper]'}\n")
    line = error_line(capsys, "info", work / "one", "--signals", tmp_path / "s.yaml")
    assert "front_damper" in line
    assert "rear_damper" in line


def test_a_truncated_and_an_empty_bag(work, tmp_path, capsys):
    whole = next((work / "one").glob("*.mcap")).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    assert "cut.mcap" in error_line(capsys, "info", cut)
    cut.write_bytes(b"")
    assert "cut.mcap" in error_line(capsys, "info", cut)
    write_bag(tmp_path / "none", ())
    assert "none" in error_line(capsys, "info", tmp_path / "none")


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda m: m.pop("force_envelope_N"), "key 'force_envelope_N' is missing"),
        (lambda m: m.update(schema="ces-model/0"), "schema is 'ces-model/0'"),
        (lambda m: m["terms"][0].update(coefficient=float("nan")), "coefficient is nan"),
        (lambda m: m["terms"][0].update(factors=[{"signal": "force", "lag": 10**6}]), "lag is 1000000"),
    ],
)
def test_a_broken_model(work, tmp_path, capsys, change, expected):
    raw = json.loads((work / "model.json").read_text())
    change(raw)
    (tmp_path / "m.json").write_text(json.dumps(raw))
    assert expected in error_line(capsys, "validate", tmp_path / "m.json", work / "two")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("identify",), "no recording given"),
        (("identify", "nowhere", "--out", "m.json"), "nowhere"),
        (("identify", "one", "--terms", "0"), "--terms"),
        (("identify", "one", "--split", "2"), "--split"),
        (("validate", "model.json", "two", "--part", "1:0"), "--part"),
        (("identify", "one", "--candidates", "none.yaml", "--out", "m.json"), "none.yaml"),
        (("identify", "one"), "model.json: exists; choose another name for --out, or replace it with --overwrite"),
        (("simulate", "--sim", "what", "one", "--out", "x.csv"), "'what' is no simulation; expected MODEL.json"),
        (("simulate", "--sim", "my/sim.py", "one", "--out", "x.csv"), "'my/sim.py' is a file; expected sim:FUNCTION"),
        (("simulate", "--sim", "topic:/none", "one", "--out", "x.csv"), "/joint_states"),
        (("simulate", "--sim", "no_module:f", "one", "--out", "x.csv"), "cannot be imported"),
        (("simulate", "--sim", "topic:/measured_force", "one", "--out", "x.csv", "--band"), "--band: only a model"),
        (("identify", "one", "--out", "none/m.json"), "none/m.json"),
        (("replay", "model.json", "one", "--out", "two"), "two"),
        (("validate", "model.json", "two", "--picture", "p.bmp"), "p.bmp"),
    ],
)
def test_wrong_arguments(work, monkeypatch, capsys, words, expected):
    monkeypatch.chdir(work)
    assert expected in error_line(capsys, *words)


def test_a_read_only_folder(work, tmp_path):
    """As an ordinary user: root may write anywhere."""
    folder = tmp_path / "locked"
    folder.mkdir()
    folder.chmod(0o555)
    code = (
        "import os, sys\n"
        "os.access = lambda path, mode: not str(path).endswith('locked')\n"
        "from ces_cli.main import main\n"
        f"sys.exit(main(['identify', {str(work / 'one')!r}, '--out', {str(folder / 'm.json')!r}]))"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "cannot be written" in done.stderr
    assert "Traceback" not in done.stderr
