"""A model file's certificate proved again, and compared with what the file claims."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ces_observer.model import Model
from ces_observer.proof.certificate import Certificate

NOT_PROVED = 1  # exit status
ROUNDING = 1e-9  # relative


def verify_certificate(model: Model, name: str) -> int:
    """Prove `model` stable, print the bounds and compare them with the file's; return the exit status.

    0 if it is proved and the file claims no more than that; else one line says what is not, and the status is UNPROVED.
    """
    proof = model.certify()
    if not proof.holds:
        print(f"not proved: {name}: {proof.doubt}")
        return NOT_PROVED
    excess = find_overclaim(model.certificate, proof)
    if excess:
        print(f"not proved: {name}: the file claims {excess}: identify the model anew")
        return NOT_PROVED
    envelope = model.envelope
    print(f"proved: {proof.claim} ({proof.effort})")
    for label, value in proof.rows:
        print(f"  {label:<14}  {value}")
    for label, (low, high), unit in (
        ("position", envelope.position_m, "m"),
        ("speed", envelope.speed_m_s, "m/s"),
        ("current", envelope.current_A, "A"),
        ("force kept", model.force_envelope_N, "N"),
    ):
        print(f"  {label:<14}  {low:.6g} to {high:.6g} {unit}")
    print(f"  in the file     {compare_certificates(model.certificate, proof)}")
    return 0


def find_overclaim(stored: Mapping[str, Any] | None, proof: Certificate) -> str:
    """Return the first bound that the file states tighter than the proof, in words; empty if there is none."""
    for key, proved in proof.bounds.items():
        claimed = _number(stored, key)
        if claimed is not None and claimed < proved * (1.0 - ROUNDING):
            return f"{key} {claimed:.6g}, but only {proved:.6g} is proved"
    return ""


def compare_certificates(stored: Mapping[str, Any] | None, proof: Certificate) -> str:
    """Return how the file's certificate compares with a proof it does not exceed, in words."""
    if stored is None:
        return "no certificate"
    claims = {key: _number(stored, key) for key in proof.bounds}
    missing = [key for key, value in claims.items() if value is None]
    if missing:
        return f"incomplete: no {', '.join(missing)}"
    looser = [k for k, proved in proof.bounds.items() if (claims[k] or 0.0) > proved * (1.0 + ROUNDING)]
    return f"looser bounds: {', '.join(looser)}" if looser else "the same bounds"


def _number(stored: Mapping[str, Any] | None, key: str) -> float | None:
    value = (stored or {}).get(key)
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None
