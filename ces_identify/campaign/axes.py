"""The axes that a campaign can vary, of one structure or of all, and its limits: allowed values and defaults."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ces_identify.campaign.plan import AUTO, BUILT_IN, Setting
from ces_identify.polynomial.search_limits import BOTH, METHODS
from ces_identify.structures import KITS
from ces_identify.structures.kit import SizeOption
from ces_identify.structures.polynomial import POLYNOMIAL


@dataclass(frozen=True)
class CampaignAxis:
    """An axis: a test for one value, the expected values in words, and the default values."""

    good: Callable[[Any], bool]
    expected: str
    default: tuple[Setting, ...]


def integer_between(low: int, high: int) -> Callable[[Any], bool]:
    """Return a test for a whole number in [low, high]."""
    return lambda value: isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def number_between(low: float, high: float) -> Callable[[Any], bool]:
    """Return a test for a finite number in [low, high]."""
    return lambda v: isinstance(v, int | float) and not isinstance(v, bool) and math.isfinite(v) and low <= v <= high


def number_between_or_auto(low: float, high: float) -> Callable[[Any], bool]:
    """Return a test for `auto` or a finite number in [low, high]."""
    return lambda value: value == AUTO or number_between(low, high)(value)


def text(check: Callable[[str], object]) -> Callable[[Any], bool]:
    """Return a test for a text, or a whole number as a text, that passes `check`, which raises ValueError."""

    def good(value: Any) -> bool:
        try:
            whole = isinstance(value, int) and not isinstance(value, bool)
            return (whole or isinstance(value, str)) and check(str(value)) is not None
        except ValueError:
            return False

    return good


def _size_axis(size: SizeOption) -> CampaignAxis:
    return CampaignAxis(
        integer_between(*size.whole) if size.whole else text(size.check), size.expected, (size.default,)
    )


STRUCTURES: Mapping[str, Mapping[str, CampaignAxis]] = {
    **{kit.option: {size.name: _size_axis(size) for size in kit.sizes} for kit in KITS.values()},
    POLYNOMIAL.option: {
        "terms": CampaignAxis(integer_between(1, 200), "whole numbers from 1 to 200", (15,)),
        "method": CampaignAxis(lambda value: value in METHODS, f"of {', '.join(METHODS)}", (BOTH,)),
        "candidates": CampaignAxis(lambda value: isinstance(value, str), f"{BUILT_IN} or rules files", (BUILT_IN,)),
    },
}
COMMON: Mapping[str, CampaignAxis] = {
    "rate_Hz": CampaignAxis(number_between_or_auto(1.0, 1e5), f"{AUTO} or numbers from 1 to 1e+05", (AUTO,)),
    "bandwidth_Hz": CampaignAxis(number_between_or_auto(0.01, 5e4), f"{AUTO} or numbers from 0.01 to 5e+04", (AUTO,)),
    "certificate": CampaignAxis(lambda value: isinstance(value, bool), "of true and false", (True,)),
    "seeds": CampaignAxis(integer_between(0, 2**31), "whole numbers from 0 to 2147483648", (1,)),
}
LIMITS: Mapping[str, CampaignAxis] = {
    "seconds": CampaignAxis(number_between(0.1, 1e6), "a number from 0.1 to 1e+06", (60.0,)),
    "target": CampaignAxis(number_between(0.0, 100.0), "a number from 0 to 100", (0.0,)),
    "starts": CampaignAxis(integer_between(1, 10000), "a whole number from 1 to 10000", (1,)),
    "threads": CampaignAxis(integer_between(1, 256), "a whole number from 1 to 256", (1,)),
}
