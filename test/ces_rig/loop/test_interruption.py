"""Ctrl-C while a model is searched stops the program, although the search catches it."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from iterate_examples import make_plan, small_rig

from ces_identify.numerics.search import SearchResult
from ces_rig.loop.identification import interruptible
from ces_rig.loop.iterate import IterateListener, Iterations


@pytest.fixture(autouse=True)
def _heard() -> Iterator[None]:
    """Hear Ctrl-C also where the tests themselves run in the background, which ignores it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_a_caught_interrupt_comes_again_after_the_block() -> None:
    before = signal.getsignal(signal.SIGINT)
    steps = []
    with pytest.raises(KeyboardInterrupt), interruptible():
        with contextlib.suppress(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        steps.append("the block went on")
    assert steps
    assert signal.getsignal(signal.SIGINT) is before


class InterruptingListener(IterateListener):
    """Ctrl-C comes with the first result of the search."""

    came = False

    def listen_search(self, result: SearchResult) -> None:
        if not self.came:
            self.came = True
            os.kill(os.getpid(), signal.SIGINT)


def test_a_model_of_a_search_that_was_cut_is_not_kept(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        Iterations(make_plan(tmp_path), small_rig(), tmp_path, InterruptingListener()).run()
    assert (tmp_path / "iteration_01" / "recording").exists()
    assert not (tmp_path / "iteration_01" / "model.json").exists()
