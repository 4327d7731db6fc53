"""What is doubted about the columns of a log, as programs and as scripts say it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

from ces_data.logs.log_file import join_names
from ces_data.mapping.choice import PASSIVE
from ces_data.mapping.rating import GUESSED
from ces_observer.errors import Words
from ces_observer.signals import UNITS

GIVE_RATE = "give --rate HZ"
GIVE_SCALE = "give its scale"
NO_TIME = "no column is named like a time and goes forward"
NO_NUMBER = ("expected a number", "has to go)")  # ends of reasons that no mapping resolves
NOT_READ = "; it is not read"
WAY = "; 'ces import {} --propose > my.yaml' writes a mapping to correct, for --mapping my.yaml"
BY_SCRIPT, BY_FRAME = " in Recording.load", " in Recording.from_frame"
HINTS = (PASSIVE, GIVE_RATE)  # of programs, at the end of a reason


def tell_doubts(
    doubts: Sequence[str],
    missing: Collection[str],
    faults: Collection[str],
    by_program: str,
    by_script: Callable[[Sequence[str]], str],
) -> Words:
    """Return the first of some doubts, or all of them that say what is `missing`, for programs and for scripts.

    Each ends with its remedy, which `faults` have not.
    """
    first = doubts[0]
    shown = [d for d in doubts if d in missing and d not in faults]
    shown = shown if first in shown else [first]
    remedies = ("", "") if first in faults else (by_program, by_script(shown))
    texts = (describe_doubts(shown, hints).replace(f": {GUESSED}", ": perhaps ") for hints in (HINTS, ()))
    return Words(*(text + remedy for text, remedy in zip(texts, remedies, strict=True)))


def describe_doubts(doubts: Iterable[str], hints: Iterable[str] = HINTS) -> str:
    """Return doubts in one text, signals of one reason together, with those of these hints that are in it."""
    signals_by_reason: dict[str, list[str]] = {}
    given = []
    for doubt in doubts:
        signal, _, why = doubt.partition(": ")
        for hint in (hint for hint in HINTS if why.endswith(f"; {hint}")):
            why = why.removesuffix(f"; {hint}")
            given += [hint] if hint in hints else []
        signals_by_reason.setdefault(why, []).append(signal)
    texts = [f"{' and '.join(signals)}: {why}" for why, signals in signals_by_reason.items()]
    return "; ".join([*texts, *given])


def script_remedy(found: Mapping[str, Any], names: Sequence[str], where: str, doubts: Sequence[str]) -> str:
    """Return how a script says what was not found, or not certain, for the end of an error; '' if it cannot.

    `found` is the content of the proposed mapping, `names` are the columns, `where` names the function.
    """
    sources: dict[str, Any] = {}
    for doubt in doubts:
        signal, _, why = doubt.partition(": ")
        own = found.get(signal)
        known = own if isinstance(own, Mapping) else {}
        column = known.get("column", "NAME")
        if GIVE_SCALE in why:
            sources[signal] = {"column": column, "scale": f"{UNITS[signal]} per unit"}
        elif signal == "current" or (signal == "time" and NO_TIME in why):
            sources[signal] = column
        elif signal in UNITS:  # with the usual one of logs
            sources[signal] = {"column": column, "unit": known.get("unit", UNITS[signal].replace("m", "mm", 1))}
    if not sources:
        return ""
    of = f"; of {join_names(names)}" if names and "NAME" in repr(sources) else ""
    others = ["'current': 0.0 for a passive damper"] if "current" in sources else []
    others += ["'rate': 1000 [Hz] without a time"] if "time" in sources else []
    own = "its scale" if GIVE_SCALE in doubts[0] else "its unit" if f": {GUESSED}" in doubts[0] else "which it is"
    what = "which they are" if len(sources) > 1 else own
    return f"{of}; say {what}{where}: columns={sources}" + "".join(f", or {other}" for other in others)
