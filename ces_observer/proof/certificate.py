"""Certificates of stability: the claim, the method of proof, and the bound on the force.

Each structure has its own proof and returns a `Certificate`: a `Contraction`, or an `EnergyCertificate` of a model that
stores and dissipates energy, as a damper does: bounded for every input, never amplifying.

Such a model computes its state by an implicit step, U(P(k)) - U(P(k-1)) + T L(P(k)) = T a v(k), with U and L gradients
of convex functions of the pressures P, strictly so for U: the step has one solution. By convexity, the energy stored
(the conjugate of the function with gradient U) grows in a step by at most T (v a' P - P' L(P)): only the motion feeds
it. The model holds its pressures and its force within bounds: both stay bounded whatever the input and the rounding.

`forgets_s` is the time after which two runs of the same input, from any two states, differ by less than
FORGOTTEN of the width of the force envelope.

The bounds hold from a restart on: `envelope_N` while all inputs since then were in the envelope, `force_bound_N` for
any inputs.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, inf, isfinite, log
from typing import Any

from ces_observer.limits import ProofLimits
from ces_observer.proof.intervals import up


class Certificate(ABC):
    """The result of a proof: `claim` holds for every input, `method` is how it was proved."""

    claim: str
    method: str
    forgets_s: float = inf

    @property
    def holds(self) -> bool:
        """True if the model is proved stable."""
        return isfinite(self.force_N)

    @property
    @abstractmethod
    def force_N(self) -> float:
        """Bound on the force [N], infinite if the model is not proved stable."""

    @property
    def force_claim(self) -> str:
        """The bound on the force, in words."""
        return f"|force| at most {self.force_N:.0f} N"

    @property
    @abstractmethod
    def bounds(self) -> Mapping[str, float]:
        """The proved bounds by their keys in the model file, which must not claim tighter ones."""

    @property
    def doubt(self) -> str:
        """Why stability is not proved, in words."""
        return "the bound on its force is not finite"

    @property
    @abstractmethod
    def rows(self) -> tuple[tuple[str, str], ...]:
        """The proved numbers for display: names, and values with units."""

    @property
    def effort(self) -> str:
        """The method and effort of the proof, in words."""
        return self.method

    def to_mapping(self) -> dict[str, object]:
        """Return the certificate as in a model file."""
        bounds = {name: bound for name, bound in self.bounds.items() if isfinite(bound)}
        return {"claim": self.claim, "method": self.method, **bounds}

    @property
    def past_row(self) -> tuple[str, str]:
        """How long the past counts, for display."""
        return (
            "past",
            f"forgotten after {self.forgets_s:.3g} s" if isfinite(self.forgets_s) else "not proved to be forgotten",
        )


def summarize(stored: Mapping[str, Any]) -> str:
    """Return a model file's stored certificate as a sentence."""
    forgets_s, measured = stored.get("forgets_s"), stored.get("forgetting")
    start = "" if forgets_s is None else f"; its start is forgotten after {forgets_s:.2g} s"
    if measured:
        left = max(measured["left_percent"].values(), default=0.0)
        start = f"; measured: {left:.2g} % of its start is left after {measured['after_s']:g} s"
    return _summarize_bounds(stored) + start


def _summarize_bounds(stored: Mapping[str, Any]) -> str:
    gain, anywhere, inside = (stored.get(key) for key in ("gain", "force_bound_any_input_N", "force_bound_N"))
    if gain is not None:
        return f"contraction: the gains of the past forces sum to at most {gain:.3f} < 1 for any input in the envelope"
    if anywhere is not None:
        within = "" if inside is None else f"{inside:.0f} N within the envelope, "
        bound = f"|force| at most {within}{anywhere:.0f} N for any input"
        return f"passive: only the motion feeds its energy, and {bound}"
    slowest_s = stored.get("slowest_s")
    if slowest_s is not None:
        forgotten = f"forgotten with a time constant of at most {1e3 * slowest_s:.3g} ms"
        return f"the past is {forgotten}; |force| at most {inside or 0.0:.0f} N for any input"
    return str(stored.get("claim"))


@dataclass(frozen=True)
class Contraction(Certificate):
    """Proved bounds on y(k) = sum_j a_j y(k - j) + b: `gain` on sum |a_j|, `drive_N` on |b| [N].

    With gain < 1, |y| <= drive_N / (1 - gain) at all times. `boxes` counts the boxes of inputs in the proof.
    """

    gain: float
    drive_N: float
    boxes: int
    claim: str
    method: str
    forgets_s: float = inf

    @property
    def holds(self) -> bool:
        """True if the model is a contraction."""
        return self.gain < 1.0

    @property
    def force_N(self) -> float:
        """Bound on the force [N], infinite without a contraction."""
        return up(self.drive_N / (1.0 - self.gain)) if self.holds else inf

    @property
    def bounds(self) -> Mapping[str, float]:
        """Gain, drive, the bound on the force, and how long the past counts."""
        return {"gain": self.gain, "drive_N": self.drive_N, "force_bound_N": self.force_N, "forgets_s": self.forgets_s}

    @property
    def doubt(self) -> str:
        """Why it is not proved to be a contraction."""
        return f"the gains of the past forces may sum to {self.gain:.6g}; expected less than 1"

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """The proved numbers for display."""
        return (
            ("gain", f"{self.gain:.6g} < 1"),
            ("drive", f"{self.drive_N:.6g} N"),
            ("force bound", f"{self.force_N:.6g} N"),
            self.past_row,
        )

    @property
    def effort(self) -> str:
        """The method of the proof and its number of boxes."""
        return f"{self.method}, {self.boxes} boxes"

    def to_mapping(self) -> dict[str, object]:
        """Return the certificate as in a model file."""
        return {**super().to_mapping(), "boxes": self.boxes}


def contraction_s(gain: float, past_lag: int, input_lag: int, rate_Hz: float) -> float:
    """Return the time [s] in which a contraction forgets: its force first gets inputs from before the longest of their
    lags [ticks], then falls by its gain in each `past_lag` ticks; infinite if it is none.
    """
    if not gain < 1.0:
        return inf
    times = ceil(log(ProofLimits.FORGOTTEN) / log(gain)) if gain > 0.0 else 1
    return up((times * past_lag + input_lag) / rate_Hz)


def largest_gain(forget_s: float, past_lag: int, input_lag: int, rate_Hz: float) -> float:
    """Return the largest gain with which a contraction forgets in time, see `contraction_s`; 0 if none does."""
    times = floor((forget_s * rate_Hz - input_lag) / max(past_lag, 1))
    return float(ProofLimits.FORGOTTEN ** (1.0 / times)) if times > 0 else 0.0


ENERGY_CLAIM = "|F| stays bounded for every input; a step has one solution, and only the motion feeds the energy stored"


@dataclass(frozen=True)
class EnergyCertificate(Certificate):
    """Proved bounds on |force| [N]: `envelope_N` for inputs in the envelope, `force_bound_N` for every input."""

    envelope_N: float
    force_bound_N: float
    claim: str
    method: str
    forgets_s: float = inf

    @property
    def holds(self) -> bool:
        """True if both bounds are finite; the argument holds for all curves that a model file can contain."""
        return isfinite(self.envelope_N) and isfinite(self.force_bound_N)

    @property
    def force_N(self) -> float:
        """Bound on the force [N] for inputs in the envelope."""
        return self.envelope_N

    @property
    def force_claim(self) -> str:
        """Both bounds on the force, in words."""
        return f"|force| at most {self.envelope_N:.0f} N within the envelope, {self.force_bound_N:.0f} N for any input"

    @property
    def bounds(self) -> Mapping[str, float]:
        """Bounds on the force, in the envelope and for every input."""
        forces = {"force_bound_N": self.envelope_N, "force_bound_any_input_N": self.force_bound_N}
        return {**forces, "forgets_s": self.forgets_s}

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """The proved numbers for display."""
        return (
            ("energy", "fed by the motion alone, for any input"),
            ("force bound", f"{self.envelope_N:.6g} N for inputs in the envelope"),
            ("", f"{self.force_bound_N:.6g} N for any input"),
            self.past_row,
        )
