"""Certificates of models that store and dissipate energy, as a damper does: bounded for every input, never amplifying.

Such a model computes its state by an implicit step, S (P(k) - P(k-1)) + T L(P(k)) = T a v(k), with a symmetric positive
definite S and an L whose parts are increasing functions. Between two runs with the same inputs and valve setting L is
monotone, so the energy 1/2 dP' S dP of their difference never grows; and 1/2 P' S P grows only while P' L(P) < v a' P.
The setting depends on the current alone, and no stage of its path amplifies a difference (`valve_path`).

The bounds hold from a restart on: `envelope_N` while all inputs since then were in the envelope, `force_bound_N` for
any inputs. They are those of exact arithmetic, widened by 1e-9; a step is solved to about 1e-12.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

from ces_observer.proof.certificate import Certificate

CLAIM = (
    "|F| stays bounded for every input, and the energy of the difference of two runs with the same inputs and valve "
    "setting never grows"
)


@dataclass(frozen=True)
class EnergyCertificate(Certificate):
    """Proved bounds on |force| [N]: `envelope_N` for inputs in the envelope, `force_bound_N` for every input."""

    envelope_N: float
    force_bound_N: float
    claim: str
    method: str

    @property
    def holds(self) -> bool:
        """True if both bounds are finite; the energy argument holds for all curves that a model file can contain."""
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
        return {"force_bound_N": self.envelope_N, "force_bound_any_input_N": self.force_bound_N}

    @property
    def doubt(self) -> str:
        """Why stability is not proved, in words."""
        return "the bound on its force is not finite"

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        """The proved numbers for display."""
        return (
            ("energy", "of the difference of two runs never grows, for any input"),
            ("force bound", f"{self.envelope_N:.6g} N for inputs in the envelope"),
            ("", f"{self.force_bound_N:.6g} N for any input"),
        )
