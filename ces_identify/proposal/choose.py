"""The choice among candidates: ratings, what the numbers of pairs say, dampers that differ by a side, and ties."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ces_identify.proposal.candidate import Candidate
from ces_identify.proposal.choice import Choice, DamperChoice, NotFound, Selection
from ces_identify.proposal.motion import MotionTable
from ces_identify.proposal.plausible import UnitGuess, guess_unit, is_plausible
from ces_identify.proposal.rating import Rating, rate
from ces_identify.proposal.sign import find_signs
from ces_identify.proposal.words import find_side, list_words, name_sides, read_meaning

MAIN = ("position", "current", "force")
MIN_POINTS, MIN_MARGIN = 3.0, 1.0  # points to be chosen at all, and ahead of the next one
MIN_CORRELATION, HIGH_CORRELATION = 0.3, 0.6  # of a force with the speed, in size: counts, and counts more
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
        temperature = _pick("temperature", _ratings(candidates, "temperature"), self.table)
        if isinstance(temperature, Choice) and not temperature.checks:
            found["temperature"] = temperature
        return DamperChoice(find_signs(found, self.table), missing)

    def _strokes(self, candidates: Sequence[Candidate]) -> list[Rating]:
        """Return the ratings as position, with what the forces that go with them say."""
        ratings = _ratings(candidates, "position")
        usable = [r for r in ratings if not r.excluded][:MAX_STROKES]
        forces = [r.candidate for r in _ratings(candidates, "force") if not r.excluded][:MAX_FORCES]
        improved = [self._with_forces(rating, forces) for rating in usable]
        rest = [r for r in ratings if r.excluded or r not in usable]
        return _sort([*improved, *rest])

    def _with_forces(self, rating: Rating, forces: Sequence[Candidate]) -> Rating:
        """Add points for a stroke with which a force goes as a damper's does."""
        best, match = 0.0, None
        for force in forces:
            correlation = self._damping(rating.candidate, force, rating.named)
            if abs(correlation) > abs(best):
                best, match = correlation, force
        return (
            rating if match is None else rating.add(_points(best), f"{match.label} goes with its speed ({best:+.2f})")
        )

    def _damping(self, stroke: Candidate, force: Candidate, named: bool) -> float:
        """Return the correlation of a force with the stroke's speed; 0 if it does not count."""
        if stroke is force or (not named and not _can_only_be(stroke, force)):
            return 0.0
        correlation, _ = self.table.correlate(stroke, force)
        if not abs(correlation) >= MIN_CORRELATION or self.table.is_derivative(stroke, force):
            return 0.0
        return correlation

    def _forces(self, candidates: Sequence[Candidate], stroke: Candidate | None) -> list[Rating]:
        """Return the ratings as force, with what the chosen position says."""
        ratings = [r for r in _ratings(candidates, "force") if r.candidate is not stroke]
        return ratings if stroke is None else _sort([self._with_stroke(r, stroke) for r in ratings])

    def _with_stroke(self, rating: Rating, stroke: Candidate) -> Rating:
        if rating.excluded:
            return rating
        correlation = self._damping(stroke, rating.candidate, rating.named)
        if self.table.is_derivative(stroke, rating.candidate):
            return rating.add(-5.0, f"is the speed of {stroke.label}")
        if correlation:
            return rating.add(_points(correlation), f"goes with the speed of {stroke.label} ({correlation:+.2f})")
        return rating

    def _currents(self, candidates: Sequence[Candidate], taken: Sequence[Candidate]) -> list[Rating]:
        """Return the ratings as current; one without a name counts only if it is the only one that can be."""
        ratings = [r for r in _ratings(candidates, "current") if r.candidate not in taken]
        if any(r.named and r.points >= MIN_POINTS for r in ratings):
            return ratings
        silent = [r for r in ratings if not r.excluded and not r.named and r.points > 0.0 and not r.against]
        if len(silent) != 1 or read_meaning(silent[0].candidate.names).quantity or silent[0].candidate.constant:
            return ratings
        return _sort([silent[0].add(MIN_POINTS - silent[0].points, ALONE), *(r for r in ratings if r != silent[0])])


def _ratings(candidates: Sequence[Candidate], signal: str) -> list[Rating]:
    return _sort([rate(candidate, signal) for candidate in candidates])


def _sort(ratings: Sequence[Rating]) -> list[Rating]:
    """Return the ratings, the best first, those that are excluded last."""
    return sorted(ratings, key=lambda r: (bool(r.excluded), -r.points))


def _points(correlation: float) -> float:
    return 3.0 if abs(correlation) >= HIGH_CORRELATION else 2.0


def _can_only_be(stroke: Candidate, force: Candidate) -> bool:
    """Return whether ranges allow this pair in this order only; without names, both orders correlate."""
    this = is_plausible(stroke, "position") and is_plausible(force, "force")
    return this and not (is_plausible(force, "position") and is_plausible(stroke, "force"))


def _pick(signal: str, ratings: Sequence[Rating], table: MotionTable) -> Choice | NotFound:
    """Return the choice, or why there is none."""
    good = [r for r in ratings if not r.excluded and r.points >= MIN_POINTS]
    others = tuple(r for r in ratings if not r.excluded and (r.points > 0.0 or r.against))
    if not good:
        near = others or tuple(ratings)
        return NotFound(signal, _why_none(ratings), near)
    best, *rest = good
    rivals = [r for r in rest if best.points - r.points < MIN_MARGIN]
    same = bool(rivals) and all(table.is_same(best.candidate, r.candidate) for r in rivals)
    if rivals and not same:
        labels = ", ".join(r.candidate.label for r in (best, *rivals))
        return NotFound(signal, f"{1 + len(rivals)} candidates are equally good: {labels}", (best, *rivals))
    twins = [f"the same motion as {r.candidate.label}: take the one that is measured" for r in rivals]
    return _make_choice(best, tuple(r for r in others if r is not best), twins)


def _why_none(ratings: Sequence[Rating]) -> str:
    """Return why nothing was chosen: what speaks against the one that is named so, if one is."""
    named = next((r for r in ratings if r.excluded and read_meaning(r.candidate.names).quantity == r.signal), None)
    if named is None:
        return "nothing is named like it or has its unit, and moves like it"
    return f"'{named.candidate.label}' is named like it, but {named.excluded}"


def _make_choice(rating: Rating, others: tuple[Rating, ...], checks: Sequence[str]) -> Choice:
    guess = guess_unit(rating.candidate, rating.signal)
    unit = guess.unit
    doubts = [*checks, *rating.against]
    if unit is None or (not guess.stated and unit.text not in SI):
        doubts.append(guess.text)
    if not rating.named or ALONE in rating.reasons:
        doubts.append(ALONE)
    scale, offset = (unit.scale, unit.offset) if unit else (1.0, 0.0)
    reasons = tuple(reason for reason in rating.reasons if reason != ALONE)
    return Choice(
        rating.signal, rating.candidate, guess, scale, offset, (*reasons, *_unit_reason(guess)), tuple(doubts), others
    )


def _unit_reason(guess: UnitGuess) -> tuple[str, ...]:
    return () if guess.stated or guess.unit is None or guess.unit.text not in SI else (guess.text,)
