"""The table of a model's terms: formulas with units, symbols that are defined beside it, and the force of each term."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from constructed_models import FREQUENCY, PLAY, STOP, constructed_damper, used
from constructed_models import LOW as LOW_CURRENT
from report_examples import TERMS, WIDE, damper, model

from ces_identify.structures.polynomial import (
    coefficient_unit,
    contributions,
    describe_input,
    describe_symbols,
    format_term,
    term_forces,
)
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.model import Model
from ces_observer.structures.constructed_inputs import Frequency, Hysteresis, Lag, TriangularMembership
from ces_observer.structures.polynomial import Factor, Term

VALVE = Lag("valve", "current", 0.01)
LOW = TriangularMembership("valve_low", "valve", None, 0.3, 0.9, VALVE)


def plain(html: object) -> str:
    return re.sub(r"<[^>]+>", "", str(html))


def using(*factors: Factor) -> Term:
    return Term(1.0, factors)


@pytest.mark.parametrize(
    ("term", "formula", "unit"),
    [
        (TERMS[0], "F(k−1)", "1"),
        (TERMS[1], "sgn v(k) · |v(k)|^0.5 · i(k−5)^2", "N (m/s)^−0.5 A^−2"),
        (TERMS[2], "v(k−2)", "N (m/s)^−1"),
        (TERMS[3], "|v(k)|^1.5", "N (m/s)^−1.5"),
        (TERMS[4], "i(k) · F(k−1)", "A^−1"),
        (TERMS[5], "1", "N"),
        (using(Factor("speed", 3, 0.0)), "sgn v(k−3)", "N"),
        (using(Factor("position", 0, 3.0)), "x(k)^3", "N m^−3"),
        (using(Factor("position", 0, 2.0)), "sgn x(k) · |x(k)|^2", "N m^−2"),
        (using(Factor("position", 0, 2.0, signed=False)), "x(k)^2", "N m^−2"),
        (using(used(STOP, 0, 0.5, True)), "sgn hysteresis(k) · |hysteresis(k)|^0.5", "N m^−0.5"),
        (using(used(PLAY, 3, 2.0)), "remanence(k−3)^2", "N A^−2"),
        (using(used(FREQUENCY, 0, 0.5), Factor("speed", 0)), "frequency(k)^0.5 · v(k)", "N Hz^−0.5 (m/s)^−1"),
        (using(used(LOW_CURRENT, 8), Factor("force", 1)), "by_current_1(k−8) · F(k−1)", "1"),
    ],
)
def test_a_term_is_typeset_with_its_unit(term: Term, formula: str, unit: str) -> None:
    assert plain(str(format_term(term, WIDE)).replace("<sup>", "^")) == formula
    assert plain(coefficient_unit(term).replace("<sup>", "^")).replace("\N{NO-BREAK SPACE}", " ") == unit


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


@pytest.fixture(scope="module")
def both() -> list[Evaluation]:
    return evaluate(model(), [damper("sine", seed=1), damper("road", seed=2, gaps=1)], VALIDATION)


@pytest.mark.parametrize("made", [model(), constructed_damper()], ids=["plain", "constructed"])
def test_term_forces_add_up_to_the_free_run(made: Model) -> None:
    for e in evaluate(made, [replace(damper("road", gaps=1), rate_Hz=made.sampling.rate_Hz)], VALIDATION):
        total = np.zeros(len(e.series))
        for start, values in term_forces(made.body, made, e):
            total[start : start + values.shape[1]] += values.sum(axis=0)
        np.testing.assert_allclose(total, e.run.force, rtol=1e-9, atol=1e-8)


def test_contribution_is_the_rms_of_the_term_on_scored_ticks(both: list[Evaluation]) -> None:
    rms, whole = contributions(model().body, model(), both)
    speed = np.concatenate([np.roll(e.series.speed, 2)[e.series.scored] for e in both])
    force = np.concatenate([e.run.force[e.series.scored] for e in both])
    assert rms[2] == pytest.approx(90.0 * np.sqrt(np.mean(speed**2)), rel=1e-9)
    assert rms[5] == pytest.approx(4.5, rel=1e-12)
    assert whole == pytest.approx(np.sqrt(np.mean(force**2)), rel=1e-12)
