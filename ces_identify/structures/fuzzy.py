"""Neuro-fuzzy models at the desk: starts by hybrid learning, errors and derivatives of a fit, sizes, report.

A start follows Jang (1993): memberships on a grid; then, in turn, consequents by least squares with measured past
forces and a descent of the premises on the same one-step error. The free-run fit that follows moves all parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise, product
from math import log
from typing import ClassVar

import numpy as np
from markupsafe import Markup

from ces_data.arrays import F, I
from ces_identify import training
from ces_identify.numerics import least_squares
from ces_identify.numerics.core import core_kernel
from ces_identify.prepare.series import SimulatedSeries
from ces_identify.structures.kit import StructureKit
from ces_identify.structures.lagged import LaggedShape
from ces_identify.training import RegressorTable, normal_equations
from ces_observer.model import Model
from ces_observer.options import Option
from ces_observer.structures.fuzzy import Bell, Fuzzy, Premise, Rule
from ces_observer.structures.lagged_signals import Regressor
from ces_observer.tick.fuzzy import (
    FUZZY_BELLS, FUZZY_CHOICES, FUZZY_FIRED, FUZZY_FIRINGS, FUZZY_LAYER, FUZZY_MEMBERSHIPS, FUZZY_OUTPUTS, FUZZY_OWNERS,
    FUZZY_PREMISES, FUZZY_RULES, FUZZY_SCALE, FUZZY_SHAPES, fuzzy_force,
)  # fmt: skip
from ces_observer.tick.lagged import LAGGED_PHI
from ces_report.table import Section, parameter_section
from ces_report.typesetting import (
    UNITS,
    describe_signals,
    four_figures,
    minus,
    signal_symbol,
)

FIRST_GAIN = 0.95  # largest gain of the past forces in a start
FIRST_SLOPE = 2.0
MIN_SLOPE, MAX_SLOPE = 0.6, 8.0  # of a membership
STIFFNESS = 1e-4  # [(J / 100)^2] cost of moving a membership by its own width
HYBRID_STEPS = 5
HYBRID_DAMPING = 1.0
MIN_SPEEDS = 3  # memberships of speed of the models from which larger ones grow
QUANTILES = (0.002, 0.998)  # of a premise: the ends of the grid
START_JITTER = 0.15  # standard deviation of a start's centres, in distances between neighbours


@core_kernel
def fill_fuzzy_slopes(p: F, n: I, s: F, y: float, past_lags: I, past_spreads: F, row: F, gains: F) -> None:
    """Fill `row` with the derivatives of a tick's force by the parameters, `gains` with those by the past forces.

    Parameters of R regressors: for each rule its constant and linear part (R), then for each membership its centre,
    log width and log slope.
    """
    scale, fired, premises, phi = p[FUZZY_SCALE], s[FUZZY_FIRED], n[FUZZY_PREMISES], n[LAGGED_PHI]
    layer, choice, output, firing = n[FUZZY_LAYER], n[FUZZY_CHOICES], n[FUZZY_OUTPUTS], n[FUZZY_FIRINGS]
    rules, r = n[FUZZY_RULES], len(gains) - premises
    bells = row[rules * (1 + r) :]
    bells[:] = 0.0
    gains[:] = 0.0
    at = 0
    for rule in range(rules):
        share = s[firing + rule] / fired
        part = scale * share
        row[at] = part
        for j in range(r):
            row[at + 1 + j] = part * s[phi + j]
            gains[j] += part * p[layer + j]
        pull = part * s[output + rule] - share * y  # of a rule on the force, through its memberships
        for q in range(premises):
            bells[3 * n[choice + q]] += pull
        at += 1 + r
        layer += 1 + r
        choice += premises
    for j in range(r):
        gains[j] /= past_spreads[j]
    shape, owner, membership = n[FUZZY_SHAPES], n[FUZZY_OWNERS], n[FUZZY_MEMBERSHIPS]
    for m in range(n[FUZZY_BELLS]):
        offset = s[phi + r + n[owner + m]] - p[shape]
        steep = bells[3 * m] * (1.0 - s[membership + m]) * p[shape + 2]
        bells[3 * m] = steep / offset if offset != 0.0 else 0.0
        bells[3 * m + 1] = steep
        bells[3 * m + 2] = -steep * log(abs(offset) / p[shape + 1]) if offset != 0.0 else 0.0
        shape += 3


@dataclass(frozen=True)
class PremiseGrid:
    """A premise: an input, its lag [ticks], and the number of memberships over its range."""

    signal: str
    lag: int
    memberships: int


@dataclass(frozen=True)
class FuzzyFit(training.Family):
    """Models on a `grid` of memberships; `decay` is the cost of a squared consequent in (J / 100)^2."""

    grid: tuple[PremiseGrid, ...]
    decay: float
    kernel: ClassVar = staticmethod(normal_equations(fuzzy_force, fill_fuzzy_slopes))

    @property
    def size(self) -> int:
        """Number of rules."""
        return len(self.rules)

    @cached_property
    def rules(self) -> I:
        """The membership that each rule uses of each premise: all combinations."""
        begins = np.cumsum([0, *(g.memberships for g in self.grid)])
        return np.array(list(product(*(range(a, b) for a, b in pairwise(begins)))), np.int64)

    @property
    def columns(self) -> tuple[Regressor, ...]:
        """The regressors, then the premises in SI units."""
        return (*self.regressors, *(Regressor(g.signal, g.lag, 0.0, 1.0) for g in self.grid))

    def parts(self, params: F) -> tuple[F, F]:
        """Return consequents (rules, 1 + R) and bells (memberships, 3)."""
        n = len(self.rules) * (1 + len(self.regressors))
        return params[:n].reshape(len(self.rules), -1), params[n:].reshape(-1, 3)

    @cached_property
    def grid_bells(self) -> F:
        """Centre, log width and log slope (memberships, 3) of an even grid over the range of each premise."""
        bells = []
        for g in self.grid:
            low, high = np.quantile(self.training.inputs[training.SIGNALS.index(g.signal)], QUANTILES)
            half = 0.5 * max(high - low, 1e-6) / max(1, g.memberships - 1)
            bells += [[c, np.log(half), np.log(FIRST_SLOPE)] for c in np.linspace(low, high, g.memberships)]
        return np.array(bells)

    def start(self, random: np.random.Generator) -> F:
        """Return parameters after hybrid learning from a randomly shifted grid."""
        bells = self.grid_bells.copy()
        bells[:, 0] += 2.0 * np.exp(bells[:, 1]) * random.normal(0.0, START_JITTER, len(bells))
        n = len(self.rules) * (1 + len(self.regressors))
        one_step = partial(self.normal_equations, training.with_measured_past(self.table, self.training))
        params = learn_hybrid(one_step, self.pull, np.concatenate([np.zeros(n), bells.ravel()]), n)
        past = self.parts(params)[0][:, 1 + self.past]
        past *= np.minimum(1.0, FIRST_GAIN / np.maximum(np.abs(past).sum(axis=1, keepdims=True), 1e-9))
        self.parts(params)[0][:, 1 + self.past] = past
        return params

    def smaller(self) -> FuzzyFit | None:
        """Return the models with two memberships of speed less, None below MIN_SPEEDS."""
        speed, *others = self.grid
        fewer = speed.memberships - 2
        return replace(self, grid=(replace(speed, memberships=fewer), *others)) if fewer >= MIN_SPEEDS else None

    def grow(self, smaller: FuzzyFit, params: F, random: np.random.Generator) -> F:
        """Return rules on the whole grid, each with the blend of the smaller model's consequents at its centre."""
        consequents, body = smaller.parts(params)[0], smaller.body(params)
        blended = []
        for members in self.rules:
            firings = np.array(body.firings([[x] for x in self.grid_bells[members, 0].tolist()]))
            blended.append(firings @ consequents / firings.sum())
        return np.concatenate([np.ravel(blended), self.grid_bells.ravel()])

    def normal_equations(self, table: RegressorTable, params: F, max_error: float) -> least_squares.NormalEquations:
        """Return the normal equations; memberships of extreme slopes are no model."""
        slopes = np.exp(self.parts(params)[1][:, 2])
        if slopes.min() < MIN_SLOPE or slopes.max() > MAX_SLOPE:
            return least_squares.NO_MODEL
        return super().normal_equations(table, params, max_error)

    @property
    def pull(self) -> least_squares.Penalty:
        """The pull of consequents towards 0, and of memberships towards those of the grid."""
        consequents = len(self.rules) * (1 + len(self.regressors))
        stiffness = np.full(self.grid_bells.shape, STIFFNESS)
        stiffness[:, 0] /= np.exp(2.0 * self.grid_bells[:, 1])
        centre = np.concatenate([np.zeros(consequents), self.grid_bells.ravel()])
        return least_squares.pull_towards(centre, np.concatenate([np.full(consequents, self.decay), stiffness.ravel()]))

    def gains(self, params: F) -> tuple[F, F]:
        """Return each rule's gain of the past forces (rules,) and its gradient (rules, parameters)."""
        consequents, _ = self.parts(params)
        past = consequents[:, 1 + self.past]
        slope = np.zeros((len(self.rules), len(params)))
        for r in range(len(self.rules)):
            slope[r, r * consequents.shape[1] + 1 + self.past] = np.sign(past[r])
        return np.abs(past).sum(axis=1), slope

    def body(self, params: F) -> Fuzzy:
        """Return the neuro-fuzzy rules with these parameters."""
        consequents, bells = self.parts(params)
        fitted = [Bell(*row) for row in np.column_stack([bells[:, 0], np.exp(bells[:, 1:])]).tolist()]
        begins = np.cumsum([0, *(g.memberships for g in self.grid)])
        premises = tuple(
            Premise(g.signal, g.lag, tuple(fitted[a : a + g.memberships]))
            for g, a in zip(self.grid, begins, strict=False)
        )
        rules = tuple(
            Rule(tuple(members), row[0], tuple(row[1:]))
            for members, row in zip((self.rules - begins[:-1]).tolist(), consequents.tolist(), strict=True)
        )
        return Fuzzy(self.regressors, self.training.scale_N, premises, rules)


def learn_hybrid(equations: least_squares.Equations, pull: least_squares.Penalty, params: F, consequents: int) -> F:
    """Return parameters after hybrid learning (Jang 1993): `consequents` by least squares, then the premises."""

    def move(point: least_squares.DescentPoint, part: slice, damping: float) -> F:
        moved = point.params.copy()
        moved[part] += least_squares.damped_step(point.total.matrix[part, part], point.total.gradient[part], damping)
        return moved

    first, point = slice(consequents), least_squares.evaluate(equations, [pull], params)
    for _ in range(HYBRID_STEPS):
        solved = point and least_squares.evaluate(equations, [pull], move(point, first, 0.0))
        if solved is None:
            break
        premises = move(solved, slice(consequents, None), HYBRID_DAMPING)
        point = least_squares.evaluate(equations, [pull], premises, solved.value) or solved
    return params if point is None else point.params


MAX_RULES = 60
STROKES = 3  # memberships of the position
CURRENT_AND_SPEED = training.LagCounts(0, 1, 1)  # the inputs of the thesis' neuro-fuzzy models, at the present tick


@dataclass(frozen=True)
class FuzzyShape(LaggedShape):
    """The size of a neuro-fuzzy model (Jang 1993): memberships of speed (at most) and current, a rule for each pair."""

    option: ClassVar[str] = Fuzzy.option
    speeds: int = 7
    currents: int = 2
    current_delay_s: float = 0.008  # of the current in the premises
    lags: training.Lags | training.LagCounts | None = None
    decay: float = training.DECAY
    strokes: int = 1

    def with_inputs(self, lags: training.Lags | training.LagCounts, stroke: bool) -> FuzzyShape:
        """Return the shape with these lags, and with memberships of the position unless its grid is small."""
        strokes = STROKES if stroke and self.speeds > MIN_SPEEDS else 1
        speeds = min(self.speeds, MAX_RULES // (strokes * self.currents))
        return replace(self, lags=lags, strokes=strokes, speeds=speeds)

    def family(self, data: training.Training, rate_Hz: float) -> FuzzyFit:
        """Return the neuro-fuzzy models of this size for the data."""
        grid = [PremiseGrid("speed", 0, self.speeds)]
        if self.currents > 1 and "current" in data.changing_inputs():
            grid.append(PremiseGrid("current", round(self.current_delay_s * rate_Hz), self.currents))
        if self.strokes > 1:
            grid.append(PremiseGrid("position", 0, self.strokes))
        regressors = training.build_regressors(data, self.lags or training.LAG_SETS[0], rate_Hz)
        return FuzzyFit(data, regressors, tuple(grid), self.decay)


def read_grid(text: str) -> tuple[int, int]:
    """Return the numbers of memberships of speed and current in `VxI`; raises ValueError."""
    speeds, _, currents = text.partition("x")
    if not (speeds.isdecimal() and currents.isdecimal() and int(speeds) >= 2 and int(currents) >= 1):
        raise ValueError(f"'{text}' is not VxI, such as 7x2, with at least 2 of speed and 1 of current")
    if int(speeds) * int(currents) > MAX_RULES:
        raise ValueError(f"'{text}' makes {int(speeds) * int(currents)} rules; at most {MAX_RULES}")
    return int(speeds), int(currents)


def fuzzy_table(fuzzy: Fuzzy, model: Model, runs: Sequence[SimulatedSeries], role: str) -> Section:
    """Return the rules: where each applies, and the force for a change of each regressor."""
    about = (
        f"A neuro-fuzzy model of {len(fuzzy.rules)} rules, each an affine model near the values named. "
        "Numbers: force [N] for a change of a regressor by one standard deviation."
    )
    heads = ("Rule near", "Constant [N]", *(signal_symbol(r.signal, r.lag) for r in fuzzy.regressors))
    rows = []
    for rule in fuzzy.rules:
        near = [
            Markup("{} = {} {}").format(
                signal_symbol(p.signal, p.lag), minus(f"{p.memberships[m].centre:.3g}"), UNITS[p.signal]
            )
            for p, m in zip(fuzzy.premises, rule.memberships, strict=True)
        ]
        forces = (four_figures(fuzzy.scale_N * number) for number in (rule.constant, *rule.linear))
        rows.append((Markup(", ").join(near), *forces))
    symbols = describe_signals((r.signal for r in fuzzy.regressors), model.sampling.rate_Hz)
    return parameter_section(about, heads, rows, symbols)


RULES = Option(
    "rules",
    f"{FuzzyShape().speeds}x{FuzzyShape().currents}",
    "memberships of speed, at most, and of current of neuro-fuzzy rules, as VxI",
    form=f"memberships VxI such as 7x2, at most {MAX_RULES} rules",
    check_text=read_grid,
    metavar="VxI",
)
ANFIS = StructureKit(
    about="neuro-fuzzy rules",
    body=Fuzzy,
    sizes=(RULES,),
    fitter=lambda sizes: FuzzyShape(*read_grid(str(sizes["rules"]))),
    table=fuzzy_table,
)
