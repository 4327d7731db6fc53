"""Every program with 30 wrong command lines from its own option table: exit status 2, one line, nothing written."""

from __future__ import annotations

import argparse
import hashlib
import io
import shutil
import signal
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import wrong_lines as wrong
from hypothesis import HealthCheck, Phase, given, settings

from ces_cli.main import PROGRAMS, main
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer.signals import Signals

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
EXAMPLES, DRAWN = 30, 150  # different lines tried, of the drawn ones
LIMIT_S = 60.0  # of the processor for one command line: it is refused before any work


def list_parsers():
    """Return the parsers of all programs and of their subprograms, by the words that start them."""
    parsers = {}
    for name, (module, *_) in PROGRAMS.items():
        parser = import_module(f"ces_cli.{module}").make_parser()
        inner = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
        parsers |= {(name, sub): p for action in inner for sub, p in action.choices.items()} or {(name,): parser}
    return parsers


PARSERS = list_parsers()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a bag of half a second, a model, and files of every kind that cannot be used."""
    here = tmp_path_factory.mktemp("wrong")
    stamps = 10**18 + np.arange(250, dtype=np.int64) * 2_000_000
    x = 0.01 * np.sin(0.05 * np.arange(250))
    columns = {"position": (x, "m"), "current": (0.0 * x + 0.5, "A"), "force": (1e4 * x, "N")}
    channels = {name: Channel(name, unit, stamps, values) for name, (values, unit) in columns.items()}
    write_bag(
        here / wrong.GOOD_BAG, recording_topics(Recording("good_bag", channels), Signals.from_mapping({}, "test"))
    )
    shutil.copyfile(ROOT / "config" / "models" / "sample.json", here / wrong.MODEL)
    for name in ("cut_bag", "bad_metadata"):
        shutil.copytree(here / wrong.GOOD_BAG, here / name)
    data = next((here / "cut_bag").glob("*.mcap"))
    data.write_bytes(data.read_bytes()[:400])
    (here / "bad_metadata" / "metadata.yaml").write_text("rosbag2_bagfile_information: [\n")
    (here / "empty_folder").mkdir()
    noise = np.random.default_rng(1).bytes(600)
    texts = {
        wrong.NOTES: b"{: not what anybody expects\n",
        **{"random.mcap": noise, "random.db3": noise, "binary.yaml": noise, "empty.yaml": b""},
        **{"tabs.yaml": b"a:\n\t- b: [", "alias.yaml": b"a: &a [*a]\nb: *a\n", "list.json": b"[" * 5000},
        **{"cut.json": (here / wrong.MODEL).read_bytes()[:200], "nan.json": b'{"schema": NaN, "rate": 1e999}'},
    }
    for name, text in texts.items():
        (here / name).write_bytes(text)
    return here


@contextmanager
def within(seconds, words):
    """Fail if the body takes more time of the processor."""

    def fail(*_):
        raise AssertionError(f"took more than {seconds} s: ces {words}")

    before = signal.signal(signal.SIGPROF, fail)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def contents(folder):
    """Return the hashes of all files in a folder, and the names of all folders."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""
        for path in sorted(folder.rglob("*"))
    }


def run_program(words):
    """Return exit status and lines on standard error of a command line."""
    printed = io.StringIO()
    with redirect_stderr(printed), redirect_stdout(io.StringIO()), within(LIMIT_S, words):
        try:
            status = main(words)
        except SystemExit as stop:
            status = stop.code
    return status, printed.getvalue().splitlines()


@pytest.mark.parametrize("program", PARSERS, ids=" ".join)
def test_wrong_command_lines_are_refused_with_one_line(folder, monkeypatch, program):
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "80")
    before, seen = contents(folder), set()

    @settings(
        **{"max_examples": DRAWN, "derandomize": True, "database": None, "deadline": None},
        phases=[Phase.generate],
        suppress_health_check=HealthCheck,
    )
    @given(wrong.wrong_lines(PARSERS[program]))
    def refuse(words):
        if len(seen) == EXAMPLES or tuple(words) in seen:
            return
        status, lines = run_program([*program, *words])
        assert status == 2, lines
        assert len(lines) == 1, lines
        assert lines[0].startswith(f"ces {program[0]}"), lines
        assert ": error: " in lines[0]
        assert contents(folder) == before
        seen.add(tuple(words))

    refuse()
    assert len(seen) == EXAMPLES
