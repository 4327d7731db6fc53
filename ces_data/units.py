"""Units that logs state: their spellings, what they measure, and the factor to SI.

A spelling such as `mm` or `km/h`, or the name of a column such as `Kraft [kN]` or `x_mm`, goes in; a `Unit` comes out.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

INCH_M, POUND_N, GRAVITY_M_S2 = 0.0254, 4.4482216152605, 9.80665
QUANTITIES = {  # what each signal may be measured in; a voltage may take the place of the current, with a scale only
    "position": ("length",),
    "current": ("current", "voltage"),
    "force": ("force",),
    "sim_force": ("force",),
    "temperature": ("temperature",),
    "speed": ("speed",),
    "acceleration": ("acceleration",),
    "time": ("time",),
}


@dataclass(frozen=True)
class Unit:
    """A unit: value in SI = scale * number + offset. `quantity` is what it measures, such as `length`."""

    text: str
    quantity: str
    scale: float
    offset: float = 0.0


def ask_for_amperes(unit: Unit) -> str:
    """Return what a voltage in the place of a current needs, for the end of a message."""
    return f"no current; give its scale in A per {unit.text} (scale: {unit.scale:g} takes volts in its place)"


TABLE = {  # by quantity: the factor to SI of each unit, and its further spellings
    "length": {
        "m": (1.0, "metre meter"),
        "mm": (1e-3, "millimeter millimetre"),
        "cm": (1e-2, "centimeter centimetre"),
        "um": (1e-6, "µm μm micrometer micrometre"),
        "in": (INCH_M, 'inch inches "'),
        "mil": (1e-3 * INCH_M, "mils thou"),
        "ft": (0.3048, "feet foot"),
    },
    "force": {
        "N": (1.0, "newton newtons"),
        "kN": (1e3, "KN kilonewton"),
        "daN": (10.0, "decanewton"),
        "lbf": (POUND_N, "lb lbs"),
        "kip": (1e3 * POUND_N, "kips"),
        "kgf": (GRAVITY_M_S2, "kp"),
    },
    "current": {"A": (1.0, "amp amps ampere amperes"), "mA": (1e-3, "milliampere milliamperes")},
    "voltage": {"V": (1.0, "volt volts"), "mV": (1e-3, "millivolt millivolts")},
    "speed": {
        "m/s": (1.0, "m_s mps m/sec m*s^-1 ms-1 m·s⁻¹"),
        "mm/s": (1e-3, "mm_s mmps mm/sec"),
        "cm/s": (1e-2, "cm_s cm/sec"),
        "in/s": (INCH_M, "in_s ips in/sec"),
        "km/h": (1.0 / 3.6, "kph kmh"),
    },
    "acceleration": {
        "m/s2": (1.0, "m_s2 m/s^2 m/s² mps2 m/s/s"),
        "mm/s2": (1e-3, "mm_s2 mm/s^2 mm/s²"),
        "g": (GRAVITY_M_S2, "g0 gn"),
    },
    "time": {
        "s": (1.0, "sec secs second seconds sek"),
        "ms": (1e-3, "msec millisecond milliseconds"),
        "us": (1e-6, "µs μs usec microsecond microseconds"),
        "ns": (1e-9, "nsec nanosecond nanoseconds"),
        "min": (60.0, "minute minutes"),
        "h": (3600.0, "hour hours"),
        "d": (86_400.0, "day days"),
    },
    "temperature": {
        "degC": (1.0, "°C C ℃ celsius deg_C"),
        "K": (1.0, "kelvin"),
        "degF": (5.0 / 9.0, "°F F ℉ fahrenheit deg_F"),
    },
}
IMPERIAL = frozenset(("in", "mil", "ft", "lbf", "kip"))
OFFSETS = {"K": -273.15, "degF": -160.0 / 9.0}
UNITS_BY_SPELLING = {
    spelling: Unit(text, quantity, scale, OFFSETS.get(text, 0.0))
    for quantity, texts in TABLE.items()
    for text, (scale, others) in texts.items()
    for spelling in (text, *others.split())
}
BY_FOLDED_SPELLING = {spelling.casefold(): unit for spelling, unit in UNITS_BY_SPELLING.items() if len(spelling) > 2}
BARE = re.compile(r"[_ ](m_s2|mm_s2|m_s|mm_s|cm_s|in_s|deg_?C|deg_?F|[A-Za-z]+)$")
BRACKETED = re.compile(r"[\[(<{]\s*([^\[\](){}<>]+?)\s*[\])>}]\s*$")
INNER = re.compile(r"[\[(<{]\s*([^\[\](){}<>]+?)\s*[\])>}](?=\s*[-/|:;,.])")  # `Displacement (mm) - Voltage_0`
SLASHED = re.compile(r"[A-Za-z_]\s*/\s*([A-Za-zµμ°]+(?:/[a-z]+[2²]?)?)$")
NEVER_BARE = frozenset(  # words as often as units: `x_in`, `T_min`
    ("in", "C", "F", "K", "lb", "min", "g0", "kp", "feet", "foot", "h", "d")
)


def find_unit(text: str) -> Unit | None:
    """Return the unit of this spelling, None if it is not known."""
    stripped = text.strip().strip("[](){}<>").strip()
    return UNITS_BY_SPELLING.get(stripped) or BY_FOLDED_SPELLING.get(stripped.casefold())


def split_unit(name: str) -> tuple[str, Unit | None]:
    """Split the name of a column into its name without unit and the unit, such as `x_mm` or `Force [kN]`."""
    for pattern in (BRACKETED, SLASHED, BARE):
        match = pattern.search(name)
        if match is None or (pattern is BARE and match.group(1) in NEVER_BARE):
            continue
        unit = find_unit(match.group(1).replace("deg_", "deg"))
        if unit is not None:
            return name[: match.start(1)].rstrip("[({<_/ "), unit
    for match in INNER.finditer(name):
        if unit := find_unit(match.group(1)):
            return f"{name[: match.start()].rstrip()}{name[match.end() :]}", unit
    return name, None
