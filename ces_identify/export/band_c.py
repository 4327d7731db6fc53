"""The part of the exported C that computes the half-width of the band; templates/band.{c,h}.j2 hold the C."""

from __future__ import annotations

from math import exp

from ces_observer.band import Band


def band_facts(band: Band | None, rate_Hz: float) -> dict[str, object] | None:
    """Return the values for the templates, computed as `ces_observer.band.BandRun` computes them; None without one."""
    if band is None:
        return None
    span = band.current_A[1] - band.current_A[0]
    return {
        "level": band.level,
        "gain": 1.0 - exp(-1.0 / (band.change_s * rate_Hz)),
        "fade": exp(-1.0 / (band.reversal_s * rate_Hz)),
        "speed_m_s": band.speed_m_s,
        "low_A": band.current_A[0],
        "per_A": 1.0 / span if span > 0.0 else 0.0,
        "parts": band.parts,
        "mean": band.mean,
        "whitening": band.whitening,
        "limit": band.max_distance * band.max_distance,
        "share": band.constant_share,
        "rest": 1.0 - band.constant_share,
    }
