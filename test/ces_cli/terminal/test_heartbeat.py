"""What a program does is printed while it is quiet, in a pipe as on a terminal without a live bar."""

import time

import pytest

from ces_cli.terminal import heartbeat as module
from ces_cli.terminal.heartbeat import Heartbeat
from ces_cli.terminal.progress import LiveBar
from ces_cli.terminal.terminal import step


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(module, "QUIET_S", 0.1)


def test_a_quiet_program_says_its_step(capsys, quick):
    beat = Heartbeat()
    with beat.beat("starting"):
        time.sleep(0.3)
        with beat.step("fitting"):
            time.sleep(0.3)
            beat.change("fitting, 50 %")
            time.sleep(0.3)
    time.sleep(0.3)
    lines = [line.split("s  ")[1] for line in capsys.readouterr().err.splitlines()]
    assert list(dict.fromkeys(lines)) == ["starting", "fitting", "fitting, 50 %"]


def test_a_program_that_prints_or_shows_a_bar_needs_no_lines(capsys, quick):
    beat = Heartbeat()
    with beat.beat("starting"), beat.step("shown", live=True):
        time.sleep(0.4)
    with beat.beat("printing"):
        for _ in range(8):
            beat.touch()
            time.sleep(0.05)
    assert not capsys.readouterr().err


def test_a_program_that_waits_for_its_user_is_quiet(capsys, quick):
    beat = Heartbeat()
    with beat.beat("serving"):
        beat.stop()
        time.sleep(0.4)
    assert not capsys.readouterr().err


def test_bars_and_steps_tell_the_heartbeat_how_far_they_are(monkeypatch):
    with LiveBar("reading", total=1.0) as bar:
        monkeypatch.setattr(LiveBar, "elapsed_s", 30.0)
        bar.show(0.25, "road.csv")
        assert module.heartbeat._steps == ["reading: road.csv, 25%, about 90 s left"]
        with step("simulating") as say:
            say("simulating 2 of 3")
            assert module.heartbeat._steps[-1] == "simulating 2 of 3"
    assert not module.heartbeat._steps
