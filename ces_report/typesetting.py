"""Numbers, names, signals and curves in reports."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray

F = NDArray[np.float64]

SYMBOLS = {"force": "F", "speed": "v", "current": "i", "position": "x"}
MAX_NAMES = 5  # of recordings in a title
MAX_NAMES_LENGTH = 120  # characters of those names together
MAX_FIGURES = 7  # of an end of a range
MAX_ROUNDED = 0.25  # of a number, that rounding may change
MAX_DIGITS = 5  # behind the point; more are a power of ten
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
UNITS = {"speed": "m/s", "current": "A", "position": "m", "frequency": "Hz"}
MEANINGS = {
    "speed": "speed [m/s], positive in compression",
    "current": "current [A]",
    "position": "position [m], positive in compression",
    "force": "force [N]: on the right-hand side the model’s own past output",
}
Symbols = tuple[tuple[Markup, str], ...]


@dataclass(frozen=True)
class ChartCurve:
    """A curve y(x) with the half width of its 95 % interval, each (n,); `recorded` is the range of x with data.

    `points` are x and y of `dots`, each (k,).
    """

    name: str
    x: F
    y: F
    half: F
    recorded: tuple[float, float]
    points: tuple[F, F] | None = None
    dots: str = "measured"


@dataclass(frozen=True)
class Chart:
    """Curves in one plot with labels of its axes, and a caption; several curves rise with their order."""

    title: str
    x_label: str
    y_label: str
    curves: tuple[ChartCurve, ...]
    caption: str


def describe_signals(signals: Iterable[str], rate_Hz: float) -> Symbols:
    """Return the symbols of the logged signals and of the tick with their meanings, in a fixed order."""
    used = set(signals)
    symbols = [(Markup("<var>{}</var>").format(SYMBOLS[s]), meaning) for s, meaning in MEANINGS.items() if s in used]
    return (*symbols, (Markup("<var>k</var>"), f"the tick: one every {1e3 / rate_Hz:.4g} ms"))


def signal_symbol(signal: str, lag: int) -> Markup:
    """Return the symbol of a signal at a lag, such as v(k - 1)."""
    ago = f"\N{MINUS SIGN}{lag}" if lag else ""
    return Markup('<span class="signal"><var>{}</var>(<var>k</var>{})</span>').format(SYMBOLS.get(signal, signal), ago)


def four_figures(value: float) -> str:
    """Return a number with four significant figures."""
    return minus(f"{value:.4g}")


def three_figures(value: float) -> str:
    """Return a number with three significant figures, `∞` if it is infinite, a dash if it is NaN."""
    if not math.isfinite(value):
        return "\N{INFINITY}" if math.isinf(value) else "\N{EN DASH}"
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def format_number(value: float, figures: int = 3) -> str:
    """Return a number to some significant figures, with a power of ten if necessary; a dash if it is unknown."""
    if not math.isfinite(value):
        return minus("\N{EN DASH}" if math.isnan(value) else f"{value}".replace("inf", "\N{INFINITY}"))
    digits = f"{value:.{figures}g}"
    if "e" in digits and abs(value) >= 1.0:
        digits = f"{float(digits):,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}") if abs(value) < 1e7 else digits
    if "e" not in digits:
        return minus(digits)
    mantissa, power = digits.split("e")
    return minus(f"{mantissa}·10") + str(int(power)).translate(RAISED)


def format_decimal(value: float, figures: int = 3) -> str:
    """Return a number with `figures` significant figures and no power of ten; a dash if it is unknown."""
    if not math.isfinite(value):
        return "\N{EN DASH}"
    digits = figures - 1 - (math.floor(math.log10(abs(value))) if value else 0)
    return minus(f"{round(value, digits):.{max(digits, 0)}f}")


def format_spread(value: float, spread: float, figures: int = 3) -> str:
    """Return `value ± spread`, to one figure of the spread, two if it begins with 1 or 2; `figures` without spread."""
    if not (math.isfinite(value) and math.isfinite(spread) and spread > 0.0):
        return format_decimal(value, figures)
    return " ± ".join(_round_like(spread, value, spread))


def format_within(value: float, low: float, high: float, figures: int = 3) -> tuple[str, str]:
    """Return a value and its interval `low to high` with the digits that half the interval justifies.

    That is the rule of `format_spread`; where zero is not in the interval, whose ends may lie decades apart, what it
    would change by more than MAX_ROUNDED has two figures. An endless interval is `at least low`, `at most high` or a
    dash, as that without a number is, and the value has `figures`.
    """
    if math.isinf(low) != math.isinf(high):
        return format_number(value, figures), (
            f"at least {format_number(low, figures)}" if math.isinf(high) else f"at most {format_number(high, figures)}"
        )
    if not (math.isfinite(value + low + high) and low < high):
        return format_number(value, figures), format_range(low, high) if math.isfinite(low + high) else "\N{EN DASH}"
    most = math.inf if low <= 0.0 <= high else MAX_ROUNDED
    shown, *ends = _round_like(0.5 * (high - low), value, low, high, most=most)
    return shown, " to ".join(ends)


def _round_like(spread: float, *values: float, most: float = math.inf) -> list[str]:
    """Return values to the first figure of a spread, to the second if it begins with 1 or 2.

    A value has two figures where that would change it by more than `most` of it.
    """
    decade = math.floor(math.log10(spread))
    digits = (1 if spread < 3.0 * 10.0**decade else 0) - decade
    if digits > MAX_DIGITS:  # with a power of ten
        return [format_number(v, digits + 1 + math.floor(math.log10(abs(v))) if abs(v) > spread else 1) for v in values]
    changed = [abs(round(v, digits) - v) > most * abs(v) if v else False for v in values]
    places = [1 - math.floor(math.log10(abs(v))) if far else digits for v, far in zip(values, changed, strict=True)]
    return [minus(f"{round(v, n) + 0.0:.{max(n, 0)}f}") for v, n in zip(values, places, strict=True)]


def format_alike(values: Collection[float], figures: int = 4) -> list[str]:
    """Return numbers with the same decimals, so many figures of the largest; ASCII, for terminals."""
    largest = max(map(abs, values))
    power = math.floor(math.log10(largest)) if 0.0 < largest < math.inf else 0
    decimals = min(max(0, figures - 1 - power), 9)
    return [f"{round(value, decimals) + 0.0:.{decimals}f}" for value in values]  # no negative zero


def format_range(low: float, high: float) -> str:
    """Return `low to high` with as many figures as give it two ends; the one value if both are equal."""
    for figures in range(3, MAX_FIGURES + 1):
        ends = format_number(low, figures), format_number(high, figures)
        if ends[0] != ends[1]:
            return " to ".join(ends)
    return ends[0]


def minus(text: str) -> str:
    """Return `text` with true minus signs."""
    return text.replace("-", "\N{MINUS SIGN}")


def join_with(names: Sequence[str], last: str = "and") -> str:
    """Return `a, b and c`."""
    return f" {last} ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def join_names(names: Sequence[str]) -> str:
    """Return names as a list; of many, the first ones and how many more there are."""
    names = list(dict.fromkeys(names))
    fit = sum(length <= MAX_NAMES_LENGTH for length in accumulate(len(name) + 2 for name in names))
    shown = max(1, min(fit, MAX_NAMES))
    more = len(names) - shown
    most = len(names) if fit == len(names) and more <= 1 else shown
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if most < len(names) else "")
