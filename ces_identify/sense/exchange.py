"""Position and force interchanged in the signals file: a position that reaches thousands, driven by a tiny force."""

from __future__ import annotations

from ces_identify.recordings.checks import WRONG_MODEL, Finding, finite_values
from ces_identify.recordings.recording import Recording
from ces_identify.sense.motion import Motion
from ces_identify.sense.timing import is_reversed
from ces_identify.sense.units import FORCE_N, MAX_STROKE_M, half_span


def find_exchange(recording: Recording, motion: Motion | None) -> Finding | None:
    """Return a finding if both ranges are those of the other signal, and the work of the force has changed its sign.

    Interchanged signals return the work that the damper takes; mm and kN alone do not.
    """
    stroke, force = (half_span(finite_values(recording, name)) for name in ("position", "force"))
    if motion is None or 2.0 * stroke < MAX_STROKE_M or force > FORCE_N or not is_reversed(motion, None):
        return None
    return Finding(
        WRONG_MODEL,
        f"position: spans {2.0 * stroke:.4g} m, while the force reaches {force:.3g} N and acts with the motion: "
        "position and force are interchanged, or both are in other units and one of them is reversed; check topics, "
        "fields and scales in the signals file",
        signal="position",
    )
