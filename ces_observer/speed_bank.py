"""The bank: positions on uniform ticks in; position and speed, known at once and after a stated delay, out.

Each mode is the stationary Kalman filter (`ces_observer.kalman`) of strokes up to one frequency; the speed has the RMS
of the identification recordings in all of them. The output is the mean of the modes, weighted by how well each predicts
(multiple-model estimator with switching; Bar-Shalom, Li & Kirubarajan, Estimation with Applications to Tracking and
Navigation, sec. 11.6). The likelihood is Student's t, so that one wild sample does not decide for long.

Each mode is stable at any shift of the samples and after any number of lost ticks (`ces_observer.bank_design`), but no
fixed gains are so for every sequence of intervals. So a mode whose innovation is 300 times its spread restarts at the
mean: all states are bounded, whatever comes.

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
from typing import Any

from ces_observer.bank_design import BINS, EARLIEST, SHIFTS, Mode, Stroke, design_bank, spans_of
from ces_observer.kalman import ORDER

SWITCH_S = 0.2  # [s] mean time for which one mode is the right one
LOST = 1e4  # 1 + e' sharpness e of an innovation that is 300 times its spread


class SpeedBank:
    """The modes of a bank and their mean at the newest tick: `position` [m] and `speed` [m/s].

    `next_position` and `next_speed` are predicted for the tick after it. With a `delay` [ticks], `late` holds position
    and speed that long ago, as they are known now; None until the bank has run for so long.
    """

    def __init__(self, stroke: Stroke, delay: int = 0) -> None:
        modes = design_bank(stroke, delay)
        self._coast, self._take = _compile_updates(stroke, delay)
        self._gains = _gains_by_ticks(stroke, delay)
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
        state = (x for i in range(count) for x in (*self._steady(i, self._offset), 1.0 / count))
        self.state = (*state, 1.0)
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
        width = ORDER + len(self._offset) + 1
        modes = [self.state[width * i : width * (i + 1)] for i in range(len(lost))]
        offset = max(modes, key=lambda mode: mode[-1])[ORDER:-1]
        kept = ((*self._steady(i, offset), mode[-1]) if lost[i] else mode for i, mode in enumerate(modes))
        self.state = (*(x for mode in kept for x in mode), self.state[-1])

    def predict(self, ticks: float) -> float:
        """Return the position [m] expected `ticks` after the next tick."""
        bend = 0.5 * ticks * (self.next_speed - self.speed)
        return self.next_position + ticks * self._tick_s * (self.next_speed + bend)

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
        at = int(BINS * shift + (EARLIEST + 0.5))
        gains = self._gains[ticks if ticks < len(self._gains) else -1][at]
        self._take(self, gains, position, (shift - (at - EARLIEST) / BINS) * self._tick_s, motion)


def _response(stroke: Stroke) -> float:
    """Return the time [s] in which the fastest mode responds to a wrong speed, if the position alone is measured."""
    fastest = replace(stroke, frequencies_Hz=(max(stroke.frequencies_Hz),), max_gap_s=0.0, motion="", motion_noise=0.0)
    gains = design_bank(fastest)[0].gains[0][EARLIEST]
    return gains.position[0] / gains.speed[0]


Update = Callable[[SpeedBank, tuple[float, ...], float, float, float], None]


@lru_cache(maxsize=32)
def _gains_by_ticks(stroke: Stroke, delay: int) -> list[list[tuple[float, ...]]]:
    """Return the numbers of all modes in a row, for 0, 1, 2, ... ticks after a measurement and for each of SHIFTS."""
    modes, spans = design_bank(stroke, delay), spans_of(stroke)
    rows = [
        [tuple(x for mode in modes for x in flatten(mode, span, at)) for at in range(len(SHIFTS))]
        for span in range(len(spans))
    ]
    return [rows[bisect_left(spans, ticks)] for ticks in range(spans[-1] + 1)]


def flatten(mode: Mode, span: int, at: int) -> tuple[float, ...]:
    """Return the numbers of a mode that depend on span and shift, in the order in which an update takes them."""
    gains = mode.gains[span][at]
    rows = (*mode.measured[at], *(mode.motion[at] if len(gains.position) > 1 else ()))
    states = (x for row in gains.states for x in row)
    return (*rows, *gains.position, *gains.speed, *states, *gains.sharpness, gains.height)


@lru_cache(maxsize=32)
def _compile_updates(stroke: Stroke, delay: int) -> list[Update]:
    """Return the functions `coast` and `update`."""
    updates = []
    for measured in (False, True):
        names: dict[str, Any] = {"__builtins__": {"len": len}}
        exec(compile(update_source(stroke, delay, measured), "<update of a bank>", "exec"), names)
        updates.append(names["update"])
    return updates


def update_source(stroke: Stroke, delay: int, measured: bool) -> str:
    """Return the text of `update(bank, gains, position, shift, motion)`, with or without a measurement.

    It is written for the modes and compiled, like the tick of a polynomial: without loops it is faster. Names end in
    the number of their mode: x, v, a, b, c are its state, o the offset, w the weight, e and f the innovations, g0, g1,
    ... what `flatten` returns.
    """
    tick_s, modes = 1.0 / stroke.rate_Hz, design_bank(stroke, delay)
    numbers, first = range(len(modes)), modes[0].gains[0][0]
    both, states = len(first.position) > 1, len(first.states)
    stay = max(0.0, 1.0 - tick_s / SWITCH_S)
    leave = (1.0 - stay) / len(modes)
    names = "xvabco"[:states]
    errors = [f"{error}{i}" for error in "ef"[: 1 + both] for i in numbers]
    width, start = len(flatten(modes[0], 0, 0)), 8 if both else 4

    def corrected(text: str, i: int, row: int) -> str:
        """Return a state or output plus its gains, number `row` of those of the mode, times the innovations."""
        at = start + (1 + both) * row
        terms = " + ".join(f"g{at + k}_{i} * {error}{i}" for k, error in enumerate("ef"[: 1 + both]))
        return f"{text} + ({terms})" if measured else text

    def mean(values: Sequence[str]) -> str:
        return " + ".join(f"w{i} * ({value})" for i, value in enumerate(values))

    lines = [f"{', '.join(f'{name}{i}' for i in numbers for name in names + 'w')}, total = bank.state"]
    if measured:
        lines.append(f"{', '.join(f'g{k}_{i}' for i in numbers for k in range(width))}, = gains")
        lines.append(f"stay = {stay!r} / total")
        for i in numbers:
            g = [f"g{k}_{i}" for k in range(width)]
            seen = f"({g[0]} + shift) * v{i} - {g[1]} * a{i} - {g[2]} * b{i} - {g[3]} * c{i}"
            lines.append(f"e{i} = position - x{i} - {seen}")
            spread = f"{g[-2]} * e{i} * e{i}"
            if both:
                seen = f"{g[4]} * v{i} + {g[5]} * a{i} + {g[6]} * b{i} + {g[7]} * c{i}"
                lines.append(f"f{i} = motion - ({seen}{f' + o{i}' if states > ORDER else ''})")
                spread = f"({g[-4]} * e{i} * e{i} + {g[-3]} * e{i} * f{i} + {g[-2]} * f{i} * f{i})"
            lines += [f"u{i} = 1.0 + {spread}", f"s = u{i} * u{i}"]
            lines.append(f"w{i} = ({leave!r} + stay * w{i}) * {g[-1]} / (s * s * u{i})")
        lines.append(f"total = {' + '.join(f'w{i}' for i in numbers)}")
        lines.append(f"x = {mean([corrected(f'x{i}', i, 0) for i in numbers])}")
        lines.append(f"v = {mean([corrected(f'v{i}', i, 1) for i in numbers])}")
    else:
        lines += [
            f"{', '.join(errors)}, = {(0.0,) * len(errors)}",
            "x = total * bank.next_position",
            "v = total * bank.next_speed",
        ]
    state = []
    for i, mode in enumerate(modes):
        a, b = mode.speed, mode.position
        moved = [
            f"x{i} + {b[0]!r} * v{i} + {b[1]!r} * a{i} + {b[2]!r} * b{i} + {b[3]!r} * c{i}",
            f"{a[0]!r} * v{i} + a{i}",
            f"{a[1]!r} * v{i} + b{i}",
            f"{a[2]!r} * v{i} + c{i}",
            f"{a[3]!r} * v{i}",
            f"o{i}",
        ]
        texts = [corrected(text, i, 2 + row) for row, text in enumerate(moved[:states])]
        lines += [f"X{i} = {texts[0]}", f"V{i} = {texts[1]}"]
        state += [f"X{i}", f"V{i}", *texts[2:], f"w{i}"]
    lines += [
        f"bank.state = ({', '.join(state)}, total)",
        "bank.position, bank.speed = x / total, v / total",
        f"bank.next_position = ({mean([f'X{i}' for i in numbers])}) / total",
        f"bank.next_speed = ({mean([f'V{i}' for i in numbers])}) / total",
    ]
    if measured:
        spreads = [f"u{i}" for i in numbers]
        lost = ", ".join(f"{u} > {LOST!r}" for u in spreads)
        lines.append(f"if {' + '.join(spreads)} > {LOST!r}: bank.restart([{lost}])")
    if delay:
        lines += [
            f"bank.speeds.append((bank.position, {', '.join(f'v{i}' for i in numbers)}))",
            f"bank.errors.append(({', '.join(errors)},))",
            f"if len(bank.errors) <= {delay}: return",
            "position, " + ", ".join(f"s{i}" for i in numbers) + " = bank.speeds[0]",
            ", ".join(f"({', '.join(f'{e}_{k}' for e in errors)},)" for k in range(delay + 1)) + " = bank.errors",
        ]
        for i, mode in enumerate(modes):
            for error, *row in zip("ef", *mode.smoothing, strict=False):
                lines += [f"{'part +=' if k else 'part ='} {gain!r} * {error}{i}_{k}" for k, gain in enumerate(row)]
                lines.append(f"s{i} += part")
        lines.append(f"bank.late = position, ({mean([f's{i}' for i in numbers])}) / total")
    return "\n    ".join(["def update(bank, gains, position, shift, motion):", *lines, ""])
