"""A candidate: one series of numbers in a bag or log that may be a signal, and what speaks for it as each signal.

That is the words of its name, its unit, and the range of its numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import compress

import numpy as np

from ces_data.findings import rate_between_pauses
from ces_data.limits import RatingLimits
from ces_data.recording import Stamps, Values
from ces_data.samples import is_rough
from ces_data.units import QUANTITIES, Unit, find_unit
from ces_observer.signals import UNITS


@dataclass(frozen=True, eq=False)
class Candidate:
    """One series: `stamps_ns` int64 and `values` float64, both (n,), with at least one finite value.

    `label` names it for people. `names` are the texts whose words say what it is, the most specific first: the field's
    and the topic's, or the column's alone. `kind` is the message type, empty in a log. `unit` is the stated one, and
    `stated` says where, or which unit no signal has. One that is not `timed` has its row's number [ms] for a stamp.
    """

    label: str
    names: tuple[str, ...]
    stamps_ns: Stamps
    values: Values
    kind: str = ""
    topic: str = ""
    field: str = ""
    unit: Unit | None = None
    stated: str = ""
    timed: bool = True
    contrary: str = ""  # the unit in its name, if the file states another

    @cached_property
    def finite(self) -> Values:
        """The finite values."""
        there = np.isfinite(self.values)
        return self.values if there.all() else np.asarray(self.values[there])

    @cached_property
    def span(self) -> float:
        """Distance from the 1st to the 99th percentile, which ignores outliers."""
        low, high = np.percentile(self.finite, (1.0, 99.0))
        return float(high - low)

    @cached_property
    def peak(self) -> float:
        """99th percentile of the magnitude."""
        return float(np.percentile(np.abs(self.finite), 99.0))

    @property
    def low(self) -> float:
        """Smallest finite value."""
        return float(self.finite.min())

    @property
    def high(self) -> float:
        """Largest finite value."""
        return float(self.finite.max())

    @property
    def constant(self) -> bool:
        """True if all finite values are equal."""
        return self.low == self.high

    @cached_property
    def counts_up(self) -> bool:
        """True for a time or a counter: every step goes up by about as much."""
        steps = np.diff(self.finite)
        return bool(len(steps) > 2 and (steps > 0.0).all() and steps.max() < 100.0 * np.median(steps))

    @cached_property
    def held(self) -> bool:
        """True if the number changes in steps and is held between them."""
        steps = np.diff(self.finite)
        return bool(not self.constant and (steps == 0.0).mean() > RatingLimits.STEADY_SHARE)

    @cached_property
    def rough(self) -> bool:
        """True if the samples jump about like noise instead of moving like a stroke."""
        return is_rough(self.finite)

    @property
    def rests(self) -> bool:
        """True if its unit is stated, and it moves less than any stroke does."""
        unit, low = self.unit, RatingLimits.RANGES["position"][0]
        return unit is not None and unit.quantity == "length" and self.span * unit.scale < low

    @property
    def range_text(self) -> str:
        """Range and rate for people; a table without a time has no rate."""
        return f"{self.low:.4g} to {self.high:.4g}" + (f", {self.rate_Hz:.4g} Hz" if self.timed else "")

    @cached_property
    def rate_Hz(self) -> float:
        """Mean rate between pauses; 0 if the span of the stamps is empty."""
        return rate_between_pauses(self.stamps_ns)


STRONG = {
    "position": "position displacement stroke travel lvdt deflection weg hub elongation extension potentiometer "
    "linearpot verschiebung déplacement deplacement desplazamiento spostamento deslocamento verplaatsing",
    "current": "current currents amp amps ampere amperes curr strom solenoid coil courant corriente corrente stroom",
    "force": "force forces load loadcell kraft effort fuerza forza força kracht",
    "temperature": "temperature temp temperatur",
    "speed": "velocity speed vel geschwindigkeit vitesse velocidad velocità",
    "acceleration": "acceleration acc accel beschleunigung",
    "time": "time timestamp stamp zeit seconds t tout millis millisec msec micros microsec usec tiempo tijd zaman czas "
    "tempo laptime systime uptime 时间 時間 시간 время",
}
WEAK = {
    "position": "pos disp x dx xd d s z pot piston",
    "current": "i ia iv valve cur",
    "force": "f fz fx fd cell tension preload thrust",
    "temperature": "oil thermocouple",
    "speed": "v vz dv dx_dt xdot",
    "acceleration": "a az",
    "time": "sec s ts clock elapsed abtast temps tid epoch tick ticks interval utc",
}


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


COMMANDS = _words(
    "cmd command commanded commands setpoint set sp target desired wanted ref reference soll demand request goal"
)
COMMAND_PARTS = ("cmd", "command", "soll", "setpoint", "target")  # also at an end of a word: `xcmd`
COMPUTED = _words("estimate estimated estimator sim simulated simulation predicted model observer band")
FOREIGN = _words(
    "battery torque moment pressure gps latitude longitude altitude covariance fuel orientation quaternion angular "
    "gyro imu magnetic wheel steering engine rpm odom odometry pose twist brake throttle gear counter sequence error "
    "status yaw roll pitch humidity variance"
)
DEVICE = _words("damper shock strut suspension fork piston absorber daempfer dämpfer stossdämpfer")
OUTWARD = _words("extension elongation rebound zug ausfederung extended")
SIDES = _words(
    "front rear left right fl fr rl rr lf rf lr f r l fore aft vorne vorn hinten links rechts vl vr hl hr a b"
)
WORD = re.compile(r"[A-Z]+(?![a-zäöü])|[A-ZÄÖÜ]?[a-zäöü]+|\d+|[^\W\d_a-zA-ZÄÖÜäöü]+")


@dataclass(frozen=True)
class NameMeaning:
    """The quantity that a name says, '' if none, how strongly (0 to 3), and the word that says it."""

    quantity: str
    weight: float
    word: str


def split_words(text: str) -> tuple[str, ...]:
    """Return the words of a name in lower case, split at underscores, digits and capitals."""
    return tuple(word.casefold() for word in WORD.findall(text))


def join_words(names: Sequence[str]) -> tuple[str, ...]:
    """Return the words of all names."""
    return tuple(word for name in names for word in split_words(name))


def read_meaning(names: Sequence[str]) -> NameMeaning:
    """Return what the names say, the most specific first: strong words before weak ones, in a name the last first."""
    for table, weight in ((STRONG, RatingLimits.CERTAIN), (WEAK, RatingLimits.WEAK)):
        for word in (word for name in names for word in reversed(split_words(name))):
            for quantity, texts in table.items():
                if word in texts.split():
                    return NameMeaning(quantity, weight, word)
    return NameMeaning("", 0.0, "")


def find_word(names: Sequence[str], words: frozenset[str], ends: tuple[str, ...] = ()) -> str:
    """Return the first word of the names that is one of `words` or begins or ends with one of `ends`, else ''."""
    matches = (w for w in join_words(names) if w in words or (ends and (w.startswith(ends) or w.endswith(ends))))
    return next(matches, "")


def find_side(names: Sequence[str], others: Sequence[str]) -> str:
    """Return the words by which two names of the same form differ if they are all sides or numbers, else ''.

    `/front/damper/stroke` beside `/rear/damper/stroke` is `front`, `damper_1` beside `damper_2` is `1`.
    """
    mine, theirs = join_words(names), join_words(others)
    if len(mine) != len(theirs):
        return ""
    different = [(word_here, other) for word_here, other in zip(mine, theirs, strict=True) if word_here != other]
    if not all(word in SIDES or word.isdigit() for pair in different for word in pair):
        return ""
    return "_".join(dict.fromkeys(word_here for word_here, _ in different))


def name_sides(group: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return the words by which dampers' names of one form differ, such as `front_left` and `rear_left`."""
    words = [join_words(names) for names in group]
    different = [len(set(column)) > 1 for column in zip(*words, strict=True)]
    return tuple("_".join(dict.fromkeys(compress(mine, different))) for mine in words)


USUAL = {  # units to try where none is stated, the likeliest first
    "position": ("m", "mm", "cm", "in"),
    "force": ("N", "kN", "lbf", "kip"),
    "current": ("A", "mA"),
    "speed": ("m/s", "mm/s", "cm/s", "in/s"),
    "acceleration": ("m/s2", "g"),
    "temperature": ("degC", "K"),
}
GUESSED = "taken as "  # before the unit that is likeliest by its range
OR = "or in "  # before units that a guess leaves open


def guess_unit(candidate: Candidate, signal: str) -> tuple[Unit | None, str]:
    """Return the unit of a candidate if it is this signal, stated or likeliest by its range (None: none), and why."""
    if candidate.unit is not None:
        return candidate.unit, f"unit {candidate.unit.text} {candidate.stated}".strip()
    usual = USUAL[signal]
    if candidate.stated:
        return None, f"its unit is stated as '{candidate.stated}', which is not one of a {signal}; give its scale"
    number, what = (candidate.span, "span") if signal == "position" else (candidate.peak, "peak")
    if candidate.constant and candidate.high == 0.0:
        return find_unit(usual[0]), f"always 0, so any unit; taken as {usual[0]}"
    allowed = [name for name in usual if _allows(name, signal, candidate)]
    if not allowed:
        low, high = RatingLimits.RANGES[signal]
        text = f"its unit is not known: a {what} of {number:.4g} is implausible in {', '.join(usual)}"
        return None, f"{text} (expected {low:g} to {high:g} in SI units)"
    chosen, *others = allowed
    text = f"{GUESSED}{chosen}, because its {what} of {number:.4g} is plausible in {chosen}"
    excluded = usual[: usual.index(chosen)]
    text += f" and not in {', '.join(excluded)}" if excluded else ""
    text += f" ({OR}{' or '.join(others)}, which would be plausible, too)" if others else ""
    return find_unit(chosen), text


def find_speed_unit(factor: float) -> Unit | None:
    """Return the unit of a speed with this factor to SI, None if there is none."""
    units = filter(None, map(find_unit, USUAL["speed"]))
    return next((unit for unit in units if abs(factor / unit.scale - 1.0) < RatingLimits.UNIT_TOLERANCE), None)


def is_plausible(candidate: Candidate, signal: str) -> bool:
    """Return whether the candidate's range makes sense for this signal in its stated or any usual unit."""
    if candidate.unit is not None:
        return candidate.unit.quantity in QUANTITIES[signal]
    return any(_allows(name, signal, candidate) for name in USUAL[signal])


def _allows(name: str, signal: str, candidate: Candidate) -> bool:
    unit, (low, high) = find_unit(name), RatingLimits.RANGES[signal]
    number = candidate.span if signal == "position" else candidate.peak
    return unit is not None and low <= unit.scale * number + unit.offset <= high


@dataclass(frozen=True)
class Rating:
    """A candidate as one signal: its points, the reasons for it and against it; `excluded` says why it cannot be."""

    candidate: Candidate
    signal: str
    points: float
    reasons: tuple[str, ...]
    against: tuple[str, ...] = ()
    excluded: str = ""
    named: bool = False

    def add(self, points: float, reason: str) -> Rating:
        """Return the rating with further points for, or against if negative."""
        if points >= 0.0:
            return replace(self, points=self.points + points, reasons=(*self.reasons, reason))
        return replace(self, points=self.points + points, against=(*self.against, reason))

    @property
    def why(self) -> str:
        """What speaks against the candidate, or else for it."""
        return self.excluded or "; ".join(self.against or self.reasons) or "nothing in its name or unit says so"


def rate(candidate: Candidate, signal: str) -> Rating:
    """Return the rating of a candidate by name, unit and range alone."""
    excluded = _exclusion(candidate, signal)
    if excluded:
        return Rating(candidate, signal, 0.0, (), excluded=excluded)
    meaning = read_meaning(candidate.names)
    mine = meaning.quantity == signal
    rating = Rating(candidate, signal, 0.0, (), named=mine or candidate.unit is not None)
    if mine:
        rating = rating.add(meaning.weight, f"named '{meaning.word}'")
    if candidate.unit is not None:
        rating = rating.add(RatingLimits.CERTAIN, f"unit {candidate.unit.text} {candidate.stated}".rstrip())
    for points, reason in _remarks(candidate, signal):
        rating = rating.add(points, reason)
    if signal == "current" and candidate.constant:
        points, reason = rating.points - RatingLimits.SLIGHT, f"constant at {candidate.high:g}"
        if rating.named:  # no reason against what is named so, but another is preferred
            return replace(rating, points=points, reasons=(*rating.reasons, reason))
        return replace(rating, points=points, against=(*rating.against, reason))
    return rating


def _exclusion(candidate: Candidate, signal: str) -> str:
    """Return why the candidate cannot be the signal, '' if it can."""
    unit, meaning = candidate.unit, read_meaning(candidate.names)
    if unit is not None and unit.quantity not in QUANTITIES[signal]:
        return f"its unit {unit.text} is not one of a {signal} [{UNITS[signal]}]"
    if meaning.quantity not in ("", signal) and (unit is None or meaning.weight > RatingLimits.WEAK):
        return f"named '{meaning.word}': a {meaning.quantity}"
    if candidate.counts_up and unit is None and meaning.quantity != signal:
        return "only counts up: a time or a counter"
    if candidate.constant and signal in ("position", "force"):
        return f"constant at {candidate.high:g}"
    if signal == "position" and candidate.rough and not (candidate.rests and meaning.quantity == signal):
        rest = f", or rests: a span of {candidate.span:.3g} without a unit cannot tell" if unit is None else ""
        return f"jumps like noise from sample to sample, at {candidate.rate_Hz:.4g} Hz; a stroke moves smoothly{rest}"
    return ""


def _remarks(candidate: Candidate, signal: str) -> Iterator[tuple[float, str]]:
    """Yield points and reason of what else the name and the numbers say."""
    if (word := find_word(candidate.names, DEVICE)) and read_meaning(candidate.names).quantity == signal:
        yield RatingLimits.SLIGHT, f"of a '{word}'"
    if word := find_word(candidate.names, COMMANDS, COMMAND_PARTS):
        yield -RatingLimits.CERTAIN, f"a command by its name ('{word}'), not a measurement"
    if word := find_word(candidate.names, COMPUTED):
        yield -RatingLimits.CONTRARY, f"computed by its name ('{word}'), not measured"
    if word := find_word(candidate.names, FOREIGN):
        yield -RatingLimits.CONTRARY, f"'{word}' in its name"
    if not candidate.constant and not is_plausible(candidate, signal):
        yield -RatingLimits.SLIGHT, f"range {candidate.low:.4g} to {candidate.high:.4g} is implausible for a {signal}"
    if signal == "current" and candidate.low < -RatingLimits.NEGATIVE_SHARE * candidate.peak:
        yield -RatingLimits.LIKELY, f"goes below zero, to {candidate.low:.4g}"
    elif signal == "current":
        yield RatingLimits.SLIGHT, "never negative"
    if signal == "current" and candidate.held:
        yield RatingLimits.SLIGHT, "held between steps"
