"""What names say: the quantity that the words of a topic, field or column mean, and the damper that they belong to."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

STRONG = {
    "position": "position displacement stroke travel lvdt deflection weg hub elongation extension potentiometer "
    "linearpot verschiebung",
    "current": "current currents amp amps ampere amperes curr strom solenoid coil",
    "force": "force forces load loadcell kraft effort",
    "temperature": "temperature temp temperatur",
    "speed": "velocity speed vel geschwindigkeit",
    "acceleration": "acceleration acc accel beschleunigung",
    "time": "time timestamp stamp zeit seconds t",
}
WEAK = {
    "position": "pos disp x dx xd d s z pot piston",
    "current": "i ia iv valve cur",
    "force": "f fz fx fd cell",
    "temperature": "oil thermocouple",
    "speed": "v vz dv dx_dt xdot",
    "acceleration": "a az",
    "time": "sec s ts clock elapsed abtast",
}
COMMANDS = frozenset(
    (
        *("cmd", "command", "commanded", "commands", "setpoint", "set", "sp", "target", "desired", "wanted"),
        *("ref", "reference", "soll", "demand", "request", "goal"),
    )
)
COMMAND_PARTS = ("cmd", "command", "soll", "setpoint", "target")  # also at an end of a word: `xcmd`
COMPUTED = frozenset(
    ("estimate", "estimated", "estimator", "sim", "simulated", "simulation", "predicted", "model", "observer", "band")
)
FOREIGN = frozenset(
    (
        *("battery", "torque", "moment", "pressure", "gps", "latitude", "longitude", "altitude", "covariance", "fuel"),
        *("orientation", "quaternion", "angular", "gyro", "imu", "magnetic", "wheel", "steering", "engine", "rpm"),
        *("odom", "odometry", "pose", "twist", "brake", "throttle", "gear", "counter", "sequence", "error", "status"),
        *("yaw", "roll", "pitch", "humidity", "variance"),
    )
)
DEVICE = frozenset(
    ("damper", "shock", "strut", "suspension", "fork", "piston", "absorber", "daempfer", "dämpfer", "stossdämpfer")
)
OUTWARD = frozenset(("extension", "elongation", "rebound", "zug", "ausfederung", "extended"))
SIDES = frozenset(
    (
        *("front", "rear", "left", "right", "fl", "fr", "rl", "rr", "lf", "rf", "lr", "f", "r", "l", "fore", "aft"),
        *("vorne", "vorn", "hinten", "links", "rechts", "vl", "vr", "hl", "hr", "a", "b"),
    )
)
WORD = re.compile(r"[A-Z]+(?![a-zäöü])|[A-ZÄÖÜ]?[a-zäöü]+|\d+")


@dataclass(frozen=True)
class NameMeaning:
    """The quantity that a name says, '' if none, how strongly (0 to 3), and the word that says it."""

    quantity: str
    weight: float
    word: str


def split_words(text: str) -> tuple[str, ...]:
    """Return the words of a name in lower case, split at underscores, digits and capitals."""
    return tuple(word.casefold() for word in WORD.findall(text))


def list_words(names: Sequence[str]) -> set[str]:
    """Return the words of all names."""
    return {word for name in names for word in split_words(name)}


def read_meaning(names: Sequence[str]) -> NameMeaning:
    """Return what the names say, the most specific first: strong words of any before weak ones."""
    for table, weight in ((STRONG, 3.0), (WEAK, 1.5)):
        for name in names:
            meaning = _find(split_words(name), table, weight)
            if meaning:
                return meaning
    return NameMeaning("", 0.0, "")


def _find(words: Sequence[str], table: dict[str, str], weight: float) -> NameMeaning | None:
    """Return the quantity of the first word that has one; the last word of a name says what it is."""
    for word in reversed(words):
        for quantity, texts in table.items():
            if word in texts.split():
                return NameMeaning(quantity, weight, word)
    return None


def find_word(names: Sequence[str], words: frozenset[str], ends: tuple[str, ...] = ()) -> str:
    """Return the first word of the names that is one of `words` or begins or ends with one of `ends`, else ''."""
    return next(
        (
            word
            for name in names
            for word in split_words(name)
            if word in words or (ends and (word.startswith(ends) or word.endswith(ends)))
        ),
        "",
    )


def find_side(names: Sequence[str], others: Sequence[str]) -> str:
    """Return the words by which two names of the same form differ if they are all sides or numbers, else ''.

    `/front/damper/stroke` beside `/rear/damper/stroke` is `front`, `damper_1` beside `damper_2` is `1`.
    """
    mine, theirs = (tuple(word for name in some for word in split_words(name)) for some in (names, others))
    if len(mine) != len(theirs):
        return ""
    different = [(one, other) for one, other in zip(mine, theirs, strict=True) if one != other]
    if not all(word in SIDES or word.isdigit() for pair in different for word in pair):
        return ""
    return "_".join(dict.fromkeys(one for one, _ in different))


def name_sides(group: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return a name for each of several dampers whose names have one form: the words that are not the same in all.

    `front_left`, `front_right`, `rear_left` and `rear_right` for the four of a car.
    """
    words = [tuple(word for name in names for word in split_words(name)) for names in group]
    different = [len(set(column)) > 1 for column in zip(*words, strict=True)]
    return tuple("_".join(dict.fromkeys(compress(mine, different))) for mine in words)
