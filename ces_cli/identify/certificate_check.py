"""Proves a model's stability again and compares the result with the certificate in its file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ces_observer.model import Model
from ces_observer.proof.certificate import Certificate

NOT_PROVED = 1  # exit status
ROUNDING = 1e-9  # relative


def verify_certificate(model: Model, name: str) -> int:
    """Prove `model` stable, print the bounds and compare them with the file's; return the exit status.

    The status is 0 if the proof succeeds and the file claims no more, else NOT_PROVED, and one line gives the reason.
    """
    proof = model.certify()
    if not proof.holds:
        print(f"not proved: {name}: {proof.doubt}")
        return NOT_PROVED
    excess = _find_overclaim(model.certificate, proof)
    if excess:
        print(f"not proved: {name}: the file claims {excess}; identify the model again")
        return NOT_PROVED
    envelope = model.envelope
    print(f"proved: {proof.claim} ({proof.effort})")
    for label, value in proof.rows:
        print(f"  {label:<14}  {value}")
    print(f"  {'inputs outside':<14}  the envelope are {model.body.outside}")
    for label, (low, high), unit in (
        ("position", envelope.position_m, "m"),
        ("speed", envelope.speed_m_s, "m/s"),
        ("current", envelope.current_A, "A"),
        ("force within", model.force_envelope_N, "N"),
    ):
        print(f"  {label:<14}  {low:.6g} to {high:.6g} {unit}")
    print(f"  in the file     {_compare_certificates(model.certificate, proof)}")
    return 0


def certificate_facts(model: Model, proof: Certificate) -> dict[str, Any]:
    """Return for --json whether a proof succeeded and covers the file's claims, and the bounds that it proves."""
    doubt = _find_overclaim(model.certificate, proof) if proof.holds else proof.doubt
    return {"proved": not doubt, "doubt": doubt or None, "bounds": proof.bounds}


def _find_overclaim(stored: Mapping[str, Any] | None, proof: Certificate) -> str:
    """Return the first bound in the file that is tighter than the proved one, as text; empty if there is none."""
    for key, proved in proof.bounds.items():
        claimed = _number(stored, key)
        if claimed is not None and claimed < proved * (1.0 - ROUNDING):
            return f"{key} {claimed:.6g}, but only {proved:.6g} is proved"
    return ""


def _compare_certificates(stored: Mapping[str, Any] | None, proof: Certificate) -> str:
    """Return as text how the file's certificate compares with a proof that covers it."""
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
