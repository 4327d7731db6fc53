"""What the log says of a model at start; a model is proved in a process of its own, and a wrong one says why."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from damper_models import damper_with_past, delayed_damper, plain_damper
from hydraulic_models import hydraulic_model
from patience import command_of, wait_until
from physical_models import LINEAR

from ces_observer.control.inverse_map import ModelInverse
from ces_observer.errors import ModelError
from ces_observer.nodes.model_check import INVERT, PROVE, ModelReload, Verdict, describe_model, require_stable


def test_a_model_that_clamps_says_so() -> None:
    model = delayed_damper(0.003)
    text = describe_model(model)
    assert text == f"polynomial_narx, {model.size}; delay_s 0.003; inputs outside the envelope are clamped to it"


def test_a_model_that_extrapolates_says_how_far_and_what_is_proved() -> None:
    text = describe_model(hydraulic_model(LINEAR))
    assert text.startswith(
        "hydraulic, uniflow, 2 curves of the external valve; delay_s 0; inputs outside the envelope are"
    )
    assert "force bound 24000 N for inputs in the envelope; 24000 N for any input" in text


def verdict_of(reload: ModelReload) -> Verdict:
    verdict = wait_until(reload.poll)
    assert verdict is not None
    return verdict


def test_a_stable_model_is_accepted_and_reported_once() -> None:
    reload, model = ModelReload(), plain_damper()
    reload.start(model, "model.json", [PROVE])
    assert verdict_of(reload) == Verdict(model, "model.json", "")
    assert reload.poll() is None


def test_nobody_waits_for_a_check(tmp_path: Path) -> None:
    """The check itself waits here until start and poll have returned."""
    begin, model = tmp_path / "begin", plain_damper()
    program = (
        "import pathlib, time; from ces_observer.nodes import model_check\n"
        f"while not pathlib.Path({str(begin)!r}).exists(): time.sleep(0.01)\n"
        "raise SystemExit(model_check.main())"
    )
    reload = ModelReload(("-c", program))
    reload.start(model, "model.json", [PROVE])
    assert reload.poll() is None
    begin.touch()
    assert verdict_of(reload) == Verdict(model, "model.json", "")


def test_an_unstable_model_is_refused_with_the_reason() -> None:
    reload = ModelReload()
    reload.start(damper_with_past(1.01), "worn.json", [PROVE])
    assert verdict_of(reload).error.startswith("worn.json: it is not proved to be a contraction")


def test_without_a_check_it_is_accepted_at_once() -> None:
    reload = ModelReload()
    reload.start(damper_with_past(1.01), "worn.json", [])
    verdict = reload.poll()
    assert verdict is not None and not verdict.error


@pytest.mark.slow
def test_the_inverse_survives_a_round_trip_as_text() -> None:
    reload, model = ModelReload(), plain_damper()
    reload.start(model, "model.json", [PROVE, INVERT])
    verdict = verdict_of(reload)
    assert verdict.error == ""
    assert ModelInverse.from_json(verdict.inverse) == ModelInverse.from_model(model)


def test_a_model_is_proved_whatever_its_file_says() -> None:
    with pytest.raises(ModelError, match="not proved to be a contraction"):
        require_stable(damper_with_past(1.01), "model.json")
    require_stable(delayed_damper(0.003), "model.json")


def test_a_model_without_an_inverse_is_refused_with_the_reason() -> None:
    reload, model = ModelReload(), plain_damper()
    reload.start(replace(model, envelope=replace(model.envelope, speed_m_s=(0.0, 1.0))), "one_way.json", [INVERT])
    assert verdict_of(reload).error == "one_way.json: speeds from 0 to 1 m/s; a controller needs both directions"


def test_a_newer_model_takes_the_place_of_the_one_being_checked() -> None:
    reload = ModelReload()
    reload.start(damper_with_past(1.01), "old.json", [PROVE])
    reload.start(plain_damper(), "new.json", [PROVE])
    assert verdict_of(reload).source == "new.json"
    assert reload.poll() is None


CHILDREN = {  # programs in place of the check, and what is said of their models
    "import sys; sys.exit(3)": "its check ended with status 3",
    "import os; os.kill(os.getpid(), 9)": "its check was killed, as the kernel does when memory is short",
    "import os; os.kill(os.getpid(), 11)": "its check ended with status -11",
    "import os; os.kill(os.getpid(), 24)": "its check took more than 300 s of processor time",
    "print('{{{ nonsense')": "its check gave an answer that is none",
    'print(\'{"sha256": "0", "tasks": [], "inverse": 1}\')': "its check gave an answer that is none",
    "print('[' * 100000)": "its check gave an answer that is none",
    "pass": "its check gave an answer that is none",
    "import os; os.write(1, bytes(range(256)) * 100000)": "its check gave an answer that is none",
    "import os, sys; os.write(1, bytes([27, 7, 65])); sys.exit(2)": "model.json: ??A",
}


@pytest.mark.parametrize("program", CHILDREN)
def test_a_child_that_dies_or_answers_nonsense_is_no_acceptance(program: str) -> None:
    reload = ModelReload(("-c", program))
    reload.start(plain_damper(), "model.json", [PROVE])
    verdict = verdict_of(reload)
    assert verdict.error.startswith("model.json: ") and CHILDREN[program] in verdict.error
    assert verdict.inverse == ""


@pytest.mark.slow
def test_a_child_that_hangs_is_ended(tmp_path: Path) -> None:
    """It ignores what it can ignore, and is gone afterwards."""
    pid = tmp_path / "pid"
    program = (
        f"import os, signal, time; signal.signal(15, signal.SIG_IGN); open({str(pid)!r}, 'w').write(str(os.getpid()));"
        "time.sleep(3600)"
    )
    reload = ModelReload(("-c", program))
    reload.start(plain_damper(), "model.json", [PROVE])
    wait_until(lambda: pid.exists() and pid.read_text())
    assert reload.poll() is None
    reload._longest_s = 0.5  # it has begun now, however long that took
    assert verdict_of(reload).error.startswith("model.json: not checked within 0.5 s")
    wait_until(lambda: reload.poll() is None and not Path("/proc", pid.read_text()).exists())


def test_a_check_that_needs_too_much_memory_says_so() -> None:
    """The limits are those of model_check, met by a child that takes memory after it has set them."""
    program = (
        "from ces_observer.nodes import model_check as c; c._check = lambda *_: len(bytes(1 << 31)); exit(c.main())"
    )
    reload = ModelReload(("-c", program))
    reload.start(plain_damper(), "model.json", [PROVE])
    assert verdict_of(reload).error == "model.json: its check needs more than 1024 MiB of memory"


def test_a_check_is_the_first_that_the_kernel_ends_and_ends_with_its_parent(tmp_path: Path) -> None:
    """A parent that is killed has no time to end its child."""
    state = tmp_path / "state"
    child = (
        "import os, time; from ces_observer.nodes import model_check as c; c._limit_this_process();"
        f"open({str(state)!r} + '.new', 'w').write(open('/proc/self/oom_score_adj').read() + ' ' + str(os.getpid()));"
        f"os.rename({str(state)!r} + '.new', {str(state)!r}); time.sleep(3600)"
    )
    start = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {child!r}])"
    parent = subprocess.Popen([sys.executable, "-c", start])
    wait_until(state.exists)
    score, pid = state.read_text().split()
    assert score == "1000"
    parent.kill()
    parent.wait()
    wait_until(lambda: not command_of(pid))


def test_a_cancelled_check_leaves_no_verdict() -> None:
    reload = ModelReload()
    reload.start(plain_damper(), "model.json", [PROVE])
    reload.cancel()
    assert reload.poll() is None
