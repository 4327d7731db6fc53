"""The observer of one damper: samples in; a force, or the reason why it is withheld, and counts for diagnostics out.

It does not use ROS: stamps are integers, and the node's time is an argument. The model can be replaced at run time: the
new one warms up on the same samples beside the old one and takes over between two samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from math import ceil, isfinite

from ces_observer.current_hold import ConstantCurrent, CurrentHold
from ces_observer.errors import ModelError
from ces_observer.estimator import Estimator, LateEstimate
from ces_observer.model import Model
from ces_observer.reasons import BEYOND_STROKE, OK, OUT_OF_ORDER, UNBOUNDED, WARMING_UP

SILENT = "no position samples arrive"
POSITION_NOT_FINITE = "position is not finite"
NO_CURRENT = "no usable current"
NO_MOTION = "no usable speed or acceleration"
OFF_CLOCK = "position stamps are off the node's clock"


@dataclass
class Tally:
    """Counts since the start: position samples, forces, those from outside the envelopes, withheld ones by reason."""

    samples: int = 0
    estimates: int = 0
    late: int = 0  # forces of earlier samples, that a model with a delay gives
    clamped: int = 0  # inputs outside the envelope: clamped, unless the structure extrapolates
    held: int = 0  # forces outside the force envelope: held at its end
    unreadable: int = 0  # position or current messages without the configured field
    withheld: dict[str, int] = field(default_factory=dict)

    def copy(self) -> Tally:
        """Return the present counts."""
        return replace(self, withheld=dict(self.withheld))


_NO_SIGNAL = ConstantCurrent(0.0)  # for a model that needs the position only


class DamperObserver:
    """The estimator and current hold of one damper.

    After `step`: `reason` is "ok" or why the force was withheld; `position` [m] and `speed` [m/s] are the values used;
    `late` holds the estimates of earlier samples that a model with a delay gives now, each stamp once.
    `max_age_s` is the largest difference between a position's stamp and the node's clock, in either direction, at
    which its force is returned, plus the delay in `late`; 0 switches the check off. The estimator runs on while forces
    are withheld.
    `motions` holds the signals that a model may need beside the position, "speed" [m/s] or "acceleration" [m/s2].
    Raises ModelError if the model needs another.
    """

    def __init__(
        self, model: Model, current: CurrentHold, max_age_s: float, motions: Mapping[str, CurrentHold] | None = None
    ) -> None:
        self.model = model
        self.current = current
        self.motions = motions or {}
        self.motion = self.motion_for(model)
        self.tally = Tally()
        self.reason = SILENT
        self.stamp_ns = 0
        self.age_ns = 0
        self._errors = dict.fromkeys(("position", "current", "motion"), "")  # of the newest messages; empty: readable
        self._estimator = Estimator(model)
        self._next: Estimator | None = None
        self._next_current, self._next_motion = current, self.motion
        self.position = self.speed = self._position_m = 0.0
        self.late: list[LateEstimate] = []
        self._late_ns = 0  # the stamp of the last of them
        self.set_max_age(max_age_s)

    def set_max_age(self, max_age_s: float) -> None:
        """Set the largest difference [s] between stamp and clock; 0: any."""
        self._max_age_ns = ceil(max_age_s * 1e9)  # 0 stands for any

    def load(self, model: Model) -> None:
        """Let `model` take over as soon as it has warmed up, instead of any other that was still warming up.

        Raises ModelError if it needs a signal that is not there.
        """
        self._next_motion = self.motion_for(model)
        self._next = Estimator(model)
        self._next_current = self.current.with_max_age(model.sampling.max_current_age_s)

    @property
    def next_model(self) -> Model | None:
        """The model that is warming up to take over, if any."""
        return self._next.model if self._next is not None else None

    def forget_inputs(self, since_ns: int) -> None:
        """Forget currents and motions if they go on after `since_ns`: the clock of the positions was set back."""
        for hold in (self.current, *self.motions.values()):
            if hold.newest_ns is not None and hold.newest_ns >= since_ns:
                hold.reset()

    def reset(self) -> None:
        """Forget all samples and currents, as after a time jump; keep counts and models."""
        self.current.reset()
        for motion in self.motions.values():
            motion.reset()
        self._estimator.reset()
        if self._next is not None:
            self._next.reset()
        self.late, self._late_ns = [], 0
        if self.reason != SILENT:
            self.reason = self._estimator.word

    def restart(self) -> None:
        """Reset with new estimators: an unexpected error may have left any part of the old ones half changed."""
        self._estimator = Estimator(self.model)
        if self._next is not None:
            self._next = Estimator(self._next.model)
        self.reset()

    def take_current(self, stamp_ns: int, current_A: float) -> None:
        """Add a current sample."""
        self._errors["current"] = "" if isfinite(current_A) else f"the current is {current_A}"
        self.current.add(stamp_ns, current_A)

    def motion_for(self, model: Model) -> CurrentHold:
        """Return the hold of the motion that `model` needs, a constant if it needs none; raises ModelError."""
        name = model.sampling.motion
        if not name:
            return _NO_SIGNAL
        if name not in self.motions:
            raise ModelError(
                f"the model needs the signal '{name}', too; set {name}.topic, {name}.type and {name}.field"
            )
        return self.motions[name].with_max_age(model.sampling.max_gap_s)

    def step(self, stamp_ns: int, position_m: float, now_ns: int) -> float | None:
        """Return the force [N] at `stamp_ns`, or None with `reason` set; `now_ns` is the node's clock."""
        tally = self.tally
        tally.samples += 1
        self.stamp_ns, self.age_ns = stamp_ns, now_ns - stamp_ns
        self._errors["position"] = ""
        current = self.current.at(stamp_ns)
        motion = 0.0 if self.motion is _NO_SIGNAL else self.motion.at(stamp_ns)
        self._position_m = position_m
        force = self._estimator.step(stamp_ns, position_m, current, motion)
        if self._next is not None:
            next_current, next_motion = self._next_current.at(stamp_ns), self._next_motion.at(stamp_ns)
            next_force = self._next.step(stamp_ns, position_m, next_current, next_motion)
            if self._next.is_warm:
                force, current, motion = next_force, next_current, next_motion
                self._next.skip_late(self._late_ns)
                self._estimator, self.model, self._next = self._next, self._next.model, None
                self.current, self.motion = self._next_current, self._next_motion
        estimator = self._estimator
        self.position, self.speed = estimator.position, estimator.speed
        self.late = estimator.late
        if self.late:
            self.late = self._usable(self.late)
        # A model with a delay has no force here, but is well if `late` has those of earlier samples.
        known = force if force is not None or estimator.word != OK else 0.0
        late = self._max_age_ns and abs(self.age_ns) > self._max_age_ns
        # One sum instead of five tests: it is finite only if all terms are.
        if known is None or late or not isfinite(known + position_m + current + self.position + self.speed):
            self.reason = self._explain_withholding(known, position_m, current, motion)
            if self.reason != OK:
                tally.withheld[self.reason] = tally.withheld.get(self.reason, 0) + 1
                return None
        self.reason = OK
        tally.estimates += 1
        tally.clamped += estimator.clamped
        tally.held += estimator.held
        return force

    def _usable(self, late: list[LateEstimate]) -> list[LateEstimate]:
        """Return the estimates of earlier samples that may be published; `age_ns` is that of the newest sample."""
        now_ns, limit_ns = self.stamp_ns + self.age_ns, self._max_age_ns + self._estimator.delay_ns
        fresh = [one for one in late if not self._max_age_ns or abs(now_ns - one.stamp_ns) <= limit_ns]
        usable = [one for one in fresh if isfinite(one.position + one.speed + one.force)]
        self.tally.late += len(usable)
        self._late_ns = late[-1].stamp_ns
        return usable

    def half_width(self) -> float | None:
        """Return the half-width [N] of the band around the force that `step` has just returned, None without one."""
        return self._estimator.half_width()

    def count_unreadable(self, signal: str, error: str) -> None:
        """Count a message without its field, of "position", "current" or "motion"; it explains a later lack."""
        self.tally.unreadable += 1
        self._errors[signal] = error

    @property
    def motion_name(self) -> str:
        """The signal that the running model needs beside the position; empty: none."""
        return self.model.sampling.motion

    def take_motion(self, name: str, stamp_ns: int, value: float) -> None:
        """Add a sample of "speed" [m/s] or "acceleration" [m/s2]."""
        self._errors["motion"] = "" if isfinite(value) else f"the {name} is {value}"
        self.motions[name].add(stamp_ns, value)

    def report_silence(self) -> None:
        """Set the reason to SILENT: no position sample has arrived for too long."""
        self.reason = SILENT

    def explain(self) -> str:
        """Return details of `reason`, empty if there are none."""
        text = ""
        if self.reason == SILENT:
            text = self._errors["position"]
        elif self.reason == NO_CURRENT:
            text = self._errors["current"] or self.current.explain(self.stamp_ns)
        elif self.reason == NO_MOTION:
            text = self._errors["motion"] or self.motion.explain(self.stamp_ns, self.motion_name)
        elif self.reason == WARMING_UP:
            text = self._estimator.cause
        elif self.reason == BEYOND_STROKE:
            low, high = self.model.sampling.stroke_m
            text = f"{self._position_m:g} m, the model takes {low:g} to {high:g} m; check scale and offset"
        elif self.reason in (OFF_CLOCK, OUT_OF_ORDER) and self.stamp_ns == 0:
            text = "the header stamp is 0: the publisher does not fill it in"
        elif self.reason == OFF_CLOCK:
            side = "behind" if self.age_ns > 0 else "ahead of"
            text = (
                f"{abs(self.age_ns) * 1e-9:.3g} s {side} it, max_age_s allows {self._max_age_ns * 1e-9:g} s; for a "
                "replay or a simulation set use_sim_time: true and let it publish /clock, or set max_age_s: 0.0"
            )
        return text

    def _explain_withholding(self, force: float | None, position: float, current: float, motion: float) -> str:
        """Return why a force is withheld: the first of these rules that applies."""
        if not isfinite(position):
            return POSITION_NOT_FINITE
        if self._max_age_ns and abs(self.age_ns) > self._max_age_ns:
            return OFF_CLOCK
        if not isfinite(current):
            return NO_CURRENT
        if not isfinite(motion):
            return NO_MOTION
        if force is None:
            return self._estimator.word
        return OK if isfinite(force) and isfinite(self.position) and isfinite(self.speed) else UNBOUNDED
