"""How well a candidate fits a signal by its name, its unit and its own numbers: points with a reason for each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from ces_identify.proposal.candidate import Candidate
from ces_identify.proposal.plausible import fits_quantity, is_plausible
from ces_identify.proposal.words import COMMAND_PARTS, COMMANDS, COMPUTED, DEVICE, FOREIGN, find_word, read_meaning
from ces_observer.signals import UNITS

UNIT_POINTS, STEADY_POINTS, POSITIVE_POINTS, DEVICE_POINTS = 3.0, 1.0, 1.0, 1.0
COMMAND_POINTS, COMPUTED_POINTS, FOREIGN_POINTS, SIGN_POINTS, RANGE_POINTS = -3.0, -5.0, -5.0, -2.0, -1.0
CONSTANT_POINTS = -1.0  # of a current: possible, but not beside one that changes
NEGATIVE_SHARE = 0.05  # of the peak, that an amplifier's offset may take a current below zero


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

    def rank_lower(self, points: float, reason: str) -> Rating:
        """Return the rating with negative points, so that another is preferred; no reason against what is named so."""
        if not self.named:
            return self.add(points, reason)
        return replace(self, points=self.points + points, reasons=(*self.reasons, reason))

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
        rating = rating.add(UNIT_POINTS, f"unit {candidate.unit.text} {candidate.stated}".rstrip())
    for points, reason in _remarks(candidate, signal):
        rating = rating.add(points, reason)
    if signal == "current" and candidate.constant:
        rating = rating.rank_lower(CONSTANT_POINTS, f"constant at {candidate.high:g}")
    return rating


def _exclusion(candidate: Candidate, signal: str) -> str:
    """Return why the candidate cannot be the signal, '' if it can."""
    unit, meaning = candidate.unit, read_meaning(candidate.names)
    if not fits_quantity(candidate, signal):
        return f"its unit {unit.text if unit else ''} is not one of a {signal} [{UNITS[signal]}]"
    if meaning.quantity not in ("", signal) and (unit is None or meaning.weight > 2.0):
        return f"named '{meaning.word}': a {meaning.quantity}"
    if candidate.counts_up and unit is None and meaning.quantity != signal:
        return "only counts up: a time or a counter"
    if candidate.constant and signal in ("position", "force"):
        return f"constant at {candidate.high:g}"
    if signal == "position" and candidate.rough:
        return f"jumps like noise from sample to sample, at {candidate.rate_Hz:.4g} Hz; a stroke moves smoothly"
    return ""


def _remarks(candidate: Candidate, signal: str) -> Iterator[tuple[float, str]]:
    """Yield points and reason of what else the name and the numbers say."""
    if (word := find_word(candidate.names, DEVICE)) and read_meaning(candidate.names).quantity == signal:
        yield DEVICE_POINTS, f"of a '{word}'"
    if word := find_word(candidate.names, COMMANDS, COMMAND_PARTS):
        yield COMMAND_POINTS, f"a command by its name ('{word}'), not a measurement"
    if word := find_word(candidate.names, COMPUTED):
        yield COMPUTED_POINTS, f"computed by its name ('{word}'), not measured"
    if word := find_word(candidate.names, FOREIGN):
        yield FOREIGN_POINTS, f"'{word}' in its name"
    if not candidate.constant and not is_plausible(candidate, signal):
        yield RANGE_POINTS, f"range {candidate.low:.4g} to {candidate.high:.4g} is implausible for a {signal}"
    if signal == "current":
        yield from _current_remarks(candidate)


def _current_remarks(candidate: Candidate) -> Iterator[tuple[float, str]]:
    if candidate.low < -NEGATIVE_SHARE * candidate.peak:
        yield SIGN_POINTS, f"goes below zero, to {candidate.low:.4g}"
    else:
        yield POSITIVE_POINTS, "never negative"
    if candidate.held:
        yield STEADY_POINTS, "held between steps"
