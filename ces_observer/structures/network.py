"""A sigmoid network NARX: its parameters and proof of stability; `ces_observer.tick.sigmoid` has its equation.

The slope s' of a sigmoid lies in (0, 1/4]. Between two pasts the mean value theorem gives the output's change as
sum_j g_j (change of y(k - j)) with g_j in the interval of linear_j + sum_i weight_i slope_ij s'_i, for any inputs. So
sum_j max |g_j| < 1 makes the recursion a contraction, and from a past of zeros |y| <= max |b| / (1 - sum) at all times.
b is the output at a past of zeros, bounded over the input envelope by interval arithmetic with outward rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from math import exp
from typing import Self

from ces_observer.flat import ArrayLayout
from ces_observer.limits import FileLimits
from ces_observer.proof.certificate import Contraction, contraction_s
from ces_observer.proof.intervals import Interval, add, largest, product, up
from ces_observer.records import items
from ces_observer.structures import lagged_signals as lagged
from ces_observer.structures.structure import OperatingRange, Ranges, Structure, require_length
from ces_observer.tick import sigmoid as tick
from ces_observer.tick.lagged import K_LAGGED, lagged_reset
from ces_observer.tick.model import S_STRUCTURE
from ces_observer.tick.structure import SIGMOID

CLAIM = (
    "sum_j |dF/dF(k-j)| <= gain < 1 for any past and inputs; "
    "|F| <= drive_N for a past of zeros and every input in the input envelope"
)
METHOD = "slope of every sigmoid in (0, 1/4]; interval arithmetic, outward rounding"
SLOPE: Interval = (0.0, 0.25)
ROUNDING = 1e-15  # relative error of exp, an addition and a division, with a margin


@dataclass(frozen=True)
class SigmoidUnit:
    """One sigmoid: its weight in the output, its bias, and its slope along each regressor."""

    weight: float = lagged.weight()
    bias: float = lagged.weight()
    slopes: tuple[float, ...] = lagged.weight()


@dataclass(frozen=True)
class Network(Structure):
    """A sigmoid network; `linear` and each unit's slopes have one coefficient for each regressor."""

    name, section, option, rank = "sigmoid_narx", "network", "sigmoid", 1
    number, runs = SIGMOID, (lagged_reset, tick.sigmoid_tick)

    regressors: tuple[lagged.Regressor, ...] = items(1, FileLimits.MAX_ITEMS)
    scale_N: float = lagged.spread("N")
    constant: float = lagged.weight()
    linear: tuple[float, ...] = lagged.weight()
    units: tuple[SigmoidUnit, ...] = items(0, FileLimits.MAX_RULES)

    @property
    def uses(self) -> Sequence[str]:
        """The inputs among its regressors."""
        return lagged.list_used(self.regressors)

    @property
    def size(self) -> str:
        """The size, in words."""
        return f"{len(self.units)} sigmoid units on {len(self.regressors)} regressors"

    def checked(self) -> Self:
        """Return it; raises ModelError unless there is a coefficient for each regressor."""
        for where, numbers in (
            ("linear", self.linear),
            *((f"units[{i}]: slopes", u.slopes) for i, u in enumerate(self.units)),
        ):
            require_length(where, numbers, len(self.regressors))
        return self

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the network into a layout, for `ces_observer.tick.sigmoid`."""
        layout.reserve(tick.P_SIGMOID, tick.N_SIGMOID, S_STRUCTURE, K_LAGGED)
        lagged.fill_lagged(layout, self.regressors)
        rows = [(*self.linear, self.constant), *((*unit.slopes, unit.bias) for unit in self.units)]
        layout.p[tick.SIGMOID_SCALE] = self.scale_N
        layout.n[tick.SIGMOID_UNITS] = len(self.units)
        layout.n[tick.SIGMOID_LAYER] = layout.table(chain.from_iterable(rows))
        layout.n[tick.SIGMOID_WEIGHTS] = layout.table(unit.weight for unit in self.units)
        layout.n[tick.SIGMOID_OUTPUTS] = layout.state(len(rows))

    def certify(self, within: OperatingRange) -> Contraction:
        """Return proved bounds on the sum of the past forces' |gains|, and on |force| [N] at a past of zeros."""
        gain = 0.0
        for j, regressor in enumerate(self.regressors):
            if regressor.signal == "force":
                gain = up(gain + up(largest(self._slope(j)) * up(self.scale_N / regressor.spread)))
        drive = up(largest(self._drive(within.inputs)) * self.scale_N)
        forgets_s = contraction_s(gain, *lagged.longest_lags(self.regressors), within.rate_Hz)
        return Contraction(gain, drive, 1, CLAIM, METHOD, forgets_s)

    def _slope(self, j: int) -> Interval:
        """Return an interval that holds the derivative of the scaled output with respect to regressor j."""
        total = (self.linear[j], self.linear[j])
        for unit in self.units:
            steepest = product((unit.weight, unit.weight), (unit.slopes[j], unit.slopes[j]))
            total = add(total, product(steepest, SLOPE))
        return total

    def _drive(self, inputs: Ranges) -> Interval:
        """Return an interval that holds the scaled output at a past of zeros."""
        at = [r.interval(inputs) for r in self.regressors]
        total = lagged.affine(self.constant, self.linear, at)
        for unit in self.units:
            low, high = lagged.affine(unit.bias, unit.slopes, at)
            risen = sigmoid(low) * (1.0 - ROUNDING), min(1.0, sigmoid(high) * (1.0 + ROUNDING))
            total = add(total, product((unit.weight, unit.weight), risen))
        return total


def sigmoid(x: float) -> float:
    """Return 1 / (1 + e^-x)."""
    return 1.0 / (1.0 + exp(min(-x, tick.MAX_SIGMOID_EXPONENT)))
