"""Writes the Python source of a polynomial model's tick: terms in, the text of a function for these terms out.

`ces_observer.structures.polynomial` compiles it, as `dataclasses` and `namedtuple` compile theirs: a tick without loops
or look-ups is more than three times as fast. Of a model file only numbers reach the text, as the `repr` of a checked
`float` or `int`; all names in it are those below, with a number. Constructed inputs are `made0`, `made1`, ...

    size_speed  |speed|            power3  another power of a signal, in one of FORMS
    speed_2     speed 2 ticks ago  force_1  the model's own force one tick ago
    past_speed  the speeds kept for the lags, newest first: a deque of fixed length, empty before the first tick
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import isfinite
from operator import index

from ces_observer.errors import ModelError
from ces_observer.structures.constructed_inputs import BASE
from ces_observer.structures.structure import OperatingRange, Range, Ranges
from ces_observer.structures.terms import Factor, Term, collect_constructed

FORMS = {0.0: "1.0", 0.5: "sqrt({0})", 1.0: "{0}", 1.5: "{0} * sqrt({0})", 2.0: "{0} * {0}"}

Power = tuple[str, float, bool]  # name of the signal in the text, power, signed


def tick_source(polynomial: Sequence[Term], within: OperatingRange) -> str:
    """Return the text of `make(run, update) -> tick, pasts, forces`, for one run of a polynomial's terms.

    `tick(position, speed, current)` returns the force [N], infinite outside the force envelope, and sets
    `run.clamped`; `update` is that of an InputConstructor. To restart, empty the `pasts` and fill `forces` with zeros.
    The text uses abs, min, max, sqrt, copysign, inf and deque as globals. Raises ModelError for a number that is not
    finite or an unknown signal.
    """
    constructed = collect_constructed(polynomial)
    signals = {one.name: f"made{i}" for i, one in enumerate(constructed)} | {signal: signal for signal in BASE}
    powers = sorted({_power(f, signals) for term in polynomial for f in term.inputs})
    names = {power: _name(i, power) for i, power in enumerate(powers)}
    terms = [_Product(term, signals, names) for term in polynomial]
    lags = _lags(terms)
    tick = [
        *_clamp(within.inputs),
        *_construct(len(constructed)),
        *_powers(names),
        *_keep(lags),
        *_recall(lags, terms),
        *_sum(terms),
        *_end(within.force_N, terms),
    ]
    return "\n".join(
        [
            "def make(run, update):",
            *(f"    past_{name} = deque(maxlen={lag + 1})" for name, lag in lags.items()),
            f"    forces = deque(maxlen={max((term.output_lag for term in terms), default=0)})",
            "    def tick(position, speed, current):",
            *(f"        {line}" for line in tick),
            f"    return tick, [{', '.join(f'past_{name}' for name in lags)}], forces",
            "",
        ]
    )


class _Product:
    """A term in the text: its coefficient, the lag of its past force, and names and lags of its inputs."""

    def __init__(self, term: Term, signals: Mapping[str, str], names: Mapping[Power, str]) -> None:
        self.coefficient = _number(term.coefficient, "a coefficient")
        self.output_lag = index(term.output_lag)
        self.inputs = [(names[_power(f, signals)], index(f.lag)) for f in term.inputs]

    def __str__(self) -> str:
        past = [("force", self.output_lag)] if self.output_lag else []
        return " * ".join([self.coefficient, *(_ago(*value) for value in (*past, *self.inputs))])


def _power(factor: Factor, signals: Mapping[str, str]) -> Power:
    if factor.signal not in signals:
        raise ModelError(f"factor of {factor.signal!r}: no such signal; expected a definition, or one of {BASE}")
    return signals[factor.signal], _finite(factor.power, "a power"), bool(factor.signed)


def _name(i: int, power: Power) -> str:
    match power:
        case signal, 1.0, True:
            return signal
        case signal, 1.0, False:
            return f"size_{signal}"
    return f"power{i}"


def _ago(name: str, lag: int) -> str:
    return f"{name}_{lag}" if lag else name


def _number(value: float, what: str) -> str:
    return repr(_finite(value, what))


def _finite(value: float, what: str) -> float:
    """Return `value` as a plain finite float, whose `repr` can only be a number."""
    value = float(value)
    if not isfinite(value):
        raise ModelError(f"{what} of the model is {value!r}; expected a finite number: identify the model again")
    return value


def _lags(terms: Iterable[_Product]) -> dict[str, int]:
    """Return the longest lag of each name that has one: the last of its sorted entries stays."""
    return {name: lag for name, lag in sorted(value for term in terms for value in term.inputs) if lag}


def _clamp(inputs: Ranges) -> list[str]:
    bounds = {signal: [_number(bound, f"the envelope of {signal}") for bound in inputs[signal]] for signal in BASE}
    return [
        "if " + " and ".join(f"{low} <= {signal} <= {high}" for signal, (low, high) in bounds.items()) + ":",
        "    run.clamped = False",
        "else:",
        "    run.clamped = True",
        *(f"    {signal} = min(max({signal}, {low}), {high})" for signal, (low, high) in bounds.items()),
    ]


def _construct(count: int) -> list[str]:
    names = ", ".join(f"made{i}" for i in range(count))
    return [f"position, speed, current, {names} = update((position, speed, current))"] if count else []


def _powers(names: Mapping[Power, str]) -> list[str]:
    """Compute each power once; a signed power copies the sign to the unsigned one if that is used, too."""
    sizes = sorted({signal for signal, power, signed in names if (power, signed) != (1.0, True)})
    lines = [f"size_{signal} = abs({signal})" for signal in sizes]
    for (signal, power, signed), name in names.items():
        form = FORMS.get(power, f"{{0}} ** {_number(power, 'a power')}").format(f"size_{signal}")
        if signed:
            form = f"copysign({names.get((signal, power, False), form)}, {signal})"
        lines += [f"{name} = {form}"] if power != 1.0 else []
    return lines


def _keep(lags: Mapping[str, int]) -> list[str]:
    """Push the values used later; at the first tick, fill the past with them."""
    first = [f"    past_{name}.extend([{name}] * {lag})" for name, lag in lags.items()]
    begin = [f"if not past_{next(iter(lags))}:", *first] if lags else []
    return begin + [f"past_{name}.appendleft({name})" for name in lags]


def _recall(lags: Mapping[str, int], terms: Iterable[_Product]) -> list[str]:
    used = sorted({value for term in terms for value in term.inputs if value[1]})
    forces = sorted({term.output_lag for term in terms} - {0})
    return [
        *(f"{_ago(name, lag)} = past_{name}[{lag}]" for name, lag in used),
        *(f"{_ago('force', lag)} = forces[{lag - 1}]" for lag in forces),
    ]


def _sum(terms: Iterable[_Product]) -> list[str]:
    """Add one term per line: a single expression of hundreds is too deep for the compiler."""
    return [f"force {'+=' if i else '='} {term}" for i, term in enumerate(terms)] or ["force = 0.0"]


def _end(limits: Range, terms: Iterable[_Product]) -> list[str]:
    low, high = (_number(limit, "the force envelope") for limit in limits)
    keep = ["forces.appendleft(force)"] if any(term.output_lag for term in terms) else []
    return [*keep, f"return force if {low} <= force <= {high} else inf"]
