"""The interface of model structures: they compute a force and can be run, proved stable, written and read.

A structure is a frozen class in a file beside this one, where `ces_observer.structures` finds it. Its fields are a part
of the model file; the rest of the file is the same for every structure.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from sys import float_info
from typing import ClassVar, Protocol

from ces_observer.core import bind, floats, ints
from ces_observer.errors import ModelError
from ces_observer.flat import ArrayLayout, Arrays
from ces_observer.json_text import quote
from ces_observer.limits import NumberLimits
from ces_observer.proof.certificate import Certificate
from ces_observer.tick import model

INPUTS = ("position", "speed", "current")

Range = tuple[float, float]
Ranges = Mapping[str, Range]  # of position [m], speed [m/s] and current [A] by name
ANY: Range = (-NumberLimits.MAX_COEFFICIENT, NumberLimits.MAX_COEFFICIENT)  # of an input that is not used


def require_length(where: str, values: Sequence[object], count: int) -> None:
    """Raise ModelError unless a list has as many values as it must."""
    if len(values) != count:
        raise ModelError(f"{where} is {quote(list(values))}; expected a list of {count} numbers")


@dataclass(frozen=True)
class OperatingRange:
    """The rate and ranges for which a structure is run and proved.

    Inputs are clamped to their ranges, unless the structure extrapolates; a force outside `force_N` [N] is held at its
    nearest end. A current within `current_gap_A` [A] counts as outside, and is used as it is.
    """

    rate_Hz: float
    inputs: Ranges
    force_N: Range
    current_gap_A: Range | None = None


class Predictor(Protocol):
    """The free run of a structure: one force for each tick's inputs."""

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside their ranges; they were clamped, unless the structure extrapolates."""

    @property
    def held(self) -> bool:
        """True if the last force lay outside its range and was held at its end."""

    def reset(self) -> None:
        """Forget the past: earlier forces are zero, earlier inputs equal the first ones to come."""

    def tick(self, position: float, speed: float, current: float) -> float:
        """Return the force [N] at this tick's inputs [m, m/s, A], held in its range; infinite if it is not finite."""


class CoreRun:
    """The free run of the functions of `ces_observer.tick` on a model's arrays; a Predictor."""

    def __init__(self, arrays: Arrays, reset: Callable[..., None], tick: Callable[..., float]) -> None:
        p, n, self.s, self.k = floats(arrays.p), ints(arrays.n), floats(arrays.s), ints(arrays.k)
        self.reset = bind(reset, p, n, self.s, self.k)
        self.tick = bind(tick, p, n, self.s, self.k)
        self.reset()

    @property
    def clamped(self) -> bool:
        """True if the last inputs lay outside their ranges."""
        return self.k[model.CLAMPED] != 0

    @property
    def held(self) -> bool:
        """True if the last force lay outside its range and was held at its end."""
        return self.k[model.HELD] != 0


class Structure(ABC):
    """The part of a model that computes the force, a record of a model file; `name` is its name there.

    Its fields are under the key `section`, or beside the rest of the file if that is empty.
    `option` is its name for users, who see the structures by `rank`; the first is the default. They cannot ask for one
    that is not `is_offered`.
    `extrapolates` is True if inputs outside the envelope are used as they are, up to a stated reach, and not clamped to
    the envelope. `unproved` is the reason given if `is_stable` is False. `number` is its number in
    `ces_observer.tick.structure`, and `runs` are its reset and its tick there. If not
    `forgets_by_proof`, the time in which it forgets its start has to be measured. One that `keeps_past` has inputs that
    stay where they were at rest, as the user's rules ask for.
    """

    name: ClassVar[str]
    section: ClassVar[str] = ""
    option: ClassVar[str]
    rank: ClassVar[int] = 100
    is_offered: ClassVar[bool] = True
    extrapolates: ClassVar[bool] = False
    unproved: ClassVar[str] = "it is not proved to be a contraction over its input envelope"
    forgets_by_proof: ClassVar[bool] = True
    keeps_past: ClassVar[bool] = False
    number: ClassVar[int] = -1
    runs: ClassVar[tuple[Callable[..., None], Callable[..., float]]]

    @property
    @abstractmethod
    def size(self) -> str:
        """The size, in words."""

    @property
    def uses(self) -> Sequence[str]:
        """The inputs on which its force may depend."""
        return INPUTS

    @property
    def outside(self) -> str:
        """What becomes of inputs outside the envelope, in words."""
        return "clamped to it"

    def steady_force(self, within: OperatingRange, speed_m_s: float, current_A: float) -> float | None:
        """Return the exact force [N] at mid-stroke at constant speed and current; None if only a run shows it."""
        return None

    def check_over(self, inputs: Ranges) -> None:  # noqa: B027  # most need not
        """Raise ModelError if the structure in a file does not fit the file's ranges of inputs."""

    def fill(self, layout: ArrayLayout, within: OperatingRange) -> None:
        """Write the structure's numbers into a layout, for the functions `runs`; raises ModelError.

        Without it, a structure that overrides `make_predictor` runs at the desk, but in no estimator.
        """
        raise ModelError(f"structure '{self.name}' has no tick in ces_observer/tick; see docs/extending.md")

    def lay_out(self, within: OperatingRange) -> ArrayLayout:
        """Return the layout of its arrays: what every model has, and what `fill` writes; raises ModelError."""
        layout = ArrayLayout(model.P_STRUCTURE, model.N_STRUCTURE, model.S_STRUCTURE, model.K_STRUCTURE)
        ranges = (*(within.inputs[name] if name in self.uses else ANY for name in INPUTS), within.force_N)
        ends = [min(max(end, -float_info.max), float_info.max) for ends in ranges for end in ends]
        layout.put(model.POSITION_LOW, ends)
        if within.current_gap_A is not None:
            layout.put(model.GAP_LOW, within.current_gap_A)
        layout.p[model.RATE] = within.rate_Hz
        layout.n[model.KIND] = self.number
        self.fill(layout, within)
        return layout

    def make_predictor(self, within: OperatingRange) -> Predictor:
        """Return a new free run; raises ModelError for numbers that cannot be used."""
        return CoreRun(self.lay_out(within).arrays(), *self.runs)

    @abstractmethod
    def certify(self, within: OperatingRange) -> Certificate:
        """Return the certificate of its stability; its bounds may be loose, never wrong."""

    def is_stable(self, within: OperatingRange) -> bool:
        """Return whether it can be proved stable; may be faster than `certify`."""
        return self.certify(within).holds
