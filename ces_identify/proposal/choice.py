"""What was chosen for each signal, why, and what a person should check."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ces_identify.proposal.candidate import Candidate
from ces_identify.proposal.plausible import UnitGuess
from ces_identify.proposal.rating import Rating


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
