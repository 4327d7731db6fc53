"""Neuro-fuzzy models offline: size, fit, batch run and table for the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from markupsafe import Markup

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.simulated_series import SimulatedSeries
from ces_identify.structures.kit import SizeOption, StructureKit
from ces_identify.structures.lagged_fit import LaggedShape
from ces_identify.trained.fuzzy_fit import FuzzyFit, PremiseGrid
from ces_identify.trained.fuzzy_kernels import FuzzyArrays
from ces_identify.trained.lagged_kernels import lagged_free_run
from ces_identify.trained.lagged_table import regressor_table, unscaled_inputs
from ces_identify.trained.training import LAGS, LagCounts, Lags, Training, build_regressors
from ces_identify.typesetting import (
    UNITS,
    ModelTable,
    describe_signals,
    four_figures,
    minus,
    parameter_table,
    signal_symbol,
)
from ces_observer.errors import CesError
from ces_observer.model import Model
from ces_observer.structures.fuzzy import Fuzzy, Rule

MAX_RULES = 60
NONE = "none"
CURRENT_AND_SPEED = LagCounts(0, 1, 1)  # the inputs of the thesis' neuro-fuzzy models, at the present tick


@dataclass(frozen=True)
class FuzzyShape(LaggedShape):
    """The size of a neuro-fuzzy model (Jang 1993): memberships of speed and current, a rule for each pair, and lags."""

    option: ClassVar[str] = "anfis"
    speeds: int = 7
    currents: int = 2
    current_delay_s: float = 0.008  # of the current in the premises
    lags: Lags | LagCounts = LAGS
    decay: float = 3e-6  # [(J / 100)^2] cost of a squared consequent

    def family(self, data: Training, rate_Hz: float) -> FuzzyFit:
        """Return the neuro-fuzzy models of this size for the data."""
        grid = [PremiseGrid("speed", 0, self.speeds)]
        if self.currents > 1 and "current" in data.changing_inputs():
            grid.append(PremiseGrid("current", round(self.current_delay_s * rate_Hz), self.currents))
        return FuzzyFit(data, build_regressors(data, self.lags, rate_Hz), tuple(grid), self.decay)


def read_grid(text: str) -> tuple[int, int]:
    """Return the numbers of memberships of speed and current in `VxI`; raises ValueError."""
    speeds, _, currents = text.partition("x")
    return _check_grid(text, "VxI, such as 7x2", speeds, currents)


def read_memberships(text: str) -> tuple[int, int] | None:
    """Return the numbers of memberships of speed and current in `AxB`, None for `none`; raises ValueError.

    As in the thesis, A is the number of the current's and B of the speed's.
    """
    if text == NONE:
        return None
    currents, _, speeds = text.partition("x")
    return _check_grid(text, "AxB, such as 4x4", speeds, currents)


def _check_grid(text: str, expected: str, speeds: str, currents: str) -> tuple[int, int]:
    if not (speeds.isdecimal() and currents.isdecimal() and int(speeds) >= 2 and int(currents) >= 1):
        raise ValueError(f"'{text}' is not {expected}, with at least 2 of speed and 1 of current")
    if int(speeds) * int(currents) > MAX_RULES:
        raise ValueError(f"'{text}' makes {int(speeds) * int(currents)} rules; at most {MAX_RULES}")
    return int(speeds), int(currents)


def choose_shape(rules: str, memberships: str) -> FuzzyShape:
    """Return the shape of the options `rules` (with a past force) and `memberships` (without); raises CesError."""
    static = read_memberships(memberships)
    if static is None:
        return FuzzyShape(*read_grid(rules))
    if rules != RULES.default:
        raise CesError(f"--rules {rules} and --memberships {memberships}: give one; only --rules has a past force")
    return FuzzyShape(*static, current_delay_s=0.0, lags=CURRENT_AND_SPEED)


def run_fuzzy(fuzzy: Fuzzy, model: Model, inputs: F, segments: I) -> tuple[F, int]:
    """Return the batch run of neuro-fuzzy rules, as `StructureKit.batch_run` describes it."""
    table = regressor_table(fuzzy.regressors, model.envelope, inputs, segments)
    premises = unscaled_inputs([(p.signal, p.lag) for p in fuzzy.premises], model.envelope, inputs, segments)
    counts = [len(p.memberships) for p in fuzzy.premises]
    bells = [(b.centre, np.log(b.width), np.log(b.slope)) for p in fuzzy.premises for b in p.memberships]
    first = np.cumsum([0, *counts[:-1]])
    arrays = FuzzyArrays(
        fuzzy.scale_N,
        premises,
        np.repeat(np.arange(len(counts)), counts),
        np.array([rule.memberships for rule in fuzzy.rules], np.int64) + first,
        np.array([(rule.constant, *rule.linear) for rule in fuzzy.rules]),
        np.array(bells),
    )
    force, diverged = lagged_free_run(table, segments, arrays, *model.force_envelope_N)
    return np.asarray(force), int(diverged)


def fuzzy_table(fuzzy: Fuzzy, model: Model, runs: Sequence[SimulatedSeries], role: str) -> ModelTable:
    """Return the rules: where each applies, and the force for a change of each regressor."""
    about = (
        f"A neuro-fuzzy model of {len(fuzzy.rules)} rules, each an affine model near the values named. "
        "Numbers: force [N] for a change of a regressor by one standard deviation."
    )
    heads = (Markup("Rule near"), Markup("Constant [N]"), *(signal_symbol(r.signal, r.lag) for r in fuzzy.regressors))
    rows = [
        (_place(fuzzy, rule), *(four_figures(fuzzy.scale_N * number) for number in (rule.constant, *rule.linear)))
        for rule in fuzzy.rules
    ]
    symbols = describe_signals((r.signal for r in fuzzy.regressors), model.sampling.rate_Hz)
    return parameter_table(about, heads, tuple(rows), symbols)


def _place(fuzzy: Fuzzy, rule: Rule) -> Markup:
    parts = [
        Markup("{} = {} {}").format(
            signal_symbol(p.signal, p.lag), minus(f"{p.memberships[m].centre:.3g}"), UNITS[p.signal]
        )
        for p, m in zip(fuzzy.premises, rule.memberships, strict=True)
    ]
    return Markup(", ").join(parts)


RULES = SizeOption(
    "rules",
    f"{FuzzyShape().speeds}x{FuzzyShape().currents}",
    "memberships of speed and of current of neuro-fuzzy rules, as VxI",
    f"memberships VxI such as 7x2, at most {MAX_RULES} rules",
    check=read_grid,
    metavar="VxI",
)
MEMBERSHIPS = SizeOption(
    "memberships",
    NONE,
    "instead of --rules: neuro-fuzzy rules of present current and speed alone, with A memberships of current and B of "
    "speed, as in thesis table 5.3; such a model has no memory",
    f"{NONE} or memberships AxB such as 4x4, at most {MAX_RULES} rules",
    check=lambda text: read_memberships(text) or NONE,
    metavar="AxB",
)
ANFIS = StructureKit(
    option=FuzzyShape.option,
    about="neuro-fuzzy rules",
    body=Fuzzy,
    sizes=(RULES, MEMBERSHIPS),
    fitter=lambda sizes: choose_shape(str(sizes["rules"]), str(sizes["memberships"])),
    batch_run=run_fuzzy,
    table=fuzzy_table,
)
