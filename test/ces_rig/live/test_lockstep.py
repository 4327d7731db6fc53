"""Samples that wait for the commands that answer them: they never wait forever."""

from __future__ import annotations

from ces_rig.live.lockstep import MAX_DRAIN, QUIET, Lockstep

ANSWER_S = 2.0
IDLE_S = 1e-3


class Loop:
    """A rig in lockstep with a commander that answers each sample, and may send commands on its own."""

    def __init__(self, unasked_every: int = 0) -> None:
        self.now_s = 0.0
        self.lockstep = Lockstep(ANSWER_S, self.now_s)
        self.samples, self.answered, self._idle, self._every = 0, 0, 0, unasked_every

    def idle(self, periods: int, *, answers: bool = True) -> None:
        """Let idle periods pass; each sample is answered within its period, if at all."""
        for _ in range(periods):
            self.now_s += IDLE_S
            self._idle += 1
            if self.lockstep.is_due_idle(self.now_s):
                self._make_sample()
            if self._every and self._idle % self._every == 0 and self.lockstep.take_command():
                self._make_sample()
            if answers and self.answered < self.samples:
                self.answered = self.samples
                if self.lockstep.take_command():
                    self._make_sample()

    def _make_sample(self) -> None:
        self.samples += 1
        self.lockstep.mark_sample(self.now_s)


def test_samples_flow_freely_until_somebody_commands() -> None:
    loop = Loop()
    loop.idle(50, answers=False)
    assert loop.samples == 50


def test_once_drained_each_answer_makes_one_sample() -> None:
    loop = Loop()
    loop.lockstep.find_commander(True)
    loop.idle(QUIET - 1)
    assert loop.samples == 0
    loop.idle(101)
    assert loop.samples == 102  # the first at the end of the drain, then one for each answer


def test_an_overdue_answer_lets_samples_flow_until_a_command_comes() -> None:
    loop = Loop()
    loop.lockstep.find_commander(True)
    loop.idle(QUIET, answers=False)
    loop.idle(round(ANSWER_S / IDLE_S) - 1, answers=False)
    assert loop.samples == 1
    loop.idle(50, answers=False)
    assert loop.samples > 40
    before = loop.samples
    loop.idle(1)  # an answer at last: the next sample waits until no further one can be on its way
    loop.idle(QUIET - 1)
    assert loop.samples == before + 1
    loop.idle(50)
    assert loop.samples > before + 40
    assert loop.lockstep.unasked == 0


def test_commands_that_nobody_asked_for_do_not_stop_the_samples_forever() -> None:
    loop = Loop(unasked_every=10)  # as a controller does that commands the safe current
    loop.lockstep.find_commander(True)
    loop.idle(MAX_DRAIN - 1)
    assert loop.samples == 0
    loop.idle(500)
    assert loop.samples > 400
    assert loop.lockstep.unasked == 1


def test_without_a_commander_they_flow_again() -> None:
    loop = Loop()
    loop.lockstep.find_commander(True)
    loop.idle(QUIET)
    loop.lockstep.find_commander(False)
    before = loop.samples
    loop.idle(50, answers=False)
    assert loop.samples == before + 50
