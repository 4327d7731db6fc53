"""The core of the C++ package: it repeats what the Python observer does, bit for bit, and refuses spoilt models."""

import random
import re
import zlib
from dataclasses import replace
from functools import cache
from importlib import resources
from itertools import pairwise
from math import inf, nan

import numpy as np
import pytest
from bands import BAND
from cpp_core import compile_replay, run, save_flat
from damper_models import plain_damper
from mixture_models import mixture_model
from replay_sequence import MS, START_NS, ReplaySequence, record_faults
from trained_models import network_model

from ces_identify.export.export_model import HEAD, SIZES
from ces_observer.model import load_model

pytestmark = [pytest.mark.slow, pytest.mark.needs("cc", "c++")]

SAMPLE = resources.files("ces_observer").joinpath("../config/models/sample.json")


def quick(model, **sampling):
    """Return the model with a short warm-up and other settings."""
    return replace(model, sampling=replace(model.sampling, warm_up_s=0.05, **sampling))


MODELS = {
    "polynomial": lambda: replace(quick(load_model(SAMPLE)), band=BAND),
    "network, measured speed": lambda: quick(network_model(), motion="speed", motion_noise=0.01),
    "mixture": lambda: quick(mixture_model()),
    "a delay": lambda: replace(quick(load_model(SAMPLE), delay_s=0.003), band=BAND),
    "a longer delay": lambda: quick(plain_damper(), delay_s=0.005),
}


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    return compile_replay(tmp_path_factory.mktemp("core"))


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """Return a model of MODELS and the path of its flat file, by its name."""
    folder = tmp_path_factory.mktemp("models")

    def find(name):
        model = MODELS[name]()
        return model, save_flat(model, folder / f"{name.replace(' ', '_')}.ces")

    return cache(find)


def require_same(program, path, sequence, folder):
    """Replay a sequence; each answer is that of Python, and nothing was allocated with finite samples."""
    (folder / "sequence").write_text("\n".join([*sequence.events, ""]), encoding="ascii")
    status, output = run([program, path, folder / "sequence"])
    assert status == 0, output
    *answers, allocations = output.splitlines()
    for number, (answer, expected) in enumerate(zip(answers, sequence.answers, strict=True)):
        assert answer == expected, number
    assert allocations == "0 allocations with finite samples"


@pytest.mark.parametrize("name", MODELS)
def test_samples_with_faults_give_the_same_answers(program, flat, tmp_path, name) -> None:
    model, path = flat(name)
    sequence = record_faults(model)
    require_same(program, path, sequence, tmp_path)
    reasons = {line.split(" ", 5)[5] for line in sequence.answers if line.startswith("x ")}
    assert {"ok", "warming up", "position is not finite", "position stamps are off the node's clock"} <= reasons
    assert {"stamp repeats or runs backwards", "no usable current", "position is beyond the stroke"} <= reasons


@pytest.mark.parametrize(("seed", "wait_s"), [(0, 0.0), (1, 0.005)])
@pytest.mark.parametrize("name", MODELS)
def test_any_samples_give_the_same_answers(program, flat, tmp_path, name, seed, wait_s) -> None:
    model, path = flat(name)
    sequence = fuzzed(model, wait_s, seed)
    require_same(program, path, sequence, tmp_path)
    text = "\n".join(sequence.answers)
    assert len(re.findall("^x .* ok$", text, re.MULTILINE)) > 700
    assert (len(re.findall("^l ", text, re.MULTILINE)) > 700) == bool(model.sampling.delay_s)


def test_other_models_take_over_between_two_samples(program, flat, tmp_path) -> None:
    """Each warms up beside the one before, on the same samples; no force is missing meanwhile."""
    (first, path), chance = flat("polynomial"), random.Random(4)
    sequence, position = ReplaySequence(first, 0.0, 0.0), 0.0
    names = ["a delay", "mixture", "a longer delay", "network, measured speed", "a delay"]
    for k in range(3500):
        if k % 500 == 499 and names:
            sequence.load(*flat(names.pop(0)), START_NS + k * MS)
        position = chance.gauss(0.97 * position, 2e-4)
        sequence.damper.take_motion("speed", START_NS + k * MS, speed := chance.gauss(0.0, 0.3))
        sequence.events.append(f"v {START_NS + k * MS} {speed!r} {START_NS + k * MS}")
        if k == 2700:
            sequence.reset(START_NS + k * MS)
        if k == 1000:  # one that is warming up is replaced
            sequence.load(*flat("polynomial"), START_NS + k * MS)
            sequence.load(*flat("mixture"), START_NS + k * MS)
        sequence.take_current(START_NS + k * MS, chance.uniform(0.3, 0.6), START_NS + k * MS)
        sequence.take_position(START_NS + k * MS, position, START_NS + k * MS)
    require_same(program, path, sequence, tmp_path)
    ran = [line.split()[4] for line in sequence.answers if line.startswith("x ")]
    assert len({*ran}) == 5
    assert sum(one != other for one, other in pairwise(ran)) == 5
    late = [int(line.split()[1]) for line in sequence.answers if line.startswith("l ")]
    assert len(late) == len({*late})


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
    return sequence


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


def seal(content):
    """Return a file's content with its checksum."""
    return content[:-4] + zlib.crc32(content[:-4]).to_bytes(4, "little")


def edit(content, old, new):
    """Return the content with another text of the same length."""
    assert content.count(old) == 1 and len(old) == len(new)
    return seal(content.replace(old, new))


def arrays_of(content):
    """Return the places of p and n of the sampling, and how many numbers n has."""
    start = HEAD.size + HEAD.unpack_from(content)[2]
    start += -start % 8
    numbers, counts, *_ = SIZES.unpack_from(content, start)
    return start + SIZES.size, start + SIZES.size + 8 * numbers, counts


def put(content, place, value):
    """Return the content with other 8 bytes at a place."""
    return seal(content[:place] + value + content[place + 8 :])


def refusal(program, path, content):
    """Return the line with which a file of this content is refused."""
    path.write_bytes(content)
    (path.parent / "sequence").write_text("settings 0 0\n")
    status, output = run([program, path, path.parent / "sequence"])
    assert (status, output.count("\n")) == (2, 1), output
    assert output.startswith(f"{path}: ")
    return output.removeprefix(f"{path}: ").strip()


SPOILT = {
    "no flat model file": lambda c: b"{}",
    "is no flat model file": lambda c: b"CES-FLOT" + c[8:],
    "is no flat model file; copy it again": lambda c: b"",
    "has more than 16 MiB": lambda c: c + bytes(1 << 24),
    "has version 1 of the format; expected 2": lambda c: seal(c[:8] + b"\1" + c[9:]),
    "its checksum is wrong": lambda c: c[:-9] + bytes([c[-9] ^ 1]) + c[-8:],
    "its text is longer than the file": lambda c: seal(c[:12] + b"\xff\xff\xff\x7f" + c[16:]),
    "has no 'core'": lambda c: edit(c, b"core=", b"cork="),
    "was written for the core 0123": lambda c: edit(c, c[21:25], b"0123"),
    "has no 'stroke_min_m'": lambda c: edit(c, b"stroke_min_m=", b"stroke_mid_m="),
    "delay_s is 'x.0'; expected a number": lambda c: edit(c, b"\ndelay_s=0.0", b"\ndelay_s=x.0"),
    "sampling has a size of -1": lambda c: put(c, arrays_of(c)[0] - 16, b"\xff" * 8),
    "sampling is longer than the file": lambda c: put(c, arrays_of(c)[0] - 32, (2**20).to_bytes(8, "little")),
    "sampling: number 3 is nan": lambda c: put(c, arrays_of(c)[0] + 24, np.float64(nan).tobytes()),
    "bytes too many": lambda c: seal(c[:-4] + bytes(12)),
    "structure is missing": lambda c: seal(c[: arrays_of(c)[1] + 8 * arrays_of(c)[2]] + bytes(4)),
}


@pytest.mark.parametrize("message", SPOILT)
def test_a_spoilt_file_is_refused_with_one_line(program, flat, tmp_path, message) -> None:
    content = flat("polynomial")[1].read_bytes()
    assert message in refusal(program, tmp_path / "m.ces", SPOILT[message](content))


def test_a_file_that_is_cut_off_or_flipped_anywhere_is_refused(program, flat, tmp_path) -> None:
    content, chance = flat("a longer delay")[1].read_bytes(), random.Random(1)
    for place in [chance.randrange(len(content)) for _ in range(30)]:
        refusal(program, tmp_path / "m.ces", content[:place])
        refusal(program, tmp_path / "m.ces", content[:place] + bytes([content[place] ^ 64]) + content[place + 1 :])


@pytest.mark.parametrize("name", MODELS)
def test_no_whole_number_leads_out_of_the_arrays(program, flat, tmp_path, name) -> None:
    """Whatever n holds, the file is refused, or its samples stay within the arrays (AddressSanitizer)."""
    model, path = flat(name)
    content, chance = path.read_bytes(), random.Random(2)
    events = fuzzed(model, 0.0, 3).events[:400]
    (tmp_path / "sequence").write_text("\n".join([*events, ""]))
    refused = 0
    _, start, count = arrays_of(content)
    for _ in range(60):
        value = chance.choice((-1, 0, 1, 2, 1000, 2**31, 2**62, -(2**63), 2**63 - 1, chance.randrange(200)))
        place = start + 8 * chance.randrange((len(content) - 4 - start) // 8 if chance.random() < 0.5 else count)
        (tmp_path / "m.ces").write_bytes(put(content, place, value.to_bytes(8, "little", signed=True)))
        status, output = run([program, tmp_path / "m.ces", tmp_path / "sequence"])
        assert status in (0, 2) and "Sanitizer" not in output and "runtime error" not in output, output
        refused += status == 2
    assert refused > 5
