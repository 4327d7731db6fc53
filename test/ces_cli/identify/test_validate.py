"""`ces validate` and `ces identify --folds` on small bags: what they print, refuse, and write into the model."""

import json
import re
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from programs import NO_SHORT_FITS, ces, text_of
from small_recordings import RULES

from ces_data.bags.reader import read_recording
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_identify.prepare.cost import parse_weighting, weighted_cost
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import simulate_series
from ces_observer.model import load_model
from ces_observer.signals import Signals

pytestmark = pytest.mark.slow
DEFAULT = Signals.from_mapping({}, "defaults")
RATE = 500.0
SEARCH = ("--candidates", "rules.yaml", "--starts", 1, "--threads", 1)


def bag(path, seed, seconds=9.0, repeating=False):
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE)) / RATE
    ripple = 0.0 if repeating else 0.004 * np.sin(2 * np.pi * 7.3 * t + seed)
    x = 0.01 * np.sin(2 * np.pi * 4 * t) + ripple
    v = np.gradient(x, t)
    i = 0.5 + 0.15 * np.sin(2 * np.pi * (4.0 if repeating else 0.7) * t)
    force = np.sign(v) * np.abs(v) ** 0.5 * (400 + 1500 * i) + 100 * v + random.normal(0, 8, len(t))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": (x, "m"), "current": (i, "A"), "force": (force, "N")}
    channels = {name: Channel(name, unit, stamps, values) for name, (values, unit) in columns.items()}
    write_bag(path, recording_topics(Recording(path.name, channels), DEFAULT))
    return path


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """The working folder with three bags, one of them of repeated cycles, and a model with cross-validation."""
    folder = tmp_path_factory.mktemp("validate")
    (folder / "rules.yaml").write_text(RULES)
    bag(folder / "one", 1), bag(folder / "two", 2), bag(folder / "cycles", 3, repeating=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(*NO_SHORT_FITS)
        assert ces("identify", "one", "two", "--folds", 2, "--terms", 3, *SEARCH) == 0
        yield folder


@pytest.fixture(scope="module")
def printed(work):
    """Output of `ces validate` with weights for a held-out bag and a bag of repeated cycles."""
    words = ("--weight", "zero_crossing:0.1=3", "--weight", "current:0.6..0.7=2", "--report", "v.html")
    with (work / "printed").open("w") as out, redirect_stdout(out):
        assert ces("validate", "model.json", "one", *words, "--part", "5", "99", "cycles") == 0
    return (work / "printed").read_text()


def test_costs_come_with_interval_floor_and_weighted_cost(work, printed):
    model, row = (
        load_model(work / "model.json"),
        next(line for line in printed.splitlines() if "cycles 5-" in line).split(" s ", 1)[1].split(),
    )
    series = prepare(read_recording(work / "cycles", DEFAULT).part(5.0, 99.0), model.sampling)
    scored, force = series.scored, simulate_series(model, series).force
    weights = parse_weighting(["zero_crossing:0.1=3", "current:0.6..0.7=2"]).tick_weights(series)[scored]
    cost, low, _, high, floor, weighted = row[3:9]
    assert float(low) <= float(cost) <= float(high)
    noise = 100.0 * 8.0 / series.force[scored].std()
    assert 0.6 * noise < float(floor) < 1.15 * noise  # interpolation at the ticks takes some of the noise away
    assert float(weighted) == pytest.approx(weighted_cost(series.force[scored], force[scored], weights), abs=0.006)
    assert "weights: zero_crossing:0.1=3 current:0.6..0.7=2" in printed


def test_residuals_take_a_line_each(printed):
    lines = printed.splitlines()
    assert sum(line.startswith("residual of cycles 5-9 s: ") for line in lines) == 2


def test_the_report_shows_them_too(work, printed):
    page = (work / "v.html").read_text()
    for text in ("95&#160;% interval", "noise floor", "Weighted J", "speed → residual"):
        assert text in page


def test_what_was_not_determined_and_what_is_lacking_is_said_at_once(work, capsys, monkeypatch):
    model = json.loads((work / "model.json").read_text())
    model["provenance"]["selection"]["undetermined"] = ["the lag is not determined: -5 ms assumed"]
    (work / "lag.json").write_text(json.dumps(model))
    assert ces("validate", "lag.json", "two", "--report", "lag.html") == 0
    assert "warning: The lag is not determined: -5 ms assumed.\n" in capsys.readouterr().err
    head, _, rest = (work / "lag.html").read_text().partition('<p class="headline">')
    assert '<p class="warning">The lag is not determined: \N{MINUS SIGN}5 ms assumed.</p>' in head
    assert "undetermined" not in rest.lower()
    monkeypatch.setattr("ces_cli.identify.program.head_lines", lambda model, evaluations: ["The error depends"])
    assert ces("identify", "one", "--terms", 2, "--out", "lacks.json", *SEARCH) == 0
    assert "warning: The error depends\n" in capsys.readouterr().err


def test_the_use_of_every_second_is_in_the_table_and_in_the_model(work, capsys):
    history = json.loads((work / "model.json").read_text())["provenance"]
    one = next(row for row in history["usage"] if row["recording"] == "one" and not row["test_s"])
    assert one["estimation_s"] == pytest.approx(2 * one["selection_s"], abs=1.0)
    assert sum(row["test_s"] > 0 for row in history["usage"]) == 2
    assert "no choice used the test seconds" in history["usage_rule"]


def test_folds_are_in_the_model_and_no_test_second_is_in_them_twice(work):
    rows = json.loads((work / "model.json").read_text())["provenance"]["cross_validation"]
    assert [(row["recording"], row["fold"]) for row in rows] == [("one", 1), ("two", 2)]
    for row in rows:
        low, high = row["ci95_percent"]
        assert low < row["J_percent"] < high < 20.0


def test_identify_prints_the_folds_and_the_use_of_seconds(work, capsys):
    out = text_of(capsys, "identify", "one", "--folds", 2, "--out", "folds.json", "--terms", 2, *SEARCH)
    assert "0.0-4.5 s" in out and "4.5-9.0 s" in out and "spread" in out
    assert re.search(r"identification \d+\.\d s", out) and re.search(r"validation \d+\.\d s", out)
    assert "of every 3 s of identification data" in out


def test_a_certificate_is_proved_again_without_a_bag(work, capsys):
    assert ces("validate", work / "model.json", "--certificate") == 0
    out = capsys.readouterr().out
    proof = load_model(work / "model.json").certify()
    assert f"gain            {proof.gain:.6g} < 1" in out
    assert f"{proof.force_N:.6g} N" in out


def write_changed(work, path, change):
    raw = json.loads((work / "model.json").read_text())
    change(raw)
    path.write_text(json.dumps(raw))
    return path


def raise_gain(raw):
    """Raise the gain of past forces, as an edit by hand would."""
    for term in raw["terms"]:
        if any(f["signal"] == "force" for f in term["factors"]):
            term["coefficient"] = 1.2


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (raise_gain, "the gains of the past forces may sum to 1.2"),
        (lambda m: m["certificate"].update(gain=0.01), "the file claims gain 0.01, but only"),
        (lambda m: m["certificate"].update(force_bound_N=1.0), "the file claims force_bound_N 1, but only"),
    ],
)
def test_a_failed_proof_gives_one_line_and_status_1(work, tmp_path, capsys, change, expected):
    raw = json.loads((work / "model.json").read_text())
    if not any(f["signal"] == "force" for t in raw["terms"] for f in t["factors"]):
        raw["terms"].append({"coefficient": 0.1, "factors": [{"signal": "force", "lag": 1}]})
        (work / "model.json").write_text(json.dumps(raw))
        changed = load_model(work / "model.json")
        replace(changed, certificate=changed.certify().to_mapping()).save(work / "model.json")
    path = write_changed(work, tmp_path / "m.json", change)
    assert ces("validate", path, "--certificate") == 1
    out = capsys.readouterr().out.splitlines()
    assert len(out) == 1
    assert expected in out[0]


@pytest.mark.parametrize(
    "change", [lambda m: m.update(certificate=None), lambda m: m["certificate"].update(drive_N=1e9)]
)
def test_a_proof_with_tighter_bounds_than_the_file_is_accepted(work, tmp_path, change):
    assert ces("validate", write_changed(work, tmp_path / "m.json", change), "--certificate") == 0


def test_a_passive_model_is_proved_with_both_bounds(capsys):
    path = Path(__file__).resolve().parents[3] / "bench" / "fuzz" / "seeds" / "model" / "hydraulic.json"
    assert ces("validate", path, "--certificate") == 0
    out = capsys.readouterr().out
    bounds = load_model(path).certify()
    assert "|F| stays bounded for every input" in out
    assert f"{bounds.envelope_N:.6g} N for inputs in the envelope" in out
    assert f"{bounds.force_bound_N:.6g} N for any input" in out
    assert "used as they are up to 2 times the envelope" in out
