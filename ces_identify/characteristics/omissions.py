"""What was recorded and not used, and what cannot be known, each with its reason."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ces_identify.characteristics.cycles import REASONS, Cycles
from ces_identify.characteristics.motion import MEASURED, RecordingMotion
from ces_identify.characteristics.rows import CycleWork, Omission, StepResponse

ALL = "all"
NO_CYCLES = (
    "no cycle repeats at a constant current: record sines, triangles or a slow sweep, each at a constant current "
    "('ces rig characterise' shows how); the bins of speed describe any motion"
)
NO_STEPS = "cannot know: the current has no steps"
NO_STEPS_READ = "cannot know: no step of the current while the piston moves at a constant speed; see the table of steps"


def find_omissions(
    motions: Sequence[RecordingMotion], cycles: Cycles, steps: Sequence[StepResponse]
) -> Iterator[Omission]:
    """Yield why cycles and steps were not used, by recording, and which tables are empty."""
    for number, motion in enumerate(motions):
        own = cycles.reason[cycles.recording == number]
        for index, reason in enumerate(REASONS):
            count = int((own == index).sum())
            if count:
                yield Omission(subject="cycles", recording=motion.name, count=count, of=len(own), reason=reason)
        measured = [s for s in steps if s.recording == motion.name and s.source == MEASURED]
        for reason in dict.fromkeys(s.note for s in measured if s.note):
            count = sum(s.note == reason for s in measured)
            yield Omission(subject="steps", recording=motion.name, count=count, of=len(measured), reason=reason)
    if not cycles.used.any():
        yield Omission(subject="force over speed, loops, work", recording=ALL, reason=NO_CYCLES)
    if not any(s.source == MEASURED and not s.note for s in steps):
        reason = NO_STEPS_READ if steps else NO_STEPS
        yield Omission(subject="response of the valve", recording=ALL, reason=reason)


def find_empty_values(work: Sequence[CycleWork]) -> Iterator[Omission]:
    """Yield why rows of the work per cycle have empty cells."""
    for reason in dict.fromkeys(row.note for row in work if row.note):
        count = sum(row.note == reason for row in work)
        yield Omission(subject="rows of the work per cycle", recording=ALL, count=count, of=len(work), reason=reason)
