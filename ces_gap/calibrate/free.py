"""Which parameters of a simulation are fitted, and within which range: `--fit NAME[=LOW..HIGH]` in, bounds out."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from ces_gap.effects.effect import EffectParameter
from ces_gap.errors import GapError
from ces_gap.limits import ParameterLimits
from ces_identify.simulations.parameters import Parameter
from ces_identify.simulations.simulation import Simulation
from ces_observer.errors import OptionName

NONE = "none"  # as the only word of --fit: all parameters stay as they are
WORD = re.compile(r"([^=]+)(?:=(.+)\.\.(.+))?")


@dataclass(frozen=True)
class FreeParameters:
    """What is fitted: `numbers` continuously, `whole` ones by trying each value; `notes` say why others are not."""

    numbers: tuple[EffectParameter, ...]
    whole: Mapping[str, tuple[int, ...]]
    notes: tuple[str, ...] = ()

    @property
    def trials(self) -> list[dict[str, float]]:
        """Every combination of the whole numbers; one without any if there are none."""
        return [dict(zip(self.whole, map(float, values), strict=True)) for values in product(*self.whole.values())]


def choose_free(simulation: Simulation, words: Sequence[str], spec: str) -> FreeParameters:
    """Return the parameters that `words` (NAME or NAME=LOW..HIGH) name, all that can be fitted if there are none.

    Raises GapError for an unknown name, a range that is none, and a default that gives no range.
    """
    declared = {p.name: p for p in simulation.parameters}
    if list(words) == [NONE]:
        return FreeParameters((), {})
    ranges = dict(map(_read_word, words))
    for name in ranges:
        if name not in declared:
            has = f"it has {', '.join(declared)}" if declared else "it declares none by keyword-only arguments"
            raise GapError(OptionName("fit", name), f": {spec} has no such parameter; {has}")
    chosen = [p for p in declared.values() if not ranges or p.name in ranges]
    skipped = {p.name: _why_not(p) for p in chosen if ranges.get(p.name) is None and _why_not(p)}
    if ranges and skipped:
        name, why = next(iter(skipped.items()))
        raise GapError(OptionName("fit", name), f": {why}")
    whole = {p.name: _whole_values(p, ranges[p.name]) for p in chosen if p.whole and p.name not in skipped}
    free = FreeParameters(
        tuple(_as_searched(p, ranges.get(p.name)) for p in chosen if not p.whole and p.name not in skipped),
        whole,
        tuple(f"{name} is not fitted: {why}" for name, why in skipped.items()),
    )
    if len(free.trials) > ParameterLimits.MAX_TRIALS:
        most = f"expected at most {ParameterLimits.MAX_TRIALS}"
        raise GapError(OptionName("fit"), f": {len(free.trials)} combinations of whole numbers; {most}")
    return free


def _read_word(word: str) -> tuple[str, tuple[float, float] | None]:
    match = WORD.fullmatch(word)
    try:
        if match is None:
            raise ValueError
        if match[2] is None:
            return match[1], None
        low, high = float(match[2]), float(match[3])
        if not (math.isfinite(low) and math.isfinite(high) and low < high):
            raise ValueError
    except ValueError:
        expected = ": expected NAME or NAME=LOW..HIGH, as knee_m_s=0.05..0.3"
        raise GapError(OptionName("fit", word), expected) from None
    return match[1], (low, high)


def _why_not(p: Parameter) -> str:
    """Return why a parameter cannot be fitted without a range, empty if it can."""
    if p.whole:
        return f"it is a whole number ({p.default:g}); give {p.name}=LOW..HIGH to try each, or write {p.default:g}.0"
    if p.default == 0.0 and not (math.isfinite(p.low) and math.isfinite(p.high)):
        return f"its default of 0 gives no range; give {p.name}=LOW..HIGH"
    return ""


def _whole_values(p: Parameter, ends: tuple[float, float] | None) -> tuple[int, ...]:
    low, high = ends or (p.low, p.high)
    return tuple(range(math.ceil(low), math.floor(high) + 1))


def _as_searched(p: Parameter, ends: tuple[float, float] | None) -> EffectParameter:
    """Return the parameter with its scale and bounds: logarithmic where all of them are positive."""
    around = sorted((p.default / ParameterLimits.RANGE_FACTOR, p.default * ParameterLimits.RANGE_FACTOR))
    low, high = ends or (max(p.low, around[0]), min(p.high, around[1]))
    if not ends and p.default == 0.0:
        low, high = p.low, p.high
    start = min(max(p.default, low), high)
    if not low < high or start != p.default:
        given = OptionName("fit", f"{p.name}={low:g}..{high:g}")
        raise GapError(given, f": expected a range around its default of {p.default:g}")
    return EffectParameter(p.name, low, high, (start,), f"default {p.default:.4g}", "log" if low > 0.0 else "linear")
