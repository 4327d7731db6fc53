"""Every symbol in the table of a model's terms is defined beside it."""

from __future__ import annotations

import re

import pytest
from report_examples import TERMS, WIDE

from ces_identify.polynomial.term_table import describe_input, describe_symbols, format_term
from ces_observer.structures.constructed_inputs import Frequency, Hysteresis, Lag, TriangularMembership
from ces_observer.structures.terms import Factor, Term

VALVE = Lag("valve", "current", 0.01)
LOW = TriangularMembership("valve_low", "valve", None, 0.3, 0.9, VALVE)


def plain(html: object) -> str:
    return re.sub(r"<[^>]+>", "", str(html))


@pytest.mark.parametrize(
    "terms",
    [
        TERMS,
        (Term(1.0, (Factor("valve", 0, definition=VALVE), Factor("speed", 1, 0.5))),),
        (Term(1.0, (Factor("valve_low", 2, definition=LOW),)),),
    ],
)
def test_each_letter_of_a_formula_is_a_symbol_with_a_meaning(terms: tuple[Term, ...]) -> None:
    symbols = {plain(symbol): meaning for symbol, meaning in describe_symbols(terms, 500.0)}
    used = {word for term in terms for word in re.findall(r"[A-Za-z_]+", plain(format_term(term, WIDE)))}
    assert used <= set(symbols)
    assert all(symbols.values()) and symbols["k"] == "the tick: one every 2 ms"


def test_what_a_membership_is_computed_from_is_defined_before_it() -> None:
    names = [
        plain(symbol) for symbol, _ in describe_symbols([Term(1.0, (Factor("valve_low", 0, definition=LOW),))], 500.0)
    ]
    assert names == ["F", "k", "valve", "valve_low"]


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (VALVE, "current behind a first-order lag of 10 ms [A]"),
        (
            Hysteresis("h", "stop", "position", 0.002),
            "change of the position since its last reversal, limited to ±0.002 m",
        ),
        (Hysteresis("p", "play", "current", 0.1), "current with a play of ±0.1 A"),
        (Frequency("f", 0.5, (0.5, 20.0), 1e-4), "frequency of the motion over the last 0.5 s, within 0.5 to 20 Hz"),
        (LOW, "membership of valve: 1 at 0.3, falling to 0 at 0.9"),
    ],
)
def test_a_constructed_input_is_described_with_its_numbers(one: object, words: str) -> None:
    assert describe_input(one).startswith(words)  # type: ignore[arg-type]
