"""The faults: action, duration, the report expected from the observer, and the estimates allowed meanwhile."""

from __future__ import annotations

from dataclasses import dataclass

TRUE = "as undisturbed"  # estimates continue and equal those of an undisturbed observer
NONE = "none"  # no estimate for the corrupted samples
BOUNDED = "bounded"  # estimates are allowed inside the model's envelope

REAL, SIMULATED = "real", "simulated"


@dataclass(frozen=True)
class Fault:
    """One kind of fault.

    `spoiler` names the change at the source, `action` the action on the processes or the node instead. The episode is
    reported if one of `evidence` is in a message, in the name of a count that rises or in a text that changes, or if
    the value named by `doubles` doubles. `output` is the rule for estimates of the fault's samples; with NONE they are
    still allowed for `holds_s` after its beginning. With `restarts` the model's warm-up is added to the time allowed
    for recovery.
    """

    name: str
    evidence: tuple[str, ...]
    output: str
    spoiler: str = "nothing"
    action: str = ""
    seconds: tuple[float, float] = (0.3, 1.0)
    holds_s: float = 0.0
    restarts: bool = False
    times: tuple[str, ...] = (REAL, SIMULATED)
    doubles: str = ""


OUT_OF_ORDER = "stamp repeats or runs backwards"
NO_CURRENT = "no usable current"
OFF_CLOCK = "off the node's clock"
SILENT = "no position samples arrive"
RESTART = ("warming up", "restarted", "jumped")

POSITIONS = (
    Fault("rows of 1 to 5 samples lost", ("position: dropped",), TRUE, "short dropouts"),
    Fault("rows of 20 to 100 samples lost", ("position: dropped",), BOUNDED, "long dropouts", restarts=True),
    Fault("no samples", (SILENT,), NONE, "silence", seconds=(0.6, 1.5), restarts=True),
    Fault("each sample one to three times", (OUT_OF_ORDER, "position: duplicates"), TRUE, "duplicates"),
    Fault("reordered, four at a time", (OUT_OF_ORDER, "position: out of order"), TRUE, "reordering"),
    Fault("position NaN", ("position is not finite",), NONE, "nan", restarts=True),
    Fault("a fifth of the positions NaN", ("position is not finite",), TRUE, "some nan"),
    Fault("position infinite", ("position is not finite",), NONE, "inf", restarts=True),
    Fault("position of 1e300 m", ("outlier", "outside"), BOUNDED, "huge", restarts=True),
    Fault("spikes of 0.2 to 1 m", ("outlier",), TRUE, "spikes"),
    Fault("sensor stuck", ("has not changed", "unchanged"), BOUNDED, "stuck", seconds=(1.5, 2.5), restarts=True),
)
TIMES = (
    Fault("stamps 2 to 60 s ahead", (OFF_CLOCK,), NONE, "ahead", restarts=True),
    Fault("stamps 2 to 60 s behind", (OFF_CLOCK,), NONE, "behind", restarts=True),
    Fault("stamps 0.1 to 0.4 s ahead", RESTART, BOUNDED, "a little ahead", seconds=(0.7, 1.2), restarts=True),
    Fault("stamps 0.1 to 0.4 s behind", RESTART, BOUNDED, "a little behind", seconds=(0.7, 1.2), restarts=True),
    Fault("/clock and stamps jump ahead", RESTART, BOUNDED, "time ahead", restarts=True, times=(SIMULATED,)),
    Fault("/clock and stamps jump back", RESTART, BOUNDED, "time behind", restarts=True, times=(SIMULATED,)),
    Fault(
        "/clock jumps, stamps do not",
        (OFF_CLOCK,),
        NONE,
        "clock alone",
        holds_s=0.02,
        restarts=True,
        times=(SIMULATED,),
    ),
    Fault("simulation paused", (SILENT,), NONE, "paused", seconds=(0.6, 1.5), restarts=True, times=(SIMULATED,)),
)
MESSAGES = (
    Fault("wrong joint name", ("no joint 'rear_damper'",), NONE, "wrong joint", seconds=(0.6, 1.2), restarts=True),
    Fault("flood at 10 kHz", (), BOUNDED, "flood", doubles="position: rate [Hz]"),
    Fault("garbage among the messages", ("messages without the field",), TRUE, "garbage among"),
    Fault("nothing but garbage", (SILENT,), NONE, "garbage", seconds=(0.6, 1.2), restarts=True),
)
PROCESSES = (
    Fault(
        "publisher stalls, then a burst",
        (SILENT,),
        BOUNDED,
        action="stop source",
        seconds=(0.5, 2.0),
        restarts=True,
    ),
    Fault(
        "observer stalls, then a burst",
        (OFF_CLOCK, *RESTART),
        BOUNDED,
        action="stop observer",
        seconds=(0.7, 2.0),  # longer than max_age_s: after a shorter stall no force is withheld
        restarts=True,
    ),
    Fault(
        "publisher killed, another started",
        (SILENT,),
        NONE,
        action="kill source",
        seconds=(0.5, 1.5),
        restarts=True,
    ),
)
CHANGES = (
    Fault("another model by parameter", ("model sha256",), TRUE, action="other model"),
    Fault("a bad model by parameter", (), TRUE, action="bad model"),
    Fault("model file read again", ("model sha256",), TRUE, action="reload"),
    Fault("a bad model file read again", ("refused",), TRUE, action="bad reload"),
    Fault("another model on its topic", ("model sha256",), TRUE, action="model on topic"),
    Fault("a bad model on its topic", ("refused",), TRUE, action="bad model on topic"),
    Fault("max_age_s changed", (), TRUE, action="age"),
    Fault("max_age_s out of range", (), TRUE, action="bad age"),
)


def faults(current_hold_s: float) -> tuple[Fault, ...]:
    """Return all faults; `current_hold_s` is the longest time for which the model may hold a current."""
    return (*POSITIONS, *_currents(current_hold_s), *TIMES, *MESSAGES, *PROCESSES, *CHANGES)


def _currents(hold_s: float) -> tuple[Fault, ...]:
    held = hold_s + 0.05  # a current is stamped when it arrives
    return (
        Fault("current lost", (NO_CURRENT,), NONE, "no current", seconds=(0.6, 1.2), holds_s=held, restarts=True),
        Fault("current NaN", (NO_CURRENT,), NONE, "nan current", seconds=(0.6, 1.2), holds_s=held, restarts=True),
        Fault("current infinite", (NO_CURRENT,), NONE, "inf current", seconds=(0.6, 1.2), holds_s=held, restarts=True),
        Fault("current of 1e300 A", ("outside",), BOUNDED, "huge current"),
    )
