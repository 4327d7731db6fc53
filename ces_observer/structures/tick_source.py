"""The source text of a polynomial model's tick: a model goes in, a function written for it alone comes out as text.

`ces_observer.structures.polynomial` compiles it, as `dataclasses` and `namedtuple` compile theirs: a tick without loops
or look-ups is more than three times as fast. Nothing a file says reaches the text but numbers, and these only as the
`repr` of a checked `float` or `int`; every name in it is one of those below with a count behind it. A constructed
input is `made0`, `made1`, ... whatever its model calls it. In the text of a tick

    size_speed  |speed|            power3  another power of a signal, in one of FORMS
    speed_2     speed 2 ticks ago  force_1  the model's own force at the tick before
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

Power = tuple[str, float, bool]  # signal as the text calls it, power, signed


def tick_source(polynomial: Sequence[Term], within: OperatingRange) -> str:
    """Return the text of `make(run, arrive) -> tick, pasts, forces`, for one run of a polynomial's terms.

    `tick(position, speed, current)` returns the force [N], infinite outside the force envelope, and sets
    `run.clamped`; `arrive` is that of the terms' Construction. Emptying the `pasts` and filling `forces` with zeros
    begins anew. Needs abs, min, max, sqrt, copysign, inf and deque as globals. Raises ModelError for a number that is
    not finite or a signal that is unknown.
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
            "def make(run, arrive):",
            *(f"    past_{name} = deque(maxlen={lag + 1})" for name, lag in lags.items()),
            f"    forces = deque(maxlen={max((term.output_lag for term in terms), default=0)})",
            "    def tick(position, speed, current):",
            *(f"        {line}" for line in tick),
            f"    return tick, [{', '.join(f'past_{name}' for name in lags)}], forces",
            "",
        ]
    )


class _Product:
    """A term as the text has it: its coefficient, the lag of its past force, and names and lags of its inputs."""

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
    """Return `value` as a float proper, whose text is a number's and nothing else."""
    value = float(value)
    if not isfinite(value):
        raise ModelError(f"{what} of the model is {value!r}; expected a finite number: identify the model anew")
    return value


def _lags(terms: Iterable[_Product]) -> dict[str, int]:
    """Return the longest lag of each name that is used with one: the last of its entries stays."""
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
    made = ", ".join(f"made{i}" for i in range(count))
    return [f"position, speed, current, {made} = arrive((position, speed, current))"] if count else []


def _powers(names: Mapping[Power, str]) -> list[str]:
    """Compute each power once; a signed one is the unsigned one, where there is that too, with its signal's sign."""
    sizes = sorted({signal for signal, power, signed in names if (power, signed) != (1.0, True)})
    lines = [f"size_{signal} = abs({signal})" for signal in sizes]
    for (signal, power, signed), name in names.items():
        form = FORMS.get(power, f"{{0}} ** {_number(power, 'a power')}").format(f"size_{signal}")
        if signed:
            form = f"copysign({names.get((signal, power, False), form)}, {signal})"
        lines += [f"{name} = {form}"] if power != 1.0 else []
    return lines


def _keep(lags: Mapping[str, int]) -> list[str]:
    """Push what is used again later; at the first tick, as if it had always been so."""
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
    """Add one term a line: a single expression of hundreds would be too deep for the compiler."""
    return [f"force {'+=' if i else '='} {term}" for i, term in enumerate(terms)] or ["force = 0.0"]


def _end(limits: Range, terms: Iterable[_Product]) -> list[str]:
    low, high = (_number(limit, "the force envelope") for limit in limits)
    keep = ["forces.appendleft(force)"] if any(term.output_lag for term in terms) else []
    return [*keep, f"return force if {low} <= force <= {high} else inf"]
