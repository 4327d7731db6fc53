"""The targets of fuzzing: each is a function that returns the outcome of an input and raises if a promise is broken.

Promises: a file gives a model that runs, or signals, or one line of CesError; a force is None or within its envelope.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path
from unittest.mock import patch

from ces_data.signals_file import load_signals
from ces_observer.bank_design import ACCELERATION, SPEED
from ces_observer.current_hold import CurrentHold
from ces_observer.damper_observer import DamperObserver
from ces_observer.errors import CesError
from ces_observer.estimator import Estimator
from ces_observer.limits import ProofLimits
from ces_observer.model import Model, load_model, parse_model
from ces_observer.reasons import OK

REFUSED, READ, WITHHELD, FORCE = "refused", "read", "withheld", "force"
STEPS = 8  # of a model that was read: its corners, at its own rate

LITTLE_WORK = 20_000  # a proof that stops early finds crashes as well as a complete one


@dataclass(frozen=True)
class FuzzSample:
    """One position sample, and the current that came before it (None: no current)."""

    stamp_ns: int
    position_m: float
    current_A: float | None


def try_model(path: Path) -> str:
    """Read a model file, and do with its model all that a node does."""
    try:
        model = load_model(path)
    except CesError as error:
        return _check_refusal(error)
    assert parse_model(model.to_json(), "again") == model
    assert len(model.digest()) == 64
    with patch.object(ProofLimits, "MAX_WORK", LITTLE_WORK):
        model.is_stable()
    try_estimator(Estimator(model), _corners(model))
    return READ


def try_signals(path: Path) -> str:
    """Read a signals description."""
    try:
        signals = load_signals(path)
    except CesError as error:
        return _check_refusal(error)
    assert signals["position"]
    assert all(s.make_reader() and isfinite(s.scale) and isfinite(s.offset) for s in signals.list_topic_signals())
    return READ


def try_estimator(estimator: Estimator, samples: Iterable[FuzzSample]) -> dict[str, int]:
    """Feed an estimator; return how many samples gave a force and how many did not."""
    low, high = estimator.model.force_envelope_N
    count = {FORCE: 0, WITHHELD: 0}
    for s in samples:
        force = estimator.step(s.stamp_ns, s.position_m, 0.0 if s.current_A is None else s.current_A)
        assert (force is None) == (estimator.reason != OK)
        assert force is None or low <= force <= high, force
        assert all(low <= late.force <= high and isfinite(late.position + late.speed) for late in estimator.late)
        half_width = estimator.half_width()
        assert half_width is None or 0.0 <= half_width < inf, half_width
        assert isfinite(estimator.position) and isfinite(estimator.speed)
        count[WITHHELD if force is None else FORCE] += 1
    return count


def try_damper(model: Model, samples: Iterable[FuzzSample], max_age_s: float) -> dict[str, int]:
    """Feed the whole damper observer, with a clock that follows the stamps."""
    motions = {name: CurrentHold(model.sampling.max_gap_s) for name in (SPEED, ACCELERATION)}
    damper = DamperObserver(model, CurrentHold(model.sampling.max_current_age_s), max_age_s, motions)
    low, high = model.force_envelope_N
    count = {FORCE: 0, WITHHELD: 0}
    now_ns = 0
    for i, s in enumerate(samples):
        now_ns = s.stamp_ns if i % 50 == 0 else now_ns + 1_000_000
        if s.current_A is not None:
            damper.take_current(s.stamp_ns, s.current_A)
        damper.take_motion(ACCELERATION, s.stamp_ns, 100.0 * s.position_m)
        force = damper.step(s.stamp_ns, s.position_m, now_ns)
        assert (force is None) == (damper.reason != OK)
        assert force is None or low <= force <= high, force
        assert "\n" not in damper.explain()
        count[WITHHELD if force is None else FORCE] += 1
    return count


def _check_refusal(error: CesError) -> str:
    line = str(error)
    assert line and "\n" not in line and "\r" not in line and line.isprintable(), repr(line)
    assert len(line) < 4000, len(line)
    return REFUSED


def _corners(model: Model) -> Iterable[FuzzSample]:
    """Yield samples at corners of the model's envelope, and one after the longest gap that the model bridges."""
    e, period_ns = model.envelope, max(1, round(1e9 / model.sampling.rate_Hz))
    for k in range(STEPS):
        yield FuzzSample(k * period_ns, e.position_m[k % 2], e.current_A[k // 2 % 2])
    gap_ns = min(round(model.sampling.max_gap_s * 1e9), 200 * period_ns)
    yield FuzzSample(STEPS * period_ns + gap_ns, e.position_m[0], e.current_A[1])
