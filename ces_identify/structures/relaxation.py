"""Relaxation models at the desk: parameters with starts and bounds, fit, tick in C, and what users choose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_data.arrays import F, I
from ces_identify.physical import layout as parameters
from ces_identify.physical.models import Kernel, PhysicalModels
from ces_identify.physical.relaxation_kernels import RelaxationArrays, run_relaxation
from ces_identify.structures.kit import ConstantTable, CTick
from ces_identify.structures.physical import count_option, map_tables, physical_facts, physical_kit
from ces_identify.trained.training import Training
from ces_observer.model import Model
from ces_observer.structures.curves import FlowMap
from ces_observer.structures.relaxation import Relaxation, YieldingSpring

NAMES = ("lead_s", "viscous_Ns_m", "mass_kg", "compliance", "leak", "gas_N", "stiffness", "yield", "map")
SPEEDS = np.array([0.01, 0.03, 0.08, 0.18, 0.35, 0.6, 1.0])  # nodes relative to the speed scale, on either side
COMPLIANCE_M_N, STIFFEST_M_N, SOFTEST_M_N = 3e-7, 1e-9, 1e-4
STIFFNESSES_N_M = (1e6, 1e5)  # range over which the springs' stiffnesses start
SLOW_N_M = 5e2  # start of the last spring, a memory as slow as the leak, which yields at SLOW_YIELD force scales
SLOW_YIELD = 0.25
REACH = 2.0
SPRINGS = (2, 1, 4)  # sizes to try, after the first one only if better
MAX_NEWTON_STEPS = 200  # of the tick in C, in a bracket: enough for any pair of floats of such numbers
CLOSE = 1e-13  # relative change of the flow that ends a step


@dataclass(frozen=True)
class RelaxationModels(PhysicalModels[Relaxation]):
    """Relaxation models with `rows` force-speed curves and `springs` yielding springs beside a slow one."""

    rows: int = 3
    springs: int = 3

    @classmethod
    def sized(cls, training: Training, scales: parameters.DataScales, count: int) -> RelaxationModels:
        """Return the models with `count` yielding springs."""
        return cls(training, scales, springs=count)

    @classmethod
    def small(cls, training: Training, scales: parameters.DataScales, rows: int) -> RelaxationModels:
        """Return models of the smallest size worth a fit."""
        return cls(training, scales, rows=rows, springs=SPRINGS[0])

    @classmethod
    def on_nodes_of(cls, body: Relaxation, interval_s: float, training: Training) -> RelaxationModels | None:
        """Return the models on the nodes of `body`; None if a fit gives other numbers of nodes."""
        if len(body.map.at) != 2 * len(SPEEDS) + 1 or min(len(body.map.rows), len(body.springs)) < 2:
            return None
        size, speed = body.springs[-1].yield_N[0] / SLOW_YIELD, body.map.at[-1] / SPEEDS[-1]
        scales = parameters.scales_of(body, size, speed, interval_s)
        return cls(training, scales, rows=len(body.map.rows), springs=len(body.springs) - 1)

    @staticmethod
    def kernel() -> Kernel:
        """Return the compiled free run."""
        return run_relaxation  # type: ignore[no-any-return]

    @staticmethod
    def arrays_of(body: Relaxation, interval_s: float) -> RelaxationArrays:
        """Return the kernel's view of a structure."""
        limits = np.array([spring.yield_N for spring in body.springs]).reshape(len(body.springs), len(body.map.rows))
        lists = [
            parameters.shared_parameters(body.valve, body.side),
            [body.compliance_m_N, body.leak_m_Ns],
            [spring.stiffness_N_m for spring in body.springs],
            limits.T.ravel(),
            np.ravel(body.map.rows),
        ]
        parts = [np.asarray(one, dtype=np.float64) for one in lists]
        k = np.concatenate(parts)
        first, *sizes = (len(part) for part in parts)
        gas = len(body.side.position_m)
        side, springs = first - gas - 3, first + 2
        yields = springs + len(body.springs)
        places = [side, side + 1, side + 2, first, first + 1, side + 3, springs, yields, yields + sizes[2]]
        return RelaxationArrays(
            k, np.array(places), np.array(body.valve.characteristic.at), np.array(body.map.at),
            np.array(body.side.position_m), len(body.map.rows), len(body.springs), interval_s,
            body.side.max_acceleration_m_s2,
        )  # fmt: skip

    @staticmethod
    def own_quantities(body: Relaxation, stroke_m: float) -> dict[str, float]:
        """Return the quantities of oil, mounts and yielding springs."""
        *springs, _ = body.springs
        return {
            "Stiffness of oil and mounts [N/mm]": 1e-3 / body.compliance_m_N,
            **{f"Yielding spring {n}, stiffness [N/mm]": 1e-3 * s.stiffness_N_m for n, s in enumerate(springs, 1)},
            **{f"Yielding spring {n}, largest force [N]": max(s.yield_N) for n, s in enumerate(springs, 1)},
        }

    @staticmethod
    def gas_stiffness_N_m(body: Relaxation) -> float:
        """Return the stiffness [N/m] of the slow spring, which acts as a gas spring."""
        return body.springs[-1].stiffness_N_m

    @cached_property
    def speeds(self) -> F:
        """Nodes [m/s] of the force-speed curves."""
        half = self.scales.speed_m_s * SPEEDS
        return np.concatenate([-half[::-1], [0.0], half])

    @cached_property
    def layout(self) -> parameters.Layout:
        """The parameters."""
        size, speed = self.scales.force_N, self.scales.speed_m_s
        steps, middle = np.diff(self.speeds) / speed, len(SPEEDS)
        roots = np.diff(np.sqrt(np.concatenate([[0.0], SPEEDS])))
        shape: F = np.concatenate([roots[::-1], roots])
        rows: F = np.arange(self.rows, dtype=np.float64) / (self.rows - 1)
        levels = 0.2 + 0.6 * rows
        least = size * parameters.MIN_RISE * np.tile(steps, self.rows)
        matrix: F = np.kron(np.eye(self.rows), parameters.rises_to_nodes(len(self.speeds), middle)).astype(np.float64)
        yields = size * (0.05 + 0.1 * rows)
        limits = np.repeat(yields[:, None], self.springs + 1, axis=1)
        limits[:, -1] = SLOW_YIELD * size
        fixed = np.zeros_like(limits)
        fixed[:, -1] = limits[:, -1]
        highest = np.full_like(limits, size)
        highest[:, -1] = limits[:, -1]
        stiffnesses = np.append(np.geomspace(*STIFFNESSES_N_M, self.springs), SLOW_N_M)
        return parameters.Layout(
            (
                *parameters.valve_groups(self.scales),
                *parameters.side_groups(self.scales),
                parameters.group("compliance", COMPLIANCE_M_N, STIFFEST_M_N, SOFTEST_M_N),
                parameters.group("leak", 1e-3 * COMPLIANCE_M_N / self.scales.interval_s, 0.0, speed / size),
                parameters.group("stiffness", stiffnesses, 1e-3, 1e9),
                parameters.group("yield", limits.ravel(), np.maximum(1e-4 * size, fixed.ravel()), highest.ravel()),
                parameters.group("map", size * np.outer(levels, shape).ravel(), least, 10.0 * size, matrix),
            )
        )  # fmt: skip

    @cached_property
    def _places(self) -> I:
        return self.layout.places(NAMES)

    def arrays(self, k: F) -> RelaxationArrays:
        """Return the kernel's view of the model."""
        s = self.scales
        return RelaxationArrays(
            k, self._places, s.currents_A, self.speeds, s.positions_m, self.rows, self.springs + 1, s.interval_s,
            s.max_acceleration_m_s2,
        )  # fmt: skip

    def body(self, theta: F) -> Relaxation:
        """Return the structure with these parameters."""
        k = self.layout.k(theta)
        values = {g.name: self.layout.part(k, g.name) for g in self.layout.groups}
        limits = values["yield"].reshape(self.rows, -1)
        return Relaxation(
            parameters.build_valve(self.scales, values),
            float(values["compliance"][0]),
            float(values["leak"][0]),
            FlowMap(
                parameters.as_floats(self.speeds),
                tuple(map(parameters.as_floats, values["map"].reshape(self.rows, -1))),
            ),
            tuple(
                YieldingSpring(float(stiffness), parameters.as_floats(limits[:, j]))
                for j, stiffness in enumerate(values["stiffness"])
            ),
            parameters.build_side(self.scales, values),
            REACH,
        )


def tick_facts(body: Relaxation, model: Model) -> dict[str, object]:
    """Return the numbers and tables of the tick in C."""
    interval = 1.0 / model.sampling.rate_Hz
    rows = range(len(body.map.rows))
    return {
        **physical_facts(body, model),
        "rows": len(rows),
        "map_tables": map_tables(body.map),
        "springs": len(body.springs),
        "spring_tables": [
            ConstantTable("RESTORING", [stiffness for stiffness, _ in body.restoring]),
            ConstantTable("RESTORING_LIMITS", [limit for _, limit in body.restoring]),
            ConstantTable("SPRING_STEPS", [one.stiffness_N_m * interval for one in body.springs]),
            ConstantTable("YIELDS", [one.yield_N[row] for row in rows for one in body.springs], len(body.springs)),
        ],
        "mid_stroke": body.mid_stroke_m,
        "pieces": len(body.map.at) - 1,
        "compliance": body.compliance_m_N,
        "held": body.compliance_m_N + interval * body.leak_m_Ns,
        "close": CLOSE,
        "max_newton_steps": MAX_NEWTON_STEPS,
    }


KIT = physical_kit(
    RelaxationModels,
    "relaxation model (spring and valve in series)",
    Relaxation,
    count_option("springs", "yielding springs of a relaxation model", 1, 6),
    SPRINGS,
    CTick("relaxation", tick_facts, "relaxation model"),
)
