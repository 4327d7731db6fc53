"""How a model forgets where it was started: the same input after many pasts, and starts anew along the recordings.

Each of PASTS pasts (rest at both ends of the stroke and of the currents, noise over the envelope, fast and slow
triangles, pieces of the recordings) leads over to the same input: rest, constant speed, slow triangles, or a piece of a
recording. What is left is the largest difference between the forces of any two pasts at the end.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ces_data.arrays import F, I, Mask
from ces_identify.limits import ForgettingLimits
from ces_identify.numerics.core import run_batch
from ces_identify.prepare.series import Series
from ces_observer.model import Model

PASTS = 24
PAST_S, JOIN_S = 2.0, 0.25  # [s] length of a past, and of the way from its end to where the same input begins
TAIL = 0.05  # share of the time at the end in which differences count
SLOW = 0.05  # of the fastest speed, in slow triangles
NOISE_HZ = (0.3, 12.0)
SERIES = 3  # of the recordings, the longest
RESTARTS = 8  # along each

Course = F
"""Inputs (3, ticks): position [m], speed [m/s] and current [A]."""
ModelRun = Callable[[Course, I], tuple[F, Mask]]
BatchRun = Callable[[Model, Course, I], tuple[F, Mask]]


@dataclass(frozen=True)
class Forgetting:
    """What is `left` of `pasts` by the kind of the same input, `after_s`, in shares of the force's spread [N].

    `width_N` is that of the force envelope. `settles_s` is how long a run on the recordings, started anew, differs by
    more than LEFT from one that began earlier; infinite if it always does.
    """

    pasts: int
    after_s: float
    left: Mapping[str, float]
    spread_N: float
    width_N: float
    settles_s: float

    @property
    def largest(self) -> float:
        """The largest share of the force's spread that is left."""
        return max(self.left.values(), default=0.0)

    @property
    def suffices(self) -> bool:
        """Whether less than LEFT is left in time."""
        return self.largest <= ForgettingLimits.LEFT and self.settles_s <= self.after_s

    def describe(self) -> str:
        """Return what is left, in words."""
        if self.largest > ForgettingLimits.LEFT:
            worst = max(self.left, key=lambda name: self.left[name])
            return f"{100.0 * self.largest:.3g} % of its force's spread is left after {self.after_s:g} s ({worst})"
        return f"it settles on its recordings in {self.settles_s:.3g} s"

    def to_mapping(self) -> dict[str, object]:
        """Return it as in a model file."""
        return {
            "how": f"measured from {self.pasts} pasts",
            "after_s": self.after_s,
            "left_percent": {name: round(100.0 * share, 4) for name, share in self.left.items()},
            "left_percent_of_envelope": round(100.0 * self.largest * self.spread_N / self.width_N, 4),
        }


def run_core(model: Model, inputs: Course, segments: I) -> tuple[F, Mask]:
    """Return the batch run of a model whose structure has a tick of its own."""
    return run_batch(model.body, model.operating_range, inputs, segments)


def find_forgetting(model: Model, series: Sequence[Series], forget_s: float, run: BatchRun = run_core) -> Forgetting:
    """Return how a certified model forgets, measured from many pasts where it is not proved in `forget_s` [s]."""
    proved_s = (model.certificate or {}).get("forgets_s", np.inf) if model.body.forgets_by_proof else np.inf
    return measure_forgetting(model, series, forget_s, proved_s > forget_s, run)


def measure_forgetting(
    model: Model, series: Sequence[Series], after_s: float, pasts: bool = True, run: BatchRun = run_core
) -> Forgetting:
    """Return what a model has left of its past `after_s`; `series` are recordings within its envelope.

    Without `pasts`, only starts anew along the recordings are run. `run` is the batch run of the model.
    """
    chosen = sorted(series, key=len)[-SERIES:]
    runs = [(recorded, run(model, recorded.inputs, recorded.segments)[0]) for recorded in chosen]
    spread = float(np.std(np.concatenate([force for _, force in runs])))
    left = _left_of_pasts(partial(run, model), _Courses(model, chosen, after_s), spread) if pasts else {}
    low, high = model.force_envelope_N
    limit_N = ForgettingLimits.LEFT * spread
    settles = max(_settling_s(partial(run, model), recorded, force, limit_N, after_s) for recorded, force in runs)
    return Forgetting(PASTS if pasts else 0, after_s, left, spread, high - low, settles)


def _left_of_pasts(run: ModelRun, courses: _Courses, spread_N: float) -> dict[str, float]:
    """Return the largest share of a spread of the force that is left, by the kind of the same input."""
    pasts, left = courses.pasts(), dict[str, float]()
    for name, same in courses.same_inputs():
        share = _left(run, [courses.join(past, same) for past in pasts], same.shape[1]) / spread_N
        left[name] = max(left.get(name, 0.0), share)
    return left


def _left(run: ModelRun, courses: Sequence[Course], ticks: int) -> float:
    """Return the largest difference of the forces [N] in the last TAIL of `ticks`, at which all courses are equal."""
    length = courses[0].shape[1]
    starts = length * np.arange(len(courses))
    force, _ = run(np.concatenate(courses, axis=1), np.stack([starts, starts + length], axis=1))
    tail = force.reshape(len(courses), length)[:, -max(1, round(TAIL * ticks)) :]
    return float(np.ptp(tail, axis=0).max())


def _settling_s(run: ModelRun, series: Series, force: F, limit_N: float, after_s: float) -> float:
    """Return the longest time [s] for which starts anew along a series differ from its run by more than a limit (RMS).

    It is infinite if they still do after twice `after_s`, or at the end of what was recorded if that comes later.
    """
    first, stop = series.segments[np.diff(series.segments)[:, 0].argmax()]
    length = min(round(2.0 * after_s * series.rate_Hz), (stop - first) // 2)
    starts = np.linspace(first, stop - length, RESTARTS + 1).astype(np.int64)[1:]
    parts = [series.inputs[:, at : at + length] for at in starts]
    ends = length * np.arange(1, RESTARTS + 1)
    anew, _ = run(np.concatenate(parts, axis=1), np.stack([ends - length, ends], axis=1))
    apart = (anew - np.concatenate([force[at : at + length] for at in starts])).reshape(RESTARTS, length)
    window = max(1, round(ForgettingLimits.WINDOW_S * series.rate_Hz))
    squares = np.cumsum(apart**2, axis=1)[:, window - 1 :: window]
    late = np.flatnonzero((np.diff(squares, axis=1, prepend=0.0) > window * limit_N**2).any(axis=0))
    last = window * (int(late[-1]) + 1) if len(late) else 0
    seconds = round(last / series.rate_Hz, 4)
    return float("inf") if last > length - window and seconds > after_s else seconds


class _Courses:
    """Courses of the inputs at the rate of a model, within its envelope."""

    def __init__(self, model: Model, series: Sequence[Series], after_s: float) -> None:
        envelope = model.envelope
        self.rate, self.series = model.sampling.rate_Hz, series
        self.low, self.high = envelope.position_m
        self.fastest = min(map(abs, envelope.speed_m_s)) or max(map(abs, envelope.speed_m_s))
        self.currents = sorted({*envelope.current_A, 0.5 * sum(envelope.current_A)})
        self.past = round(PAST_S * self.rate)
        self.same = max(1, round(after_s * self.rate / (1.0 - TAIL)))
        self.random = np.random.default_rng(0)

    def pasts(self) -> list[Course]:
        """Return PASTS pasts of the same length."""
        ends = (self.currents[0], self.currents[-1])
        courses = [self.hold(at, current, self.past) for at in (self.low, self.high) for current in ends]
        for speed in (self.fastest, SLOW * self.fastest):
            courses += [self.triangle(s * speed, current, self.past) for s in (1.0, -1.0) for current in ends]
        courses += [piece for piece in (self.piece(self.past) for _ in range(4)) if piece is not None]
        return courses + [self.noise() for _ in range(PASTS - len(courses))]

    def same_inputs(self) -> list[tuple[str, Course]]:
        """Return what follows all pasts, by kind."""
        middle, half = 0.5 * (self.low + self.high), self.currents[len(self.currents) // 2]
        rests = [(middle, current) for current in self.currents] + [(at, half) for at in (self.low, self.high)]
        crossing = (self.high - self.low) * self.rate / self.same
        courses = [("rest", self.hold(at, current, self.same)) for at, current in rests]
        courses += [("constant speed", self.triangle(s * crossing, half, self.same)) for s in (1.0, -1.0)]
        courses.append(("slow triangles", self.triangle(SLOW * self.fastest, half, self.same)))
        pieces = [self.piece(self.same, recorded) for recorded in self.series]
        return courses + [("recordings", piece) for piece in pieces if piece is not None]

    def hold(self, position: float, current: float, ticks: int) -> Course:
        """Return rest at a position and a current."""
        return np.repeat([[position], [0.0], [current]], ticks, axis=1)

    def triangle(self, speed: float, current: float, ticks: int) -> Course:
        """Return strokes between the ends at constant speed [m/s], from the end that its sign leads away from."""
        stroke, way = self.high - self.low, abs(speed) / self.rate * np.arange(ticks)
        phase = np.mod(way, 2.0 * stroke)
        back = phase >= stroke
        along = np.where(back, 2.0 * stroke - phase, phase)
        position = self.low + along if speed > 0.0 else self.high - along
        return np.stack([position, np.where(back, -speed, speed), np.full(ticks, current)])

    def noise(self) -> Course:
        """Return a rough stroke that reaches an end of the envelope, with steps of the current."""
        time_s = np.arange(self.past) / self.rate
        low, high = np.log(NOISE_HZ[0]), np.log(min(NOISE_HZ[1], 0.2 * self.rate))
        turns = 2.0 * np.pi * np.exp(self.random.uniform(low, high, (4, 1)))
        phases = turns * time_s + self.random.uniform(0.0, 2.0 * np.pi, (4, 1))
        stroke, speed = (np.sin(phases) / turns).sum(axis=0), np.cos(phases).sum(axis=0)
        size = min(0.5 * (self.high - self.low) / np.abs(stroke).max(), self.fastest / np.abs(speed).max())
        steps = self.random.uniform(self.currents[0], self.currents[-1], 1 + int(5.0 * time_s[-1]))
        current = steps[(5.0 * time_s).astype(np.int64)]
        return np.stack([0.5 * (self.low + self.high) + size * stroke, size * speed, current])

    def piece(self, ticks: int, series: Series | None = None) -> Course | None:
        """Return a piece of a recording from anywhere; None if it has none of this length without a gap."""
        chosen = self.series[int(self.random.integers(len(self.series)))] if series is None else series
        first, stop = chosen.segments[np.diff(chosen.segments)[:, 0].argmax()]
        if stop - first < ticks:
            return None
        at = int(self.random.integers(first, stop - ticks + 1))
        return chosen.inputs[:, at : at + ticks]

    def join(self, past: Course, same: Course) -> Course:
        """Return a past, the way from its end to the beginning of what follows, and that."""
        ticks = max(2, round(JOIN_S * self.rate))
        shares = np.linspace(0.0, 1.0, ticks + 1)[1:]
        way = past[:, -1:] + shares * (same[:, :1] - past[:, -1:])
        way[1] = (same[0, 0] - past[0, -1]) * self.rate / ticks
        return np.concatenate([past, way, same], axis=1)
