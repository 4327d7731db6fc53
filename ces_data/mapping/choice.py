"""The choice among candidates: what was chosen for each signal, why, and what a person should check.

Ratings, what the numbers of pairs say (a damper's force goes with the speed), dampers that differ by a side, and signs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ces_data.limits import RatingLimits, StatisticLimits
from ces_data.mapping.pairs import MotionTable
from ces_data.mapping.rating import (
    OR,
    OUTWARD,
    Candidate,
    Rating,
    find_side,
    find_speed_unit,
    find_word,
    guess_unit,
    is_plausible,
    join_words,
    name_sides,
    rate,
    read_meaning,
)
from ces_data.units import IMPERIAL, Unit, ask_for_amperes


@dataclass(frozen=True)
class Choice:
    """The candidate for a signal: SI value = scale * number + offset, the reasons, and what a person should check.

    `guesses` are to be checked, too, but are taken with a warning: what nothing confirms and nothing contradicts.
    """

    signal: str
    candidate: Candidate
    unit: Unit | None
    scale: float
    offset: float
    reasons: tuple[str, ...]
    checks: tuple[str, ...]
    others: tuple[Rating, ...]
    guesses: tuple[str, ...] = ()

    @property
    def to_check(self) -> tuple[str, ...]:
        """All that a person should check."""
        return (*self.checks, *self.guesses)


@dataclass(frozen=True)
class NotFound:
    """A signal without a choice: why, the candidates that come nearest, and the label of one that may be it."""

    signal: str
    reason: str
    others: tuple[Rating, ...]
    label: str = ""


@dataclass(frozen=True)
class DamperChoice:
    """The choices for one damper."""

    choices: Mapping[str, Choice] = field(default_factory=dict)
    missing: Mapping[str, NotFound] = field(default_factory=dict)


@dataclass(frozen=True)
class Selection:
    """What was chosen: for one damper under the name '', or for several by name, with what they share under ''."""

    dampers: Mapping[str, DamperChoice]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of several dampers, none for one."""
        return tuple(name for name in self.dampers if name)

    def with_reasons(self, reasons: Mapping[str, str]) -> Selection:
        """Return the selection with these reasons, by signal, why a signal was not found."""
        dampers = {
            name: replace(
                damper, missing={s: replace(m, reason=reasons.get(s, m.reason)) for s, m in damper.missing.items()}
            )
            for name, damper in self.dampers.items()
        }
        return Selection(dampers)

    @property
    def checks(self) -> tuple[str, ...]:
        """What a person should check before the proposal is used."""
        choices = [choice for damper in self.dampers.values() for choice in damper.choices.values()]
        return tuple(f"{choice.signal}: {check}" for choice in choices for check in choice.to_check)

    @property
    def missing(self) -> tuple[NotFound, ...]:
        """The signals that were not found."""
        return tuple(missing for damper in self.dampers.values() for missing in damper.missing.values())


MAX_STROKES, MAX_FORCES = 12, 40  # candidates that are compared in pairs, the best by name and unit
ALONE = "by its numbers alone, nothing in its name says so"
NO_STROKE = "an acceleration alone gives no stroke, as its offset grows without end; record the position, or a speed"
PASSIVE = "a passive damper needs 'current: {constant: 0.0}' only"
UNCHECKED = "the sign could not be checked"
OPPOSITE = "force and position have opposite signs; one of them is positive in rebound"
SI = {"m", "N", "A", "V", "m/s", "m/s2", "degC"}


def choose(candidates: Sequence[Candidate], *, integrates: bool = False) -> Selection:
    """Choose the signals of each damper, under its side; what all share is under ''.

    They are position, current and force, and a temperature and a speed that are certain. If the reader `integrates`, a
    speed that is named so takes the place of a position that is not there.
    """
    chooser = _Chooser(candidates, integrates)
    sides = chooser.sides()
    if not sides:
        return Selection({"": chooser.choose_damper(candidates)})
    per_side = {}
    for side in sides:
        others = [set(other.split("_")) - set(side.split("_")) for other in sides if other != side]
        mine = [c for c in candidates if not any(other.intersection(join_words(c.names)) for other in others)]
        per_side[side] = chooser.choose_damper(mine)
    first, *rest = (damper.choices for damper in per_side.values())
    shared = {
        signal: choice
        for signal, choice in first.items()
        if all(signal in other and other[signal].candidate is choice.candidate for other in rest)
    }
    dampers = {"": DamperChoice(shared)}
    for side, damper in per_side.items():
        own = {signal: choice for signal, choice in damper.choices.items() if signal not in shared}
        dampers[f"damper_{side}" if side[0].isdigit() else side] = DamperChoice(own, damper.missing)
    return Selection(dampers)


class _Chooser:
    """Rates candidates, each pair of stroke and force once."""

    def __init__(self, candidates: Sequence[Candidate], integrates: bool) -> None:
        self.table = MotionTable(candidates)
        self.candidates, self.integrates = candidates, integrates

    def sides(self) -> tuple[str, ...]:
        """Return the sides by which the position's good candidates differ, none for one damper."""
        good = [r.candidate for r in self._strokes(self.candidates) if r.named and r.points >= RatingLimits.CERTAIN]
        ordered = [candidate for candidate in self.candidates if candidate in good]
        for stroke in good:
            twins = [c for c in ordered if c is stroke or find_side(c.names, stroke.names)]
            if len(twins) > 1:
                return name_sides([c.names for c in twins])
        return ()

    def choose_damper(self, candidates: Sequence[Candidate]) -> DamperChoice:
        """Choose the signals of one damper."""
        stroke = _pick("position", self._strokes(candidates), self.table)
        forces = self._forces(candidates, stroke.candidate if isinstance(stroke, Choice) else None)
        force = _pick("force", forces, self.table)
        taken = [choice.candidate for choice in (stroke, force) if isinstance(choice, Choice)]
        current = self._pick_current(candidates, taken)
        results = {"position": stroke, "current": current, "force": force}
        choices = {signal: result for signal, result in results.items() if isinstance(result, Choice)}
        missing = {signal: result for signal, result in results.items() if isinstance(result, NotFound)}
        speeds = self._speeds([c for c in candidates if c not in taken], stroke if isinstance(stroke, Choice) else None)
        for signal, ratings in (("temperature", _rate_all(candidates, "temperature")), ("speed", speeds)):
            choice = _pick(signal, ratings, self.table)
            if isinstance(choice, Choice) and (not choice.checks or (signal == "speed" and "position" not in choices)):
                choices[signal] = choice
        if "speed" in choices:
            missing.pop("position", None)
        return DamperChoice(_doubt_systems(_find_signs(choices, self.table)), missing)

    def _speeds(self, candidates: Sequence[Candidate], position: Choice | None) -> list[Rating]:
        """Return the ratings as speed, of those that go to and fro: beside a position, of its derivatives."""
        ratings = _rate_all([c for c in candidates if c.low < 0.0 < c.high], "speed")
        if position is None:
            return [rating for rating in ratings if rating.named and self.integrates]
        derived = []
        for rating in (r for r in ratings if not r.excluded):
            correlation, gain = self.table.correlate(position.candidate, rating.candidate)
            least = (
                RatingLimits.LATE_SPEED
                if read_meaning(rating.candidate.names).quantity == "speed"
                else RatingLimits.EXACT
            )
            if not abs(correlation) >= least:
                continue
            if unit := rating.candidate.unit or find_speed_unit(abs(position.scale / gain)):
                with_unit = replace(rating, candidate=replace(rating.candidate, unit=unit), named=True)
                reason = f"goes as the differentiated {position.candidate.label} ({correlation:+.2f})"
                derived.append(with_unit.add(RatingLimits.CERTAIN, reason))
        return _sort(derived)

    def _strokes(self, candidates: Sequence[Candidate]) -> list[Rating]:
        """Return the ratings as position, with points for a stroke with which a force goes as a damper's does."""
        ratings = _rate_all(candidates, "position")
        forces = [r.candidate for r in _rate_all(candidates, "force") if not r.excluded][:MAX_FORCES]
        usable = [r for r in ratings if not r.excluded][:MAX_STROKES]
        improved = []
        for rating in usable:
            goes = [(self._damping(rating.candidate, force, rating.named), force.label) for force in forces]
            best, label = max(goes, key=lambda pair: abs(pair[0]), default=(0.0, ""))
            improved.append(_add_damping(rating, best, f"{label} goes with its speed"))
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
        if not abs(correlation) >= StatisticLimits.DAMPING or self.table.is_derivative(stroke, force):
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
                improved.append(rating.add(-RatingLimits.CONTRARY, f"is the speed of {stroke.label}"))
            else:
                improved.append(_add_damping(rating, correlation, f"goes with the speed of {stroke.label}"))
        return _sort(improved)

    def _pick_current(self, candidates: Sequence[Candidate], taken: Sequence[Candidate]) -> Choice | NotFound:
        """Return the choice of the current; a voltage takes its place only where no current was recorded."""
        plain = [c for c in candidates if c.unit is None or c.unit.quantity != "voltage"]
        choice = _pick("current", self._currents(plain, taken), self.table)
        if len(plain) == len(candidates) or (isinstance(choice, Choice) and ALONE not in choice.checks):
            return choice
        return _pick("current", self._currents(candidates, taken), self.table)

    def _currents(self, candidates: Sequence[Candidate], taken: Sequence[Candidate]) -> list[Rating]:
        """Return the ratings as current; one without a name counts only if it is the only one that can be."""
        ratings = [self._exclude_force(r, taken) for r in _rate_all(candidates, "current") if r.candidate not in taken]
        if any(r.named and r.points >= RatingLimits.CERTAIN for r in ratings):
            return ratings
        silent = [r for r in ratings if not r.excluded and not r.named and r.points > 0.0 and not r.against]
        if len(silent) != 1 or read_meaning(silent[0].candidate.names).quantity or silent[0].candidate.constant:
            return _sort(ratings)
        return _sort(
            [silent[0].add(RatingLimits.CERTAIN - silent[0].points, ALONE), *(r for r in ratings if r != silent[0])]
        )

    def _exclude_force(self, rating: Rating, taken: Sequence[Candidate]) -> Rating:
        """Return the rating as current, excluded if nothing names it so and it goes with the stroke's speed."""
        if rating.excluded or rating.named:
            return rating
        for stroke in taken[:1]:
            correlation, _ = self.table.correlate(stroke, rating.candidate)
            if abs(correlation) >= RatingLimits.CLEAR_CORRELATION:
                return replace(rating, excluded=f"goes with the speed of {stroke.label} ({correlation:+.2f}): a force")
        return rating


def _add_damping(rating: Rating, correlation: float, reason: str) -> Rating:
    is_clear = abs(correlation) >= RatingLimits.CLEAR_CORRELATION
    points = RatingLimits.CERTAIN if is_clear else RatingLimits.LIKELY
    return rating.add(points, f"{reason} ({correlation:+.2f})") if correlation else rating


def _rate_all(candidates: Sequence[Candidate], signal: str) -> list[Rating]:
    return _sort([rate(candidate, signal) for candidate in candidates])


def _sort(ratings: Sequence[Rating]) -> list[Rating]:
    """Return the ratings, the best first, those that are excluded last."""
    return sorted(ratings, key=lambda r: (bool(r.excluded), -r.points))


def _pick(signal: str, ratings: Sequence[Rating], table: MotionTable) -> Choice | NotFound:
    """Return the choice, or why there is none."""
    good = [r for r in ratings if not r.excluded and r.points >= RatingLimits.CERTAIN]
    others = tuple(r for r in ratings if not r.excluded and (r.points > 0.0 or r.against))
    if not good:
        named = (r for r in ratings if r.excluded and read_meaning(r.candidate.names).quantity == r.signal)
        label = ""
        reason = "nothing is named like it or has its unit, and moves like it"
        reason += f"; {PASSIVE}" if signal == "current" else ""
        if signal == "position" and any(read_meaning(r.candidate.names).quantity == "acceleration" for r in ratings):
            reason = NO_STROKE
        if excluded := next(named, None):
            label = excluded.candidate.label
            reason = f"'{label}' is named like it, but {excluded.excluded}"
        elif others and others[0].named:
            label = others[0].candidate.label
            reason = f"'{label}' may be it, but that is not certain: {others[0].why}"
        return NotFound(signal, reason, others or tuple(ratings), label)
    best, *others_alike = good
    equal = [r for r in others_alike if best.points - r.points < RatingLimits.SLIGHT]
    if equal and not all(table.is_same(best.candidate, r.candidate) for r in equal):
        labels = ", ".join(r.candidate.label for r in (best, *equal))
        return NotFound(signal, f"{1 + len(equal)} candidates are equally good: {labels}", (best, *equal))
    twins = [f"the same motion as {r.candidate.label}: take the one that is measured" for r in equal]
    return _make_choice(best, tuple(r for r in others if r is not best), twins)


def _make_choice(rating: Rating, others: tuple[Rating, ...], checks: Sequence[str]) -> Choice:
    unit, text = guess_unit(rating.candidate, rating.signal)
    stated, usual = rating.candidate.unit is not None, unit is not None and unit.text in SI
    guessed = usual and not stated and not rating.candidate.kind and OR in text  # messages of ROS are in SI units
    doubts = [*checks, *([text] if unit is None or not (stated or usual) else []), *rating.against]
    if unit is not None and unit.quantity == "voltage":
        doubts.append(f"its unit is {unit.text}, {ask_for_amperes(unit)}")
    if contrary := rating.candidate.contrary:
        doubts.append(f"its name says {contrary}, and the file states {unit.text if unit else 'another unit'}")
    if not rating.named or ALONE in rating.reasons:
        doubts.append(ALONE)
    scale, offset = (unit.scale, unit.offset) if unit else (1.0, 0.0)
    reasons = [reason for reason in rating.reasons if reason != ALONE]
    reasons += [text] if usual and not stated else []
    guesses = (f"no unit is stated; {text}",) if guessed else ()
    return Choice(rating.signal, rating.candidate, unit, scale, offset, tuple(reasons), tuple(doubts), others, guesses)


def _doubt_systems(choices: dict[str, Choice]) -> dict[str, Choice]:
    """Return the choices with a guess where a log states inches or pounds for one of stroke and force alone."""
    units = {s: c.candidate.unit for s, c in choices.items() if s in ("position", "force") and c.candidate.unit}
    odd = [signal for signal, unit in units.items() if unit.text in IMPERIAL]
    if len(units) != 2 or len(odd) != 1:
        return choices
    (signal,), (other,) = odd, units.keys() - odd
    guess = f"stated in {units[signal].text}, the {other} in {units[other].text}: is that so?"
    return {**choices, signal: replace(choices[signal], guesses=(*choices[signal].guesses, guess))}


def _find_signs(choices: dict[str, Choice], table: MotionTable) -> dict[str, Choice]:
    """Return the choices with their signs; a speed beside a position has that of its derivative."""
    signed = _find_sign_of_force(choices, table, "position" if "position" in choices else "speed")
    position, speed = signed.get("position"), signed.get("speed")
    if position is not None and speed is not None:
        correlation, _ = table.correlate(position.candidate, speed.candidate)
        if correlation * position.scale < 0.0:
            signed["speed"] = _turn(speed, "the differentiated position has the other one")
    return signed


def _find_sign_of_force(choices: dict[str, Choice], table: MotionTable, motion: str) -> dict[str, Choice]:
    """Return the choices with negative scales where the sign is clearly the other one, each with its reason.

    A force that goes against the speed means that the position (or speed: `motion`) or the force is positive in
    rebound. The position's name decides, or else the larger peak of the force, which is that in rebound; without
    either, the force is turned, and that is to be checked.
    """
    position, force = choices.get(motion), choices.get("force")
    if position is None or force is None:
        return choices
    compare = table.correlate if motion == "position" else table.correlate_values
    correlation, _ = compare(position.candidate, force.candidate)
    if not abs(correlation) >= StatisticLimits.DAMPING:
        unknown = "too few samples to compare force and speed"
        text = unknown if np.isnan(correlation) else f"force and speed hardly correlate ({correlation:+.2f})"
        guess = f"{UNCHECKED}: {text}; taken as logged"
        return {**choices, "force": replace(force, guesses=(*force.guesses, guess))}
    outward = find_word(position.candidate.names, OUTWARD)
    low, high = np.percentile(force.candidate.finite, (1.0, 99.0))  # the larger peak, if it is clearly larger
    negative, positive = (
        low < 0.0 < high and -low > RatingLimits.ASYMMETRY * high,
        low < 0.0 < high and high > -RatingLimits.ASYMMETRY * low,
    )
    reason = f"{OPPOSITE.replace('position', motion)} ({correlation:+.2f})"
    if outward:
        position = _turn(position, f"named '{outward}', so positive in rebound")
    if (correlation < 0.0) == bool(outward):
        text = f"sign as logged: force goes with the speed ({abs(correlation):+.2f})"
        force = replace(force, reasons=(*force.reasons, text))
    elif outward:
        force = _turn(force, reason)
    elif negative:
        text = "the force's larger peak, that in rebound, is negative as it should be"
        position = _turn(position, f"{reason}; {text}")
    elif positive:
        force = _turn(force, f"{reason}; the force's larger peak, that in rebound, is positive")
    else:
        guess = f"{reason}, and the numbers do not show which: the force is turned; if it is the {motion}, turn that"
        force = _turn(replace(force, guesses=(*force.guesses, guess)), reason)
    return {**choices, motion: position, "force": force}


def _turn(choice: Choice, reason: str) -> Choice:
    reasons = (*choice.reasons, f"sign turned: {reason}")
    return replace(choice, scale=-choice.scale, offset=-choice.offset, reasons=reasons)
