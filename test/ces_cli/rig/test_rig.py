"""`ces rig`: writes a bag that reads back unchanged, lists experiments, and reports mistakes in one line."""

import numpy as np
import pytest

from ces_cli.rig import main
from ces_cli.terminal.terminal import run as run_program
from ces_data.bags.reader import read_recording
from ces_data.signals_file import load_signals
from ces_rig.experiments.virtual import load_experiment, run

SHORT = """\
duration_s: 1.0
stroke: {kind: sine, amplitude_m: 0.01, frequency_Hz: 4}
current: {kind: stroke_following}
"""


@pytest.fixture
def experiment(tmp_path):
    path = tmp_path / "short.yaml"
    path.write_text(SHORT)
    return path


def test_the_bag_holds_the_run(experiment, tmp_path, capsys):
    bag = tmp_path / "bag"
    assert main([str(experiment), "--out", str(bag)]) == 0
    assert "1000 position, 501 current, 1000 force samples" in capsys.readouterr().out
    read, expected = read_recording(bag, load_signals()), run(load_experiment(experiment))
    for name in ("position", "current", "force"):
        assert np.array_equal(read.channel(name).values, expected.channel(name).values)
        assert np.array_equal(read.channel(name).stamps_ns, expected.channel(name).stamps_ns)


def test_seed_and_overwrite(experiment, tmp_path):
    bag = str(tmp_path / "bag")
    main([str(experiment), "--out", bag])
    assert run_program("rig", main, [str(experiment), "--out", bag]) == 2
    first = read_recording(tmp_path / "bag", load_signals()).channel("force").values
    assert main([str(experiment), "--out", bag, "--overwrite", "--seed", "9"]) == 0
    assert not np.array_equal(read_recording(tmp_path / "bag", load_signals()).channel("force").values, first)


def test_signals_file_sets_the_topics(experiment, tmp_path):
    signals = tmp_path / "signals.yaml"
    signals.write_text(
        "current: {topic: amps, type: std_msgs/msg/Float32, field: data, scale: 0.001}\n"
        "position: {topic: pot, type: std_msgs/msg/Float64, field: data, scale: -1.0, offset: 0.1}\n"
    )
    main([str(experiment), "--out", str(tmp_path / "bag"), "--signals", str(signals)])
    read, expected = read_recording(tmp_path / "bag", load_signals(signals)), run(load_experiment(experiment))
    assert read.channel("current").values == pytest.approx(expected.channel("current").values, abs=1e-6)
    assert read.channel("position").values == pytest.approx(expected.channel("position").values, abs=1e-12)
