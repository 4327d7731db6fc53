"""`ces signals` from end to end: file, table, JSON, and the errors that point to it."""

import json

import proposal_bags as bags
import pytest
import tiny_bags as tiny

from ces_cli.bags import info, signals
from ces_cli.main import main
from ces_cli.terminal import terminal
from ces_data.bags.reader import read_recording
from ces_data.signals_file import load_signals

pytestmark = pytest.mark.filterwarnings("ignore::ces_data.bags.reader.RecordingWarning")
T, X, CURRENT, F = bags.motion(samples=1000)


@pytest.fixture
def bag(tmp_path):
    streams = [
        bags.numbers("/lvdt", 1000 * X),
        bags.numbers("/coil/current", CURRENT),
        bags.wrenches("/load", F),
        bags.numbers("/stroke_cmd", X),
        ("/rosout", "rcl_interfaces/msg/Log", []),
    ]
    return tiny.write(tmp_path / "bag", streams)


def run(*words):
    return terminal.run("signals", signals.main, [str(word) for word in words])


def test_the_file_is_written_and_explained(bag, tmp_path, capsys):
    assert run(bag, "--out", tmp_path / "my.yaml") == 0
    out, err = capsys.readouterr()
    assert "check: position: taken as mm" in out
    assert f"ces info {bag} --signals '{tmp_path / 'my.yaml'}'" in err
    assert "a command by its name" in " ".join(out.split())
    assert set(read_recording(bag, load_signals(tmp_path / "my.yaml")).channels) == {"position", "current", "force"}
    assert run(bag, "--out", tmp_path / "my.yaml") == 2
    assert "replace it with --overwrite" in capsys.readouterr().err
    assert run(bag, "--out", tmp_path / "my.yaml", "--overwrite") == 0


def test_without_out_the_file_goes_to_the_standard_output(bag, tmp_path, capsys):
    assert run(bag) == 0
    out, err = capsys.readouterr()
    (tmp_path / "piped.yaml").write_text(out)
    assert load_signals(tmp_path / "piped.yaml")["position"].scale == pytest.approx(0.001)
    assert "/lvdt data" in err and "[mm to SI]" in " ".join(err.split()) and "\\[" not in err


def test_json(bag, capsys):
    assert run(bag, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "ces-signals/1"
    rows = {row["signal"]: row for row in found["signals"]}
    assert rows["position"]["source"] == "/lvdt data"
    assert rows["position"]["scale"] == pytest.approx(0.001)
    assert found["not_examined"] == {"/rosout": "no messages"}


def test_a_missing_topic_names_the_program_and_what_it_writes_ends_the_error(bag, tmp_path, capsys):
    assert terminal.run("info", info.main, [str(bag)]) == 2
    line = capsys.readouterr().err
    assert f"'ces signals {bag} --out my_signals.yaml' proposes a file for --signals" in line
    assert run(bag, "--out", tmp_path / "my.yaml") == 0
    assert terminal.run("info", info.main, [str(bag), "--signals", str(tmp_path / "my.yaml")]) == 0


def test_a_file_without_a_force_is_to_be_completed_by_hand(tmp_path, capsys):
    path = tiny.write(tmp_path / "bag", [bags.numbers("/stroke", X), bags.numbers("/current", CURRENT)])
    assert run(path, "--out", tmp_path / "my.yaml") == 0
    err = capsys.readouterr().err
    assert (
        f"next:    complete {tmp_path / 'my.yaml'} by hand: nothing was found for force" in err
        and "ces info" not in err
    )


def test_a_signals_file_without_a_needed_key_is_named(bag, tmp_path, capsys):
    assert run(bag, "--out", tmp_path / "my.yaml") == 0
    lines = (tmp_path / "my.yaml").read_text().splitlines()
    first = lines.index("    force:")
    (tmp_path / "part.yaml").write_text("\n".join(lines[:first] + lines[first + 6 :]) + "\n")
    capsys.readouterr()
    words = ["identify", str(bag), "--signals", str(tmp_path / "part.yaml"), "--out", str(tmp_path / "m.json")]
    assert main(words) == 2
    line = capsys.readouterr().err
    assert f"{tmp_path / 'part.yaml'} has no key 'force', so its default was looked for: add it" in line
    assert "ces signals" not in line
