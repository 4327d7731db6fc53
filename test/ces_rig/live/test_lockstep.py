"""Samples that wait for the commands that answer them: they never wait forever."""

from __future__ import annotations

from ces_rig.live.timing import MAX_LOOKS, QUIET, WINDOW, Lockstep

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

    def be_followed(self) -> None:
        """Answer a window of samples that flow freely, and be found."""
        self.idle(WINDOW)
        self.lockstep.find_commander(True)

    def stop_unasked(self) -> None:
        self._every = 0

    def _make_sample(self) -> None:
        self.samples += 1
        self.lockstep.mark_sample(self.now_s)


def test_once_drained_each_answer_makes_one_sample() -> None:
    loop = Loop()
    loop.idle(50, answers=False)
    assert loop.samples == 50, "samples flow freely until somebody commands"
    loop = Loop()
    loop.be_followed()
    loop.idle(QUIET - 1)
    assert loop.samples == WINDOW
    loop.idle(101)
    assert loop.samples == WINDOW + 102  # the first at the end of the drain, then one for each answer
    loop.lockstep.find_commander(False)
    loop.idle(50, answers=False)
    assert loop.samples == WINDOW + 152, "without a commander they flow again"


def test_an_overdue_answer_lets_samples_flow_until_a_command_comes() -> None:
    loop = Loop()
    loop.be_followed()
    loop.idle(QUIET, answers=False)
    loop.idle(round(ANSWER_S / IDLE_S) - 1, answers=False)
    assert loop.samples == WINDOW + 1
    loop.idle(50, answers=False)
    assert loop.samples > WINDOW + 40
    before = loop.samples
    loop.idle(1)  # an answer at last: the next sample waits until no further one can be on its way
    loop.idle(QUIET - 1)
    assert loop.samples == before + 1
    loop.idle(50)
    assert loop.samples > before + 40
    assert loop.lockstep.unasked == 0


def test_commands_that_nobody_asked_for_do_not_stop_the_samples_forever() -> None:
    loop = Loop(unasked_every=10)  # as a controller does that commands the safe current
    loop.be_followed()
    loop.idle(500)
    assert loop.samples == WINDOW
    loop.idle(1000)
    assert loop.samples > WINDOW + 400
    assert loop.lockstep.unasked == 1


def test_a_slow_commander_ends_its_queue_before_samples_wait_for_it() -> None:
    lockstep, now_s, queue, longest = Lockstep(ANSWER_S, 0.0), 0.0, 0, 0
    for period in range(70_000):
        now_s += IDLE_S
        due = lockstep.is_due_idle(now_s)
        if queue and period % 10 == 0:
            queue -= 1
            due = lockstep.take_command() or due
        if period % 1000 == 999:
            lockstep.find_commander(True)
        if due:
            queue += 1
            lockstep.mark_sample(now_s)
        longest = max(longest, queue) if period > 65_000 else 0
    assert longest == 1
    assert lockstep.unasked == 0


def test_samples_flow_until_the_commander_answers_them() -> None:
    loop = Loop(unasked_every=10)  # a controller without an estimate: the observer is warming up
    for _ in range(MAX_LOOKS):
        loop.idle(400, answers=False)
        loop.lockstep.find_commander(True)
    assert loop.samples == MAX_LOOKS * 400
    loop.stop_unasked()
    loop.idle(400)
    loop.lockstep.find_commander(True)
    before = loop.samples
    loop.idle(QUIET - 1)
    assert loop.samples == before
    loop.idle(50)
    assert loop.samples > before
    assert loop.lockstep.unasked == 0


def test_a_commander_that_answers_few_samples_is_followed_in_the_end() -> None:
    loop = Loop()
    for _ in range(MAX_LOOKS + 1):
        loop.idle(400, answers=False)
        loop.lockstep.find_commander(True)
    before = loop.samples
    loop.idle(QUIET - 1, answers=False)
    assert loop.samples == before
