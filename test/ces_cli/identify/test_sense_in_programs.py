"""The programs refuse recordings twice and wrong models, say what was known before, and name ranges outside."""

import json
import re
import shutil
import warnings
from pathlib import Path

import numpy as np
import pytest
from programs import NO_SHORT_FITS
from samplings import make_sampling

import ces
from ces_cli import compare
from ces_cli.bags import characterise, export_data, import_, info
from ces_cli.identify import program, validate
from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.check import check_recording
from ces_data.checks.content import recording_marks
from ces_data.recording import Channel, Recording
from ces_data.signals_file import load_signals
from ces_observer.errors import CesError
from ces_observer.model import Envelope, Model
from ces_observer.signals import Signals
from ces_observer.structures.polynomial import Factor, Polynomial, Term

pytestmark = pytest.mark.slow
RATE = 500
SEARCH = ["--target", "60", "--starts", "1", "--terms", "2", "--threads", "1", "--no-band"]


def ride(name="run", seed=1, force=1.0, stroke_m=0.02, seconds=8.0, current_A=0.5):
    """Return a recording of a viscous damper on a noise stroke."""
    dice = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    phases = dice.uniform(0, 2 * np.pi, 12)
    waves = zip(np.linspace(0.7, 14.0, 12), phases, strict=True)
    x = 0.2 * stroke_m * sum(np.sin(2 * np.pi * hz * t + phase) for hz, phase in waves)
    i = current_A + 0.2 * np.sin(1.3 * t + seed)
    v = np.gradient(x, t)
    f = force * ((800.0 + 2000.0 * i) * v + dice.normal(0, 5.0, len(t)))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": ("m", x + dice.normal(0, 1e-5, len(t))), "current": ("A", i), "force": ("N", f)}
    return Recording(name, {n: Channel(n, u, stamps, values) for n, (u, values) in columns.items()})


@pytest.fixture(autouse=True)
def no_short_fits(monkeypatch):
    monkeypatch.setattr(*NO_SHORT_FITS)


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Return a folder with bags, and a model of one of them."""
    folder = tmp_path_factory.mktemp("bags")
    rides = {
        "one": ride("one"),
        "two": ride("two", 2),
        "wide": ride("wide", 3, stroke_m=0.06, current_A=1.5),
        "reversed": ride("reversed", 4, force=-1.0),
    }
    for name, recording in rides.items():
        write_bag(folder / name, recording_topics(recording, load_signals()))
    shutil.copytree(folder / "one", folder / "copy")
    used = {"recording": "one", "sha256": "", "share": [0.0, 1.0], "marks": " ".join(recording_marks(rides["one"]))}
    body = Polynomial((Term(1800.0, (Factor("speed", 0),)),))
    envelope = Envelope((-0.02, 0.02), (-2.0, 2.0), (0.2, 0.8))
    known = Model(make_sampling(500.0, 0.02), body, envelope, (-1e5, 1e5), provenance={"identification": [used]})
    known.save(folder / "model.json")
    return folder


def test_identify_refuses_a_wrong_model_and_force_goes_on(bags, tmp_path, capsys):
    words = [str(bags / "reversed"), "--out", str(tmp_path / "model.json"), *SEARCH]
    with pytest.raises(
        CesError, match=r"reversed: force: acts with the motion .* ignore_findings=True identifies all the same"
    ):
        program.main(words)
    assert program.main([*words, "--ignore-findings"]) == 0
    assert "warning: reversed: force: acts with the motion" in capsys.readouterr().err
    (forced,) = json.loads((tmp_path / "model.json").read_text())["provenance"]["forced"]
    assert forced.startswith("reversed: force: acts with the motion")


def test_the_api_refuses_the_same_and_goes_on(bags):
    options = {"split": 1.0, "terms": 2, "time": 60.0, "target": 60.0, "starts": 1, "threads": 1, "band": False}
    with pytest.raises(CesError, match="for identification and for validation"):
        ces.identify([ride()], validation=[ride("copy")], **options)
    with pytest.raises(CesError, match="acts with the motion"):
        ces.identify([ride(force=-1.0)], **options)
    with pytest.warns(match="acts with the motion"):
        result = ces.identify([ride(force=-1.0)], **options, ignore_findings=True)
    assert len(result.provenance["forced"]) == 1
    (row,) = result.provenance["identification"]
    assert row["marks"].split() == recording_marks(ride(force=-1.0))


def test_validate_knows_a_copy_of_what_the_model_was_identified_on(bags, capsys):
    validate.main([str(bags / "model.json"), str(bags / "copy"), str(bags / "two")])
    shown = capsys.readouterr()
    assert "warning: copy: the model was identified on seconds of this recording (as 'one')" in shown.err
    assert "two: the model was identified" not in shown.err
    assert " identification " in shown.out and " validation " in shown.out  # the roles of the page


def test_validate_names_wrong_signs_and_ranges_outside(bags, tmp_path, capsys):
    report = tmp_path / "report.html"
    validate.main([str(bags / "model.json"), str(bags / "wide"), str(bags / "reversed"), "--report", str(report)])
    error = capsys.readouterr().err
    assert "warning: reversed: force: acts with the motion" in error
    (line,) = (one for one in error.splitlines() if "outside the model's envelope" in one and "wide" in one)
    assert ": speed " in line and " m/s, model knows " in line
    assert "position" not in line and "current" not in line  # the model does not use them
    assert "model knows" in report.read_text(encoding="utf-8")


def test_validate_finds_pounds_and_both_signs_reversed_by_the_model(bags, tmp_path, capsys):
    body = Polynomial((Term(1800.0, (Factor("speed", 0),)), Term(900.0, (Factor("speed", 0, 2.0, signed=False),))))
    uneven = Model(make_sampling(500.0, 0.02), body, Envelope((-0.1, 0.1), (-3.0, 3.0), (0.0, 2.0)), (-1e5, 1e5))
    uneven.save(tmp_path / "model.json")
    sound = ride("sound", 5)
    x, stamps = sound.channel("position").values, sound.channel("position").stamps_ns
    v = np.gradient(x, 1.0 / RATE)
    force = 1800.0 * v + 900.0 * v**2
    for name, sign, newtons in (("pounds", 1.0, 4.4482216), ("turned", -1.0, 1.0), ("sound", 1.0, 1.0)):
        channels = {
            "position": Channel("position", "m", stamps, sign * x),
            "current": sound.channel("current"),
            "force": Channel("force", "N", stamps, sign * force / newtons),
        }
        write_bag(tmp_path / name, recording_topics(Recording(name, channels), load_signals()))
    for name, text in (
        ("pounds", "times as large as the model's; if it is in lbf, multiply its scale in the signals file by 4.44822"),
        ("turned", "warning: turned: position and force: the model follows them better with both signs reversed"),
        ("sound", ""),
    ):
        assert validate.main([str(tmp_path / "model.json"), str(tmp_path / name), "--json"]) == 0
        shown = capsys.readouterr()
        assert text in shown.err
        found = json.loads(shown.out)["findings"]
        assert [f["severity"] for f in found] == (["wrong model"] if text else []), found


def test_all_programs_show_the_same_words(bags, tmp_path, capsys):
    line = "reversed: force: acts with the motion instead of against it"
    bag, model = str(bags / "reversed"), str(bags / "model.json")
    copy = tmp_path / "other.json"
    shutil.copy(model, copy)
    for run, words in (
        (validate.main, [model, bag, "--json"]),
        (characterise.main, [bag, "--json"]),
        (compare.main, [model, str(copy), bag, "--json"]),
    ):
        assert run(words) == 0
        shown = capsys.readouterr()
        assert f"warning: {line}" in shown.err
        assert any(f["text"].startswith(line) for f in json.loads(shown.out)["findings"])
    assert export_data.main([bag, "--out", str(tmp_path / "table.csv")]) == 0
    assert f"warning: {line}" in capsys.readouterr().err
    assert info.main([bag, "--json"]) == 0
    (recording,) = json.loads(capsys.readouterr().out)["recordings"]
    assert [f["text"] for f in recording["findings"]] == [
        f.text for f in check_recording(read_recording(Path(bag), load_signals()))
    ]


def write_log(path: Path, recording: Recording):
    time = (recording.channel("position").stamps_ns - 10**18) * 1e-9
    columns = [time, *(recording.channel(name).values for name in ("position", "current", "force"))]
    np.savetxt(path, np.stack(columns, axis=1), delimiter=",", header="t,x,i,F", comments="")


def test_import_says_what_to_write_into_the_mapping(tmp_path, capsys):
    write_log(tmp_path / "run.csv", ride(force=-1.0))
    (tmp_path / "map.yaml").write_text(
        "time: {column: t}\nposition: {column: x, scale: 1000.0}\ncurrent: {column: i}\nforce: {column: F}\n"
    )
    words = ["--mapping", str(tmp_path / "map.yaml"), "--out", str(tmp_path / "bag")]
    assert import_.main([str(tmp_path / "run.csv"), *words]) == 0
    error = capsys.readouterr().err
    assert "force: acts with the motion" in error and f"by -1 in {tmp_path / 'map.yaml'}" in error
    assert f"multiply its scale in {tmp_path / 'map.yaml'} by 0.001 if it is in mm" in error
    assert "signals file" not in error


def test_a_delay_is_corrected_through_the_signals_file(tmp_path, capsys):
    """The key `delay` moves stamps back, and a bag written with it has them as they were."""
    recording, late_ns = ride(), 20_000_000
    force = recording.channel("force")
    late = Channel("force", "N", force.stamps_ns + late_ns, force.values)
    logged = Recording("late", {**recording.channels, "force": late})
    write_bag(tmp_path / "late", recording_topics(logged, load_signals()))
    signals = tmp_path / "signals.yaml"
    signals.write_text("force: {delay: 0.02}\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = read_recording(tmp_path / "late", load_signals(signals))
        assert np.array_equal(read.channel("force").stamps_ns, force.stamps_ns)
        write_bag(tmp_path / "again", recording_topics(read, load_signals(signals)))
        again = read_recording(tmp_path / "again", load_signals())
    assert np.array_equal(again.channel("force").stamps_ns, late.stamps_ns)
    assert info.main([str(tmp_path / "late")]) == 0
    assert re.search(r"wrong model: force: logged (1[6-9]|2[0-4]) ms \(", capsys.readouterr().out)
    assert info.main([str(tmp_path / "late"), "--signals", str(signals)]) == 0
    assert "force: logged" not in capsys.readouterr().out


def test_import_leaves_a_delay_to_the_reader(tmp_path):
    write_log(tmp_path / "run.csv", ride())
    mapping, signals = tmp_path / "map.yaml", tmp_path / "signals.yaml"
    mapping.write_text("time: {column: t}\nposition: {column: x}\ncurrent: {column: i}\nforce: {column: F}\n")
    signals.write_text("force: {delay: -0.02}\n")
    words = ["--mapping", str(mapping), "--out", str(tmp_path / "bag"), "--signals", str(signals)]
    assert import_.main([str(tmp_path / "run.csv"), *words]) == 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read = read_recording(tmp_path / "bag", load_signals(signals))
    shift = read.channel("force").stamps_ns[0] - read.channel("position").stamps_ns[0]
    assert shift == 20_000_000


@pytest.mark.parametrize("delay", [1.5, -2, 20, "soon", True, None])
def test_a_delay_that_cannot_be_is_refused(delay):
    with pytest.raises(CesError, match="signal 'force': delay"):
        Signals.from_mapping({"force": {"delay": delay}}, "test")
