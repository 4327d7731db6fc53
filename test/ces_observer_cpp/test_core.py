"""The C++ core of an exported ROS 2 package is the Python observer's twin, and allocates nothing with the samples."""

import random
import re
import subprocess
from dataclasses import replace
from functools import cache
from importlib import resources
from math import inf, nan

import numpy as np
import pytest
from bands import BAND
from damper_models import plain_damper
from exported_c import two_models
from hydraulic_models import hydraulic_model, make_hydraulic
from physical_examples import make_valve
from trained_models import network_model

from ces_data.signals_file import load_signals
from ces_identify.export.replay_sequence import START_NS, ReplaySequence, record_faults
from ces_identify.export.ros_package import export_ros_package, write_package
from ces_observer.health.streams import Arrivals, Losses
from ces_observer.model import load_model
from ces_observer.proof.certificate import Contraction

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc", "c++")]

FLAGS = ["-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O0", "-fsanitize=undefined"]
FLAGS += ["-fno-sanitize-recover=undefined"]
UNPROVED = Contraction(2.0, 1.0, 1, "", "")
MS = 1_000_000
SAMPLE = resources.files("ces_observer").joinpath("../config/models/sample.json")


def quick(model, **sampling):
    """Return the model with a short warm-up and other settings."""
    return replace(model, sampling=replace(model.sampling, warm_up_s=0.05, **sampling))


MODELS = {
    "polynomial": lambda: replace(quick(load_model(SAMPLE)), band=BAND),
    "network, measured speed": lambda: quick(network_model(), motion="speed", motion_noise=0.01),
    "hydraulic": lambda: quick(hydraulic_model(make_hydraulic(make_valve()))),
    "a delay": lambda: replace(quick(load_model(SAMPLE), delay_s=0.003), band=BAND),
    "two models": lambda: two_models(quick(load_model(SAMPLE)), replace(plain_damper(), band=BAND), 0.005),
}


@pytest.fixture(scope="module")
def replayer(tmp_path_factory):
    """Return a model of MODELS and the folder with its package and compiled replay, by its name."""

    def find(name):
        model, folder = MODELS[name](), tmp_path_factory.mktemp("package") / "damper"
        write_package(folder, export_ros_package(model, "damper", load_signals(), UNPROVED))
        compile_replay(folder)
        return model, folder

    return cache(find)


def compile_replay(folder):
    subprocess.run(["cc", "-std=c99", *FLAGS, "-c", "src/model/damper.c", "-o", "m.o"], cwd=folder, check=True)
    words = ["c++", "-std=c++17", *FLAGS, "-Isrc", "m.o", "test/replay.cpp", "-o", "replay"]
    subprocess.run(words, cwd=folder, check=True)


def replay(folder, text):
    """Replay a sequence; return exit status and output."""
    (folder / "sequence.txt").write_text(text, encoding="ascii")
    done = subprocess.run(["./replay", "sequence.txt"], cwd=folder, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


@pytest.mark.parametrize("name", MODELS)
def test_the_stored_sequence_is_repeated_without_allocating(replayer, name) -> None:
    model, folder = replayer(name)
    text = (folder / "test" / "sequence.txt").read_text()
    status, output = replay(folder, text)
    assert (status, output.splitlines()[-1]) == (0, "0 allocations with finite samples"), output
    assert text == record_faults(model)
    reasons = {line.split(" ", 4)[4] for line in text.splitlines() if line.startswith("x ")}
    assert {"ok", "warming up", "position is not finite", "position stamps are off the node's clock"} <= reasons
    assert {"stamp repeats or runs backwards", "no usable current", "position is beyond the stroke"} <= reasons


@pytest.mark.parametrize(("seed", "wait_s"), [(0, 0.0), (1, 0.005)])
@pytest.mark.parametrize("name", MODELS)
def test_any_samples_give_the_same_answers(replayer, name, seed, wait_s) -> None:
    model, folder = replayer(name)
    text = fuzzed(model, wait_s, seed)
    status, output = replay(folder, text)
    assert status == 0, output
    assert len(re.findall("^x [0-9 ]+ ok$", text, re.MULTILINE)) > 700
    assert (len(re.findall("^l ", text, re.MULTILINE)) > 700) == bool(model.best.sampling.delay_s)


def fuzzed(model, wait_s, seed):
    """Return samples in any order, with any stamps and values that messages can carry, between calm parts."""
    chance = random.Random(seed)
    sequence = ReplaySequence(model, wait_s, chance.choice((0.0, 0.01, 0.5)))
    stamp_ns, position = START_NS, 0.0
    for k in range(4000):
        calm = k % 1000 < 600
        stamp_ns += MS if calm else chance.choice((MS, MS, MS, MS, 900_000, 1_100_000, 4 * MS, 60 * MS, -2 * MS, 0))
        if chance.random() < (0.0 if calm else 0.005):
            stamp_ns = chance.choice((0, -(10**9), START_NS, 2**31 * 10**9, START_NS + 2 * 10**9))
        position = chance.gauss(0.97 * position, 2e-4)
        if calm:
            sequence.take_current(stamp_ns, chance.uniform(0.3, 0.6), stamp_ns)
            sequence.take_motion(stamp_ns, chance.gauss(0.0, 0.3), stamp_ns)
            sequence.take_position(stamp_ns, position, stamp_ns + MS)
        else:
            act(sequence, chance, stamp_ns, position, now_near(chance, stamp_ns))
    return sequence.text


def now_near(chance, stamp_ns):
    """Return the node's time at a sample: near its stamp, far from it, or 0 as before simulated time begins."""
    return 0 if chance.random() < 0.02 else stamp_ns + chance.choice((0, MS, -MS, 30 * MS, 10**9))


def act(sequence, chance, stamp_ns, position, now_ns):
    dice = chance.random()
    wrong = chance.choice((nan, inf, -inf, 1e308, -1e308, 5.0, 0.0))
    if dice < 0.7:
        sequence.take_position(stamp_ns, position if chance.random() < 0.99 else wrong, now_ns)
        sequence.take_motion(stamp_ns, chance.gauss(0.0, 0.3) if chance.random() < 0.99 else wrong, now_ns)
    elif dice < 0.95:
        current = chance.uniform(-0.2, 2.0) if chance.random() < 0.98 else wrong
        sequence.take_current(stamp_ns + chance.choice((0, 0, 5 * MS, -5 * MS, -3 * 10**9)), current, now_ns)
    elif dice < 0.99:
        sequence.explain()
    elif dice < 0.995:
        sequence.watch(now_ns)
    else:
        chance.choice((sequence.reset, sequence.report_silence))(now_ns)


def test_a_difference_is_found_and_printed(replayer) -> None:
    folder = replayer("polynomial")[1]
    lines = (folder / "test" / "sequence.txt").read_text().splitlines()
    place = next(k for k, line in enumerate(lines) if line.startswith("e "))
    words = lines[place].split()
    words[2] = repr(float(words[2]) * (1.0 + 1e-8) + 1e-8)
    status, output = replay(folder, "\n".join([*lines[:place], " ".join(words), *lines[place + 1 :]]) + "\n")
    assert status == 1
    assert "1 differ" in output
    assert replay(folder, "settings 0 0\n") == (2, "replay: sequence.txt: no results\n")


ARRIVALS = """
#include <iostream>
#include "health/arrivals.hpp"
int main()
{
  ces::Losses losses(1000);
  ces::Arrivals arrivals;
  arrivals.set_topic(true, losses);
  char kind;
  for (long long stamp, now; std::cin >> kind >> stamp >> now; ) {
    if (kind == 'p') {arrivals.take(stamp, now);}
    if (kind == 'j') {arrivals.restart_ages();}
    if (kind != 'r') {continue;}
    arrivals.roll(1.0);
    const auto & f = arrivals.figures();
    std::cout << f.total_samples << ' ' << f.total_dropped << ' ' << f.total_overflowed << ' ' << f.total_out_of_order
              << ' ' << f.total_duplicates << ' ' << f.total_interruptions << ' ' << std::llround(f.mean_age_s * 1e9)
              << ' ' << std::llround(f.max_age_s * 1e9) << ' ' << std::llround(f.jitter_s * 1e9) << std::endl;
  }
}
"""
YEAR_S = 365 * 86400


@pytest.mark.parametrize("seed", range(4))
def test_arrivals_are_counted_as_in_python(tmp_path, seed) -> None:
    """Also after stamps far from the others, gaps, repeats and stalls: the losses come back to what is lost."""
    package = resources.files("ces_identify.export") / "ros_package"
    words = ["c++", "-std=c++17", *FLAGS, f"-I{package / 'src'}", "-x", "c++", "-", "-o", "arrivals"]
    subprocess.run(words, input=ARRIVALS, text=True, cwd=tmp_path, check=True)
    chance, python, lines, expected = random.Random(seed), Arrivals(losses=Losses(1000)), [], []
    for second in range(20):
        lost = 0
        for k in range(1000):
            now_ns = START_NS + (1000 * second + k) * MS + 300_000 + chance.randrange(50_000)
            lost += chance.random() < 0.01
            if lost and chance.random() < 0.5:
                lost = 0
                continue
            stamp_ns = now_ns - now_ns % MS
            if 3 <= second < 8 and chance.random() < 0.02:
                seconds = chance.choice((50 * YEAR_S, -50 * YEAR_S, 3600, -3600, 30, 0.9, -0.9, 0.1, -0.002))
                stamp_ns += round(seconds * 1e9)
            lines.append(f"p {stamp_ns} {now_ns}")
            python.take(stamp_ns, now_ns)
        if second == 9:
            lines.append("j 0 0")
            python.restart_ages()
        lines.append("r 0 0")
        f = python.roll(1.0)
        counts = [f.total_samples, f.total_dropped, f.total_overflowed, f.total_out_of_order, f.total_duplicates]
        times = [round(seconds * 1e9) for seconds in (f.mean_age_s, f.max_age_s, f.jitter_s)]
        expected.append([*counts, f.total_interruptions, *times])
    done = subprocess.run(
        ["./arrivals"], input="\n".join(lines), text=True, cwd=tmp_path, capture_output=True, check=True
    )
    found = [list(map(int, line.split())) for line in done.stdout.splitlines()]
    assert [one[:6] for one in found] == [one[:6] for one in expected]
    assert np.allclose(found, expected, rtol=1e-6, atol=2)
    dropped = [one[1] for one in found]
    assert dropped == sorted(dropped)
    assert dropped[-1] - dropped[-2] < 50
    assert found[-1][2] == 0
