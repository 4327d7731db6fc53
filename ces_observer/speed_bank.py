"""The bank: positions on uniform ticks in; position and speed, known at once and after a stated delay, out.

Each mode is the stationary Kalman filter (`ces_observer.kalman`) of strokes up to one frequency; the speed has the RMS
of the identification recordings in all of them. The output is the mean of the modes, weighted by how well each predicts
(multiple-model estimator with switching; Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and
Navigation, sec. 11.6). The likelihood is Student's t, so that one wild sample does not decide for long.

Tests find each mode stable at constant shifts of the samples and numbers of lost ticks (`ces_observer.bank_design`),
but no fixed gains are so for every sequence of intervals. So a mode whose innovation is 300 times its spread restarts
at the mean, which keeps the states small in every sequence tried; this is not proved.

After `delay` ticks, the innovations that came later have corrected the speed (fixed-lag smoothing). Innovations that
come later still correct it afterwards, discounted with AFTER_S: a damper's force follows the speed within milliseconds,
so that a correction which is a tick late still makes up for most of the error.

A mode is held in the companion form of its speed,

    x' = x + b0 v + b1 z1 + b2 z2 + b3 z3,   v' = a1 v + z1,   z1' = a2 v + z2,   z2' = a3 v + z3,   z3' = a4 v,

plus gains times its innovation. A measured speed or acceleration is a second measurement, and an offset of it the sixth
state. `ces_identify.numerics.speed_kernels` computes the same over whole arrays.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import Any, ClassVar

from ces_observer.bank_design import BINS, EARLIEST, SHIFTS, BankMode, BankSettings, design_bank, spans_of
from ces_observer.kalman import ORDER

PER_TICK, FIRST = float(BINS), EARLIEST + 0.5  # for the place of a shift in SHIFTS
SWITCH_S = 0.2  # [s] mean time for which one mode is the right one
COMPANION = ("A1#", "A2#", "A3#", "A4#", "B0#", "B1#", "B2#", "B3#")
LOST = 1e4  # 1 + e' sharpness e of an innovation that is 300 times its spread


class SpeedBank:
    """The modes of a bank and their mean at the newest tick: `position` [m] and `speed` [m/s].

    `next_position` and `next_speed` are predicted for the tick after it. With a `delay` [ticks], `late` holds position
    and speed that long ago, as they are known now; None until the bank has run for so long.
    """

    def __init__(self, stroke: BankSettings, delay: int = 0) -> None:
        modes = design_bank(stroke, delay)
        self._coast, self._take = _compile_updates(stroke, delay)
        self._gains = _gains_by_ticks(stroke, delay)
        self._longest = len(self._gains) - 1
        self._tick_s = 1.0 / stroke.rate_Hz
        self._moves = [mode.speed for mode in modes]
        self._offset = (0.0,) * (len(modes[0].gains[0][0].states) - ORDER)
        self._errors = len(modes) * len(modes[0].gains[0][0].position)
        self._length = delay + 1
        self.response_s = _response(stroke)
        self.reset(0.0)

    def reset(self, position: float, speed: float = 0.0) -> None:
        """Restart at `position` [m] with a constant `speed` [m/s]."""
        count = len(self._moves)
        self.position, self.next_position = position, position + self._tick_s * speed
        self.speed = self.next_speed = speed
        self.late: tuple[float, float] | None = None
        self.state = tuple((*self._steady(i, self._offset), 1.0 / count) for i in range(count))  # of each mode
        self.total = 1.0
        self.speeds = deque([(position, *[speed] * count)], self._length)
        self.errors = deque([(0.0,) * self._errors], self._length)

    def _steady(self, mode: int, offset: Sequence[float]) -> tuple[float, ...]:
        """Return a mode's state at the mean, with a speed that stays as it is until it decays."""
        a1, a2, a3, _ = self._moves[mode]
        speed = self.next_speed
        z1 = speed - a1 * speed
        z2 = z1 - a2 * speed
        return (self.next_position, speed, z1, z2, z2 - a3 * speed, *offset)

    def restart(self, lost: Sequence[bool]) -> None:
        """Restart the modes that are lost at the mean, with the offset of the likeliest."""
        offset = max(self.state, key=lambda mode: mode[-1])[ORDER:-1]
        kept = ((*self._steady(i, offset), mode[-1]) if lost[i] else mode for i, mode in enumerate(self.state))
        self.state = tuple(kept)

    def save(self) -> dict[str, Any]:
        """Return the present state, for `restore`."""
        return {**vars(self), "speeds": self.speeds.copy(), "errors": self.errors.copy()}

    def restore(self, saved: dict[str, Any]) -> None:
        """Return to a saved state."""
        vars(self).update(saved)

    def coast(self) -> None:
        """Advance by a tick without a measurement."""
        self._coast(self, (), 0.0, 0.0, 0.0)

    def update(self, ticks: int, position: float, shift: float, motion: float = 0.0) -> None:
        """Advance to the next tick, `ticks` after the last measured one, and take its measurement.

        `position` [m] is the mean of the samples, `shift` that of their times after the tick, -1.5 to 0.5 ticks;
        `motion` is the signal measured beside it.
        """
        bins = self._gains[ticks if ticks < self._longest else self._longest]
        gains, middle = bins[int(PER_TICK * shift + FIRST)]
        self._take(self, gains, position, (shift - middle) * self._tick_s, motion)


def _response(stroke: BankSettings) -> float:
    """Return the time [s] in which the fastest mode responds to a wrong speed, if the position alone is measured."""
    fastest = replace(stroke, frequencies_Hz=(max(stroke.frequencies_Hz),), max_gap_s=0.0, motion="", motion_noise=0.0)
    gains = design_bank(fastest)[0].gains[0][EARLIEST]
    return gains.position[0] / gains.speed[0]


Update = Callable[[SpeedBank, tuple[float, ...], float, float, float], None]


@lru_cache(maxsize=32)
def _gains_by_ticks(stroke: BankSettings, delay: int) -> list[list[tuple[tuple[float, ...], float]]]:
    """Return the numbers of all modes in a row, and the shift [ticks], by ticks after a measurement and SHIFTS."""
    modes, spans = design_bank(stroke, delay), spans_of(stroke)
    rows = [
        [(tuple(x for mode in modes for x in flatten(mode, span, at)), shift / BINS) for at, shift in enumerate(SHIFTS)]
        for span in range(len(spans))
    ]
    return [rows[bisect_left(spans, ticks)] for ticks in range(spans[-1] + 1)]


def flatten(mode: BankMode, span: int, at: int) -> tuple[float, ...]:
    """Return the numbers of a mode that depend on span and shift, in the order in which an update takes them."""
    gains = mode.gains[span][at]
    rows = (*mode.measured[at], *(mode.motion[at] if len(gains.position) > 1 else ()))
    states = (x for row in gains.states for x in row)
    return (*rows, *gains.position, *gains.speed, *states, *gains.sharpness, gains.height)


@lru_cache(maxsize=32)
def _compile_updates(stroke: BankSettings, delay: int) -> list[Update]:
    """Return the functions `coast` and `update`."""
    updates = []
    for measured in (False, True):
        names: dict[str, Any] = {"__builtins__": {"len": len}}
        exec(compile(str(UpdateText(stroke, delay, measured)), "<update of a bank>", "exec"), names)
        updates.append(names["update"])
    return updates


class UpdateText:
    """Writes `update(bank, gains, position, shift, motion)`, with or without a measurement.

    It is written for the modes and compiled, like the tick of a polynomial: without loops it is faster. `#` stands for
    the number of a mode: x, v, a, b, c are its state, o the offset, w the weight, e and f the innovations, and capital
    letters the next state. `gains` has what `flatten` returns: h and m are the rows of the measurements, k and l the
    gains on e and f. A and B are the numbers of the companion form.
    """

    SEEN = "e# = position - x# - (hv# + shift) * v# - ha# * a# - hb# * b# - hc# * c#"
    MOTION = "f# = motion - (mv# * v# + ma# * a# + mb# * b# + mc# * c# + o#)"
    MOVED: ClassVar[dict[str, str]] = {
        "X": "x# + B0# * v# + B1# * a# + B2# * b# + B3# * c#",
        **{"V": "A1# * v# + a#", "A": "A2# * v# + b#", "B": "A3# * v# + c#", "C": "A4# * v#", "O": "o#"},
    }

    def __init__(self, stroke: BankSettings, delay: int, measured: bool) -> None:
        self._modes, self._delay, self._measured = design_bank(stroke, delay), delay, measured
        self._size, self._errors = len(self._modes[0].gains[0][0].states), ["e#", "f#"][: 1 + bool(stroke.motion)]
        self._stay = max(0.0, 1.0 - 1.0 / stroke.rate_Hz / SWITCH_S)

    def __str__(self) -> str:
        lines = [f"{self._each(self._state('x#', 'v#', 'a#', 'b#', 'c#', 'o#'))}, = bank.state", "total = bank.total"]
        lines += self._take() if self._measured else ["x = total * bank.next_position", "v = total * bank.next_speed"]
        moved = {name: self._fix(text, name) for name, text in self.MOVED.items()}
        lines += [
            self._each(f"X# = {moved['X']}\nV# = {moved['V']}", "\n"),
            f"bank.state, bank.total = ({self._each(self._state(*('X#', 'V#', *list(moved.values())[2:])))},), total",
            "bank.position, bank.speed = x / total, v / total",
            f"bank.next_position, bank.next_speed = ({self._mean('X#')}) / total, ({self._mean('V#')}) / total",
        ]
        if self._measured:
            lost = self._each(f"u# > {LOST!r}")
            lines.append(f"if {self._each('u#', ' + ')} > {LOST!r}: bank.restart([{lost}])")
        lines += self._look_back() if self._delay else []
        return "\n".join(["def update(bank, gains, position, shift, motion):", *lines]).replace("\n", "\n    ")

    def _take(self) -> list[str]:
        """Return the lines of innovations, weights and their mean."""
        both = len(self._errors) > 1
        pairs = (f"k{name}#, l{name}#" if both else f"k{name}#" for name in ("x", "v", *list(self.MOVED)[: self._size]))
        rows, sharp = ("hv#, ha#, hb#, hc#", "mv#, ma#, mb#, mc#")[: 1 + both], "hee#, hef#, hff#" if both else "hee#"
        motion = self.MOTION if self._size > ORDER else self.MOTION.replace(" + o#", "")
        spread = "(hee# * e# * e# + hef# * e# * f# + hff# * f# * f#)" if both else "hee# * e# * e#"
        leave = (1.0 - self._stay) / len(self._modes)
        weight = f"w# = ({leave!r} + stay * w#) * height# / (s * s * u#)"
        return [
            f"{self._each(', '.join([*rows, *pairs, sharp, 'height#']))}, = gains\nstay = {self._stay!r} / total",
            self._each("\n".join([self.SEEN, *[motion] * both, f"u# = 1.0 + {spread}", "s = u# * u#", weight]), "\n"),
            f"total = {self._each('w#', ' + ')}",
            f"x = {self._mean(self._fix('x#', 'x'))}\nv = {self._mean(self._fix('v#', 'v'))}",
        ]

    def _look_back(self) -> list[str]:
        """Return the lines of the tick `delay` ticks ago, by all innovations since."""
        errors = [self._each(error) for error in self._errors]
        known = ", ".join(errors if self._measured else ["0.0"] * len(self._errors) * len(self._modes))
        past = ", ".join(f"({', '.join(errors).replace(',', f'_{k},')}_{k},)" for k in range(self._delay + 1))
        lines = [
            f"bank.speeds.append((bank.position, {self._each('v#')}))\nbank.errors.append(({known},))",
            f"if len(bank.errors) <= {self._delay}: return",
            f"position, {self._each('s#')} = bank.speeds[0]\n{past} = bank.errors",
        ]
        for i, mode in enumerate(self._modes):
            for error, *row in zip("ef", *mode.smoothing, strict=False):
                lines += [f"part {'+=' if k else '='} {gain!r} * {error}{i}_{k}" for k, gain in enumerate(row)]
                lines.append(f"s{i} += part")
        return [*lines, f"bank.late = position, ({self._mean('s#')}) / total"]

    def _state(self, *texts: str) -> str:
        return f"({', '.join(texts[: self._size])}, w#)"

    def _fix(self, text: str, name: str) -> str:
        """Return a state or output plus its gains times the innovations."""
        terms = " + ".join(f"{gain}{name}# * {error}" for gain, error in zip("kl", self._errors, strict=False))
        return f"{text} + ({terms})" if self._measured else text

    def _mean(self, value: str) -> str:
        return self._each(f"w# * ({value})", " + ")

    def _each(self, text: str, joint: str = ", ") -> str:
        """Return the text for each mode."""
        texts = []
        for i, mode in enumerate(self._modes):
            filled = text
            for name, number in zip(COMPANION, (*mode.speed, *mode.position), strict=True):
                filled = filled.replace(name, repr(number))
            texts.append(filled.replace("#", str(i)))
        return joint.join(texts)
