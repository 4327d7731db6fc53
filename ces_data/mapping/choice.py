"""The choice among candidates: what was chosen for each signal, why, and what a person should check.

Ratings, what the numbers of pairs say (a damper's force goes with the speed), dampers that differ by a side, and signs.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ces_data.mapping.candidates import Candidate
from ces_data.mapping.rating import (
    OUTWARD,
    Rating,
    UnitGuess,
    find_side,
    find_word,
    guess_unit,
    is_plausible,
    list_words,
    name_sides,
    rate,
    read_meaning,
)
from ces_data.recording import Values


@dataclass(frozen=True)
class Choice:
    """The candidate for a signal: SI value = scale * number + offset, the reasons, and what a person should check."""

    signal: str
    candidate: Candidate
    unit: UnitGuess
    scale: float
    offset: float
    reasons: tuple[str, ...]
    checks: tuple[str, ...]
    others: tuple[Rating, ...]


@dataclass(frozen=True)
class NotFound:
    """A signal without a choice: why, and the candidates that come nearest."""

    signal: str
    reason: str
    others: tuple[Rating, ...]


@dataclass(frozen=True)
class DamperChoice:
    """The choices for one damper."""

    choices: Mapping[str, Choice] = field(default_factory=dict)
    missing: Mapping[str, NotFound] = field(default_factory=dict)


@dataclass(frozen=True)
class Selection:
    """What was chosen: for one damper under the name '', or for several by name, with what they share under ''."""

    dampers: Mapping[str, DamperChoice]
    candidates: tuple[Candidate, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of several dampers, none for one."""
        return tuple(name for name in self.dampers if name)

    @property
    def checks(self) -> tuple[str, ...]:
        """What a person should check before the proposal is used."""
        return tuple(
            f"{signal}: {check}"
            for damper in self.dampers.values()
            for signal, choice in damper.choices.items()
            for check in choice.checks
        )

    @property
    def missing(self) -> tuple[NotFound, ...]:
        """The signals that were not found."""
        return tuple(missing for damper in self.dampers.values() for missing in damper.missing.values())


BIN_S = 0.005
MAX_BINS = 100_000
MIN_COMMON = 50  # bins that both must have; fewer say nothing
EXACT = 0.98  # correlation from which a candidate is another's derivative, if the ratio is that of two units, too
UNIT_RATIOS = (1.0, 1e-3, 1e3, 1e-2, 1e2)
RATIO_TOLERANCE = 0.1


class MotionTable:
    """Candidates, with distinct labels, averaged over time bins."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self._start = min(int(c.stamps_ns.min()) for c in candidates) if candidates else 0
        self._end = max(int(c.stamps_ns.max()) for c in candidates) if candidates else 0
        self._bins: dict[tuple[str, float], Values] = {}

    def correlate(self, stroke: Candidate, other: Candidate) -> tuple[float, float]:
        """Return the correlation (-1 to 1) of `other` with the derivative of `stroke`, and its gain; NaN if unknown."""
        width = self._width(stroke)
        place = self._averages(stroke, width)
        speed = np.full(len(place), np.nan)
        speed[1:-1] = (place[2:] - place[:-2]) / (2.0 * width)
        values = self._averages(other, width)
        both = np.isfinite(speed) & np.isfinite(values)
        if both.sum() < MIN_COMMON:
            return np.nan, np.nan
        s, v = speed[both] - speed[both].mean(), values[both] - values[both].mean()
        power, size = float(s @ s), float(v @ v)
        if power == 0.0 or size == 0.0:
            return np.nan, np.nan
        return float(s @ v) / np.sqrt(power * size), float(s @ v) / power

    def is_derivative(self, stroke: Candidate, other: Candidate) -> bool:
        """Return whether `other` is the speed of `stroke`, up to sign and unit."""
        correlation, gain = self.correlate(stroke, other)
        if not abs(correlation) >= EXACT:
            return False
        if stroke.unit and other.unit:
            return other.unit.quantity == "speed"
        return any(abs(abs(gain) / ratio - 1.0) < RATIO_TOLERANCE for ratio in UNIT_RATIOS)

    def is_same(self, one: Candidate, other: Candidate) -> bool:
        """Return whether two candidates hold the same motion, such as a command and the position that follows it."""
        width = max(self._width(one), self._width(other))
        a, b = self._averages(one, width), self._averages(other, width)
        both = np.isfinite(a) & np.isfinite(b)
        if both.sum() < MIN_COMMON or np.ptp(a[both]) == 0.0 or np.ptp(b[both]) == 0.0:
            return False
        return bool(abs(np.corrcoef(a[both], b[both])[0, 1]) > 0.95)

    def _width(self, candidate: Candidate) -> float:
        """Return the width of the bins [s] for a candidate: 5 ms times a power of two, at least two samples."""
        needed = max(2.0 / candidate.rate_Hz if candidate.rate_Hz else 1.0, (self._end - self._start) / 1e9 / MAX_BINS)
        return float(BIN_S * 2.0 ** max(0.0, np.ceil(np.log2(needed / BIN_S))))

    def _averages(self, candidate: Candidate, width: float) -> Values:
        key = (candidate.label, width)
        if key not in self._bins:
            count = int((self._end - self._start) / (width * 1e9)) + 1
            good = np.isfinite(candidate.values)
            at = ((candidate.stamps_ns[good] - self._start) / (width * 1e9)).astype(np.int64)
            number = np.bincount(at, minlength=count)
            total = np.bincount(at, candidate.values[good], minlength=count)
            self._bins[key] = np.where(number > 0, total / np.maximum(number, 1), np.nan)
        return self._bins[key]


MIN_CORRELATION = 0.3
ASYMMETRY = 1.3  # ratio of the larger to the smaller peak of a force; rebound is damped more than compression
FLIP = "sign turned: "
UNCHECKED = "the sign could not be checked"


def find_signs(found: dict[str, Choice], table: MotionTable) -> dict[str, Choice]:
    """Return the choices with negative scales where the sign is clearly the other one, each with its reason.

    A force that goes against the speed means that position or force is positive in rebound. The position's name
    decides, or else the larger peak of the force, which is that in rebound; without either, the force is turned, and
    that is to be checked.
    """
    position, force = found.get("position"), found.get("force")
    if position is None or force is None:
        return found
    correlation, _ = table.correlate(position.candidate, force.candidate)
    outward = find_word(position.candidate.names, OUTWARD)
    if np.isnan(correlation):
        text = f"{UNCHECKED}: too few samples to compare force and speed"
        return {**found, "force": replace(force, checks=(*force.checks, text))}
    if abs(correlation) < MIN_CORRELATION:
        text = f"{UNCHECKED}: force and speed hardly correlate ({correlation:+.2f})"
        return {**found, "force": replace(force, checks=(*force.checks, text))}
    if outward:
        found = {**found, "position": _turn(position, f"named '{outward}', so positive in rebound")}
    against = (correlation < 0.0) != bool(outward)
    if not against:
        text = f"sign as logged: force goes with the speed ({abs(correlation):+.2f})"
        return {**found, "force": replace(force, reasons=(*force.reasons, text))}
    reason = f"force goes against the speed ({correlation:+.2f}), so one of the two is positive in rebound"
    return {**found, **_turn_one(found["position"], force, reason, bool(outward))}


def _turn_one(position: Choice, force: Choice, reason: str, outward: bool) -> dict[str, Choice]:
    """Return the one that is positive in rebound, turned; the force, to be checked, if that cannot be known."""
    rebound = 1 if outward else _find_rebound(force)
    if rebound < 0:
        more = "the force's larger peak, that in rebound, is negative as it should be"
        return {"position": _turn(position, f"{reason}; {more}")}
    if rebound > 0:
        more = "" if outward else "; the force's larger peak, that in rebound, is positive"
        return {"force": _turn(force, f"{reason}{more}")}
    turned = _turn(force, reason)
    text = (
        "which of the two is positive in rebound cannot be known from the numbers; turn the position instead if it is"
    )
    return {"force": replace(turned, checks=(*turned.checks, text))}


def _turn(choice: Choice, reason: str) -> Choice:
    return replace(choice, scale=-choice.scale, offset=-choice.offset, reasons=(*choice.reasons, f"{FLIP}{reason}"))


def _find_rebound(force: Choice) -> int:
    """Return the sign of the force's clearly larger peak, 0 if neither is."""
    low, high = np.percentile(force.candidate.finite, (1.0, 99.0))
    if not low < 0.0 < high:
        return 0
    return -1 if -low > ASYMMETRY * high else int(high > -ASYMMETRY * low)


MAIN = ("position", "current", "force")
MIN_POINTS, MIN_MARGIN = 3.0, 1.0  # points to be chosen at all, and ahead of the next one
MIN_DAMPING, HIGH_CORRELATION = 0.3, 0.6  # of a force with the speed, in size: counts, and counts more
MAX_STROKES, MAX_FORCES = 12, 40  # candidates that are compared in pairs, the best by name and unit
ALONE = "by its numbers alone, nothing in its name says so"
SI = {"m", "N", "A", "V", "m/s", "m/s2", "degC"}


def choose(candidates: Sequence[Candidate]) -> Selection:
    """Choose candidates for position, current, force and temperature; for each damper if names tell several apart."""
    chooser = _Chooser(candidates)
    sides = chooser.sides()
    if not sides:
        return Selection({"": chooser.choose_damper(candidates)}, tuple(candidates))
    return Selection(dict(_choose_sides(chooser, candidates, sides)), tuple(candidates))


def _choose_sides(
    chooser: _Chooser, candidates: Sequence[Candidate], sides: tuple[str, ...]
) -> Iterator[tuple[str, DamperChoice]]:
    """Yield the signals that all dampers share under '', then the rest of each damper."""
    per_side = {side: chooser.choose_damper(_of_side(candidates, side, sides)) for side in sides}
    first = next(iter(per_side.values()))
    shared = {
        signal
        for signal, choice in first.choices.items()
        if all(
            signal in damper.choices and damper.choices[signal].candidate is choice.candidate
            for damper in per_side.values()
        )
    }
    yield "", DamperChoice({signal: first.choices[signal] for signal in first.choices if signal in shared})
    for side, damper in per_side.items():
        own = {signal: choice for signal, choice in damper.choices.items() if signal not in shared}
        yield (f"damper_{side}" if side[0].isdigit() else side), DamperChoice(own, damper.missing)


def _of_side(candidates: Sequence[Candidate], side: str, sides: tuple[str, ...]) -> list[Candidate]:
    """Return the candidates that belong to this side or to none."""
    others = [set(other.split("_")) - set(side.split("_")) for other in sides if other != side]
    return [c for c in candidates if not any(list_words(c.names) & other for other in others)]


class _Chooser:
    """Rates candidates, each pair of stroke and force once."""

    def __init__(self, candidates: Sequence[Candidate]) -> None:
        self.table = MotionTable(candidates)
        self.candidates = candidates

    def sides(self) -> tuple[str, ...]:
        """Return the sides by which the position's good candidates differ, none for one damper."""
        good = [r.candidate for r in self._strokes(self.candidates) if r.named and r.points >= MIN_POINTS]
        ordered = [candidate for candidate in self.candidates if candidate in good]
        for one in good:
            twins = [c for c in ordered if c is one or find_side(c.names, one.names)]
            if len(twins) > 1:
                return name_sides([c.names for c in twins])
        return ()

    def choose_damper(self, candidates: Sequence[Candidate]) -> DamperChoice:
        """Choose the signals of one damper."""
        found: dict[str, Choice] = {}
        missing: dict[str, NotFound] = {}
        ratings = {"position": self._strokes(candidates)}
        stroke = _pick("position", ratings["position"], self.table)
        pair = stroke.candidate if isinstance(stroke, Choice) else None
        ratings["force"] = self._forces(candidates, pair)
        force = _pick("force", ratings["force"], self.table)
        taken = [choice.candidate for choice in (stroke, force) if isinstance(choice, Choice)]
        current = _pick("current", self._currents(candidates, taken), self.table)
        for signal, result in (("position", stroke), ("current", current), ("force", force)):
            if isinstance(result, Choice):
                found[signal] = result
            else:
                missing[signal] = result
        temperature = _pick("temperature", _rate_all(candidates, "temperature"), self.table)
        if isinstance(temperature, Choice) and not temperature.checks:
            found["temperature"] = temperature
        return DamperChoice(find_signs(found, self.table), missing)

    def _strokes(self, candidates: Sequence[Candidate]) -> list[Rating]:
        """Return the ratings as position, with points for a stroke with which a force goes as a damper's does."""
        ratings = _rate_all(candidates, "position")
        forces = [r.candidate for r in _rate_all(candidates, "force") if not r.excluded][:MAX_FORCES]
        usable = [r for r in ratings if not r.excluded][:MAX_STROKES]
        improved = []
        for rating in usable:
            goes = [(self._damping(rating.candidate, force, rating.named), force.label) for force in forces]
            best, label = max(goes, key=lambda one: abs(one[0]), default=(0.0, ""))
            reason = f"{label} goes with its speed ({best:+.2f})"
            improved.append(rating.add(_points(best), reason) if best else rating)
        return _sort([*improved, *(r for r in ratings if r.excluded or r not in usable)])

    def _damping(self, stroke: Candidate, force: Candidate, named: bool) -> float:
        """Return the correlation of a force with the stroke's speed; 0 if it does not count.

        Without names, both orders of a pair correlate: it counts if the ranges allow this one only.
        """
        possible = is_plausible(stroke, "position") and is_plausible(force, "force")
        only = possible and not (is_plausible(force, "position") and is_plausible(stroke, "force"))
        if stroke is force or not (named or only):
            return 0.0
        correlation, _ = self.table.correlate(stroke, force)
        if not abs(correlation) >= MIN_DAMPING or self.table.is_derivative(stroke, force):
            return 0.0
        return correlation

    def _forces(self, candidates: Sequence[Candidate], stroke: Candidate | None) -> list[Rating]:
        """Return the ratings as force, with what the chosen position says."""
        ratings = [r for r in _rate_all(candidates, "force") if r.candidate is not stroke]
        if stroke is None:
            return ratings
        improved = []
        for rating in ratings:
            correlation = 0.0 if rating.excluded else self._damping(stroke, rating.candidate, rating.named)
            if not rating.excluded and self.table.is_derivative(stroke, rating.candidate):
                improved.append(rating.add(-5.0, f"is the speed of {stroke.label}"))
            elif correlation:
                reason = f"goes with the speed of {stroke.label} ({correlation:+.2f})"
                improved.append(rating.add(_points(correlation), reason))
            else:
                improved.append(rating)
        return _sort(improved)

    def _currents(self, candidates: Sequence[Candidate], taken: Sequence[Candidate]) -> list[Rating]:
        """Return the ratings as current; one without a name counts only if it is the only one that can be."""
        ratings = [r for r in _rate_all(candidates, "current") if r.candidate not in taken]
        if any(r.named and r.points >= MIN_POINTS for r in ratings):
            return ratings
        silent = [r for r in ratings if not r.excluded and not r.named and r.points > 0.0 and not r.against]
        if len(silent) != 1 or read_meaning(silent[0].candidate.names).quantity or silent[0].candidate.constant:
            return ratings
        return _sort([silent[0].add(MIN_POINTS - silent[0].points, ALONE), *(r for r in ratings if r != silent[0])])


def _rate_all(candidates: Sequence[Candidate], signal: str) -> list[Rating]:
    return _sort([rate(candidate, signal) for candidate in candidates])


def _sort(ratings: Sequence[Rating]) -> list[Rating]:
    """Return the ratings, the best first, those that are excluded last."""
    return sorted(ratings, key=lambda r: (bool(r.excluded), -r.points))


def _points(correlation: float) -> float:
    return 3.0 if abs(correlation) >= HIGH_CORRELATION else 2.0


def _pick(signal: str, ratings: Sequence[Rating], table: MotionTable) -> Choice | NotFound:
    """Return the choice, or why there is none."""
    good = [r for r in ratings if not r.excluded and r.points >= MIN_POINTS]
    others = tuple(r for r in ratings if not r.excluded and (r.points > 0.0 or r.against))
    if not good:
        named = (r for r in ratings if r.excluded and read_meaning(r.candidate.names).quantity == r.signal)
        reason = "nothing is named like it or has its unit, and moves like it"
        if excluded := next(named, None):
            reason = f"'{excluded.candidate.label}' is named like it, but {excluded.excluded}"
        return NotFound(signal, reason, others or tuple(ratings))
    best, *rest = good
    alternatives = [r for r in rest if best.points - r.points < MIN_MARGIN]
    same = bool(alternatives) and all(table.is_same(best.candidate, r.candidate) for r in alternatives)
    if alternatives and not same:
        labels = ", ".join(r.candidate.label for r in (best, *alternatives))
        return NotFound(signal, f"{1 + len(alternatives)} candidates are equally good: {labels}", (best, *alternatives))
    twins = [f"the same motion as {r.candidate.label}: take the one that is measured" for r in alternatives]
    return _make_choice(best, tuple(r for r in others if r is not best), twins)


def _make_choice(rating: Rating, others: tuple[Rating, ...], checks: Sequence[str]) -> Choice:
    guess = guess_unit(rating.candidate, rating.signal)
    unit, usual = guess.unit, guess.unit is not None and guess.unit.text in SI
    doubts = [*checks, *rating.against]
    if unit is None or not (guess.stated or usual):
        doubts.append(guess.text)
    if not rating.named or ALONE in rating.reasons:
        doubts.append(ALONE)
    scale, offset = (unit.scale, unit.offset) if unit else (1.0, 0.0)
    reasons = [reason for reason in rating.reasons if reason != ALONE]
    reasons += [guess.text] if usual and not guess.stated else []
    return Choice(rating.signal, rating.candidate, guess, scale, offset, tuple(reasons), tuple(doubts), others)
