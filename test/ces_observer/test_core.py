"""Where the tick runs: the compiled core or its source, and that a caller sees no difference."""

from __future__ import annotations

import random
import sys
from array import array
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from compiled_core import build_core

from ces_observer import core
from ces_observer.tick import ENTRY_POINTS
from ces_observer.tick.model import FORCE_HIGH, P_STRUCTURE
from ces_observer.tick.run import rounding_sample, run_half_width

MODULE = "ces_observer._tick"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return build_core(tmp_path_factory.mktemp("core"))


@pytest.fixture(autouse=True)
def _choose_anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delenv("CES_PLAIN_TICK", raising=False)
    core._compiled.cache_clear()
    yield
    core._compiled.cache_clear()


def install(monkeypatch: pytest.MonkeyPatch, module: Any) -> None:
    monkeypatch.setitem(sys.modules, MODULE, module)


def test_without_a_compiled_core_the_source_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, None)
    assert core.description() == "plain Python: no compiled core in this installation"
    assert core.floats((1.0, 2.0)) == [1.0, 2.0]
    assert isinstance(core.bind(rounding_sample), partial)


def test_the_environment_forbids_the_compiled_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CES_PLAIN_TICK", "1")
    install(monkeypatch, SimpleNamespace(DIGEST=core.tick_digest()))
    assert core.description() == "plain Python: CES_PLAIN_TICK is set"


def test_a_core_of_another_version_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, SimpleNamespace(DIGEST="of yesterday"))
    assert core.description() == "plain Python: the compiled core is of another version; build again"


def test_a_core_that_rounds_otherwise_is_not_used(monkeypatch: pytest.MonkeyPatch) -> None:
    def bind(name: str) -> Any:
        return lambda seed: rounding_sample(seed) * (1.0 if seed < core.SEEDS[-1] else 1.0 + sys.float_info.epsilon)

    install(monkeypatch, SimpleNamespace(DIGEST=core.tick_digest(), bind=bind))
    assert core.description() == "plain Python: the compiled core rounds otherwise (-ffp-contract=off?)"


@pytest.mark.needs("cc")
def test_a_compiler_that_fuses_products_and_sums_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flags = Path("/proc/cpuinfo")
    if not flags.exists() or " fma " not in flags.read_text():
        pytest.skip("this processor has no fused multiply-add")
    install(monkeypatch, build_core(tmp_path, "-O2", "-mfma", "-ffp-contract=fast"))
    assert core.description() == "plain Python: the compiled core rounds otherwise (-ffp-contract=off?)"


@pytest.mark.needs("cc")
def test_the_compiled_core_is_used(compiled: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, compiled)
    assert core.description() == "compiled core"
    assert core.floats((1.0,)) == array("d", [1.0])
    assert core.ints((1,)) == array("q", [1])
    assert set(ENTRY_POINTS) >= compiled.FUNCTIONS
    seeds = random.Random(1).sample(range(1 << 31), 200)
    assert list(map(core.bind(rounding_sample), seeds)) == list(map(rounding_sample, seeds))


@pytest.mark.needs("cc")
def test_other_functions_run_in_python(compiled: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, compiled)

    def run_half_width(values: Any) -> float:
        return float(values[0])

    assert core.bind(run_half_width, core.floats((3.0,)))() == 3.0


@pytest.mark.needs("cc")
def test_mistakes_are_explained(compiled: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, compiled)
    p, n, s = core.floats([0.0] * P_STRUCTURE), core.ints([0] * 8), core.floats([0.0] * 32)
    bind = core.bind
    with pytest.raises(TypeError, match="run_half_width: argument 2 is an array of 'd'; expected 'q'"):
        bind(run_half_width, p, p, s)
    with pytest.raises(TypeError, match="run_half_width takes 3 arrays; 2 given"):
        bind(run_half_width, p, n)
    with pytest.raises(TypeError, match="bytes-like object is required, not 'list'"):
        bind(run_half_width, [0.0], n, s)
    with pytest.raises(TypeError, match="run_half_width takes 0 numbers; 1 given"):
        bind(run_half_width, p, n, s)(1.0)
    with pytest.raises(LookupError, match="'nothing' is not in the compiled core"):
        compiled.bind("nothing")
    with pytest.raises(TypeError, match="cannot be interpreted as an integer"):
        bind(rounding_sample)("a")


@pytest.mark.needs("cc")
def test_a_state_that_cannot_be_written_is_refused(compiled: Any) -> None:
    p, n, k = array("d", [0.0] * P_STRUCTURE), array("q", [0] * 8), array("q", [0] * 8)
    fixed = memoryview(array("d", [0.0] * 32)).toreadonly()
    with pytest.raises(BufferError):
        compiled.bind("structure_reset" if "structure_reset" in compiled.FUNCTIONS else "lagged_reset", p, n, fixed, k)


@pytest.mark.needs("cc")
def test_arrays_stay_those_of_the_caller(compiled: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, compiled)
    p, n, s = core.floats([0.0] * P_STRUCTURE), core.ints([0] * 8), core.floats([0.0] * 32)
    half_width = core.bind(run_half_width, p, n, s)
    with pytest.raises(BufferError):
        p.append(1.0)  # type: ignore[attr-defined]
    p[FORCE_HIGH] = 1.0  # type: ignore[index]
    del half_width
    p.append(1.0)  # type: ignore[attr-defined]
