"""What every damper of the rig is: numbers that can be changed by path, the kind of its equations, withheld effects.

A kind is a package: the fields of its model (`parameters`), its equations (`kernel`), and in its `__init__` how dampers
vary, the changes that effects make, and the `KIND` that puts all together; `stepper.py` lists it. An effect has a
severity and proportions. These, drawn at random, set its shape in one case (such as the ratio of Stribeck to Coulomb
friction); its physical numbers depart from the plant's own as the severity grows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import asdict, astuple, dataclass
from functools import partial, reduce
from math import exp, isfinite, log, sqrt
from types import ModuleType
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.random import Generator

from ces_data.arrays import F
from ces_observer.records import quantity, read_record
from ces_rig.errors import RigError

EFFECTS = (
    "friction", "compressibility", "mount_compliance", "backlash", "inertia", "gas_spring", "cavitation",
    "temperature_fade", "leakage", "blow_off", "bump_stop", "valve_lag", "current_hysteresis", "current_scale",
    "force_offset", "force_drift", "force_scale", "position_delay",
)  # fmt: skip
OUTSIDE = (
    "groove", "foaming", "side_load", "sticking_check", "ring_tilt", "cell_resonance", "cell_creep",
    "current_crosstalk", "mains_hum", "position_wave", "late_check", "sticking_pilot", "current_ripple",
    "frame_resonance",
)  # fmt: skip


@dataclass(frozen=True)
class Spread:
    """Distribution of a proportion: log-uniform in [low, high] (`signed`: of either sign), or uniform."""

    low: float
    high: float
    uniform: bool = False
    signed: bool = False

    def draw(self, rng: Generator) -> float:
        """Return one value."""
        if self.uniform:
            return float(rng.uniform(self.low, self.high))
        value = exp(rng.uniform(log(self.low), log(self.high)))
        return -value if self.signed and rng.random() < 0.5 else value

    @property
    def middle(self) -> float:
        """The middle of the spread."""
        return 0.5 * (self.low + self.high) if self.uniform else sqrt(self.low * self.high)


log_spread, uniform_spread, signed_spread = Spread, partial(Spread, uniform=True), partial(Spread, signed=True)
Proportions = Mapping[str, Spread]
Change = Callable[[Any, float, Mapping[str, float]], dict[str, float]]
"""(damper description, severity, proportions) -> the numbers that the effect changes in it, by path."""


@dataclass(frozen=True)
class WithheldEffect:
    """An effect put into a plant: severity 0 is none; raises RigError for an unknown name or a negative severity."""

    name: str
    severity: float
    proportions: Mapping[str, float]

    def __post_init__(self) -> None:
        if self.name not in EFFECTS + OUTSIDE:
            raise RigError(f"withheld effect '{self.name}' is unknown; expected one of {', '.join(EFFECTS + OUTSIDE)}")
        if not (isfinite(self.severity) and self.severity >= 0.0):
            raise RigError(f"withheld effect {self.name}: severity {self.severity!r}; expected a number of at least 0")


def add_to(**paths: str) -> Change:
    """Return a change that adds to the numbers at `paths` the severity times a proportion, the name of the argument."""
    return lambda d, s, p: {path: get_number(d, path) + s * p[key] for key, path in paths.items()}


def get_number(damper: object, path: str) -> float:
    """Return the number at a path, such as `seal.coulomb_N`, in a damper's description."""
    return float(reduce(getattr, path.split("."), damper))  # type: ignore[arg-type]


def interpolate_log(start: float, target: float, share: float) -> float:
    """Return the geometric interpolation from `start` (share 0) to `target` (share 1)."""
    return float(start ** (1.0 - share) * target**share)


T = TypeVar("T")

REACH_M = 0.06  # [m] travel to either side for which the gas volume is designed
MIN_GAS_SHARE = 1.05  # of the volume that the rod displaces at the end of that travel


def replace_numbers(whole: T, numbers: Mapping[str, Any], where: str = "plant") -> T:
    """Return `whole` with the `numbers` at their paths, such as `seal.coulomb_N`; raises RigError if out of range."""
    nested: dict[str, Any] = {}
    for path, number in numbers.items():
        *sections, last = path.split(".")
        inner = nested
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[last] = number
    return read_record(type(whole), nested, where, RigError, whole)


class RigDamper(ABC):
    """A damper whose numbers can be changed by path: as a plant, a simulation or on a live rig."""

    kind: ClassVar[str]
    coil_path: ClassVar[str] = "coil_s"  # of the coil's time constant
    foaming_1_J: float
    damper: Any  # the description that the effects change

    @property
    @abstractmethod
    def current_A(self) -> tuple[float, float]:
        """The working range [A] of the current, which experiments use."""

    @property
    def allowed_A(self) -> tuple[float, float]:
        """The range [A] that a driver clips commands to."""
        return self.current_A

    @property
    def reach_m(self) -> float:
        """Travel [m] from mid-stroke to either end."""
        return REACH_M

    @abstractmethod
    def coefficients(self) -> tuple[float, ...]:
        """Return the kernel's numbers, in their order."""

    def without_coil(self) -> Self:
        """Return the damper without its coil's lag, to be driven with a measured coil current."""
        return self.with_numbers({self.coil_path: 0.0})

    @abstractmethod
    def with_numbers(self, numbers: Mapping[str, float]) -> Self:
        """Return the damper with other numbers, by path; raises RigError for one out of range."""

    def number(self, path: str) -> float:
        """Return the number at a path."""
        return get_number(self.damper, path)

    def description(self) -> dict[str, Any]:
        """Return the contents of its YAML file."""
        return {"kind": self.kind, **asdict(self.damper)}

    def check_input(self, stroke_m: F, current_A: F) -> None:
        """Raise RigError for strokes and currents, each (n,), that the kind cannot be driven with."""
        return

    def refresh(self, numbers: F, absorbed_J: float) -> float:
        """Update the kernel's `numbers` by the energy absorbed so far; return the time [s] to the next update."""
        return np.inf


@dataclass(frozen=True)
class LumpedDamper(RigDamper):
    """Base of the kinds with a flat description: what all have; raises RigError if a number is out of range."""

    gas_m3: float
    rod_m2: float
    play_m: float = quantity(0.0, "m", "free play of the bushing, end to end", 0.0, 0.02)
    start_degC: float = quantity(25.0, "°C", "initial and ambient temperature", -40.0, 150.0)
    coil_s: float = quantity(2e-3, "s", "coil and driver time constant", 0.0, 0.5)
    void_N: float = quantity(1e5, "N", "compression force at which the rod side is empty", 1.0, 1e6)
    bypass_m_Ns: float = quantity(0.0, "m/(s·N)", "leakage past the piston", 0.0, 1e-2)
    relief_N: float = quantity(1e5, "N", "force at which a relief valve opens", 1.0, 1e6)
    relief_Ns_m: float = quantity(300.0, "N·s/m", "damping beyond it", 1.0, 1e6)
    mount_N_m: float = quantity(2e7, "N/m", "stiffness of the bushing", 1e4, 1e9)
    mount_Ns_m: float = quantity(3e3, "N·s/m", "damping of the bushing", 0.0, 1e6)
    stop_clearance_m: float = quantity(0.055, "m", "stroke, either way, where the stop begins", 1e-3, 0.5)
    stop_progression_1_m: float = quantity(0.0, "1/m", "relative growth of stiffness with deflection", 0.0, 1e4)
    heat_J_K: float = quantity(3000.0, "J/K", "heat capacity", 5.0, 1e6)
    heat_loss_W_K: float = quantity(3.0, "W/K", "heat loss", 0.0, 1e4)
    foaming_1_J: float = quantity(0.0, "m/J", "growth of the bubbles' travel with the absorbed energy", 0.0, 1e-3)
    groove_m_Ns: float = quantity(0.0, "m/(s·N)", "bypass in a groove of the wall", 0.0, 1e-2)
    groove_at_m: float = quantity(0.0, "m", "stroke at the middle of the groove", -0.5, 0.5)
    groove_m: float = quantity(0.01, "m", "half length of the groove", 1e-4, 0.5)
    side_load_N_m: float = quantity(0.0, "N/m", "growth of friction away from `side_at_m`", 0.0, 1e5)
    side_at_m: float = quantity(0.0, "m", "stroke without side load", -0.5, 0.5)

    def __post_init__(self) -> None:
        if self.gas_m3 <= MIN_GAS_SHARE * self.rod_m2 * REACH_M:
            raise RigError(f"{self.kind}: gas_m3 {self.gas_m3:g} cannot take up the rod's volume; enlarge it")

    @property
    def damper(self) -> Self:
        """The description that the effects change: this object."""
        return self

    def coefficients(self) -> tuple[float, ...]:
        """Return the kernel's numbers: all fields."""
        return astuple(self)

    def with_numbers(self, numbers: Mapping[str, float]) -> Self:
        """Return the damper with other numbers; raises RigError for one out of range."""
        return replace_numbers(self, numbers, f"{self.kind} plant")


@dataclass(frozen=True)
class DamperKind:
    """A kind of damper: its effect-free design, variation, simulation errors, effects and compiled equations.

    The `kernel` has the named tuple `Numbers` of the coefficients c, `settle(c, state, stroke, speed, current)`,
    which returns the force at rest, `rest_force(c)`, STATE_SIZE, the indices COIL and TEMPERATURE of the state, STEP_S,
    the integrator's step, and `run`. This steps mover and damper through `moves` (`ces_rig.drive`) and fills `force`
    (n,) and `states` (n, STATE_SIZE), which may have no rows. It takes the numbers as an array: as many scalars would
    take as long as ten steps. Numba's cache watches its file only: touch that after changing a function of another
    file that it calls.
    """

    design: RigDamper
    varied: Mapping[str, float]
    wrong: Mapping[tuple[str, ...], float]
    spreads: Mapping[str, Proportions]
    changes: Mapping[str, Change]
    kernel: ModuleType


LUMPED_SPREADS: Mapping[str, Proportions] = {
    "inertia": {"mass_kg": log_spread(1.5, 4.0)},
    "groove": {"bypass_m_Ns": log_spread(6e-5, 2e-4), "at_m": uniform_spread(-0.012, 0.012),
               "half_m": log_spread(0.004, 0.01)},
    "side_load": {"slope_N_m": log_spread(2e3, 5e3), "at_m": uniform_spread(-0.01, 0.01)},
    "mount_compliance": {"compliance_m_N": log_spread(1.5e-7, 6e-7), "relaxation_s": log_spread(1e-4, 8e-4)},
    "backlash": {"play_m": log_spread(2e-4, 6e-4)},
    "cavitation": {"gas_loss": log_spread(60.0, 120.0)},
    "leakage": {"bypass_m_Ns": log_spread(2e-5, 8e-5)},
    "bump_stop": {"stiffness_N_m": log_spread(3e4, 2e5), "progression_1_m": uniform_spread(0.0, 120.0)},
    "gas_spring": {"pressure": uniform_spread(0.3, 1.2), "volume": log_spread(0.5, 2.0),
                   "exponent": uniform_spread(1.05, 1.4)},
    "foaming": {"growth_m_J": log_spread(2e-8, 2e-7)},
}  # fmt: skip


def _gas_spring(d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    """Return the numbers of a gas with more pressure and less volume, still large enough for the rod."""
    smallest = 1.2 * d.rod_m2 * REACH_M
    return {
        "gas_Pa": d.gas_Pa * (1.0 + s * p["pressure"]),
        "gas_m3": smallest + (d.gas_m3 - smallest) / (1.0 + s * p["volume"]),
        "gas_exponent": interpolate_log(d.gas_exponent, p["exponent"], s / (1.0 + s)),
    }


def _mount_compliance(d: Any, s: float, p: Mapping[str, float]) -> dict[str, float]:
    stiffness = 1.0 / (1.0 / d.mount_N_m + s * p["compliance_m_N"])
    share = 1.0 - stiffness / d.mount_N_m
    relaxation = interpolate_log(d.mount_Ns_m / d.mount_N_m, p["relaxation_s"], share)
    return {"mount_N_m": stiffness, "mount_Ns_m": relaxation * stiffness}


LUMPED_CHANGES: Mapping[str, Change] = {
    "mount_compliance": _mount_compliance,
    "backlash": add_to(play_m="play_m"),
    "cavitation": lambda d, s, p: {"void_N": d.void_N / (1.0 + s * p["gas_loss"])},
    "leakage": add_to(bypass_m_Ns="bypass_m_Ns"),
    "bump_stop": lambda d, s, p: {
        "stop_clearance_m": d.stop_clearance_m / (1.0 + s), "stop_N_m": p["stiffness_N_m"],
        "stop_progression_1_m": p["progression_1_m"],
    },
    "inertia": add_to(mass_kg="mass_kg"),
    "gas_spring": _gas_spring,
    "blow_off": lambda d, s, p: {"relief_N": d.relief_N / (1.0 + s * p["weakness"]), "relief_Ns_m": p["beyond_Ns_m"]},
    "groove": lambda _d, s, p: {
        "groove_m_Ns": s * p["bypass_m_Ns"], "groove_at_m": p["at_m"], "groove_m": p["half_m"],
    },
    "foaming": lambda _d, s, p: {"foaming_1_J": s * p["growth_m_J"]},
    "side_load": lambda _d, s, p: {"side_load_N_m": s * p["slope_N_m"], "side_at_m": p["at_m"]},
}  # fmt: skip
"""Changes of effects whose laws several kinds share, as their spreads; a kind replaces those that it has of its own."""
