"""Models with two chambers at the desk: parameters with starts and bounds, fit, tick in C, and what users choose."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ces_data.arrays import F, I
from ces_identify.physical import layout as parameters
from ces_identify.physical.chambers_kernels import ChamberArrays, run_chambers
from ces_identify.physical.models import Kernel, PhysicalModels
from ces_identify.structures.kit import ConstantTable, CTick, find_slopes, number
from ces_identify.structures.physical import count_option, map_tables, physical_facts, physical_kit
from ces_identify.trained.training import Training
from ces_observer.model import Model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.curves import FlowMap, IncreasingCurve
from ces_observer.structures.physical import FrictionElement

NAMES = (
    "lead_s", "viscous_Ns_m", "mass_kg", "gas_N", "ratio", "compression", "rebound", "mount", "check", "refill", "map",
    "friction", "friction_yield", "growth",
)  # fmt: skip
FLOWS = np.array([-0.003, 0.0, 0.003, 0.01, 0.02, 0.04, 0.08, 0.15, 0.25, 0.4, 0.65, 1.0])  # relative to the speed
DROPS = np.array([-1.0, -0.4, -0.1, 0.0, 0.01, 0.03, 0.08, 0.2, 0.5])  # relative to the force scale
SUCTIONS = np.array([-1.0, 0.0, 0.003, 0.01, 0.03, 0.1])
RATIO, LEAST_RATIO, MOST_RATIO = 0.4, 0.02, 3.0
CHAMBER_M_N, MOUNT_M_N = 2e-7, 3e-7
STIFFEST_M_N, SOFTEST_M_N = 1e-9, 1e-5
BACK = 0.01  # force scales at which the rebound chamber is refilled at the first flow node
FRICTION_N_M, YIELD = 3e5, (0.006, 0.025)  # starts, the latter relative to the force scale
REACH = 2.0
QUICK_STEPS = 4  # of the tick in C: Newton steps in both pressures, before a search in one of them
MAX_SEARCH_STEPS = 200  # of a bisection: enough for any pair of floats of such numbers
CLOSE = 1e-13  # relative change of the pressure that ends the search


@dataclass(frozen=True)
class ChambersModels(PhysicalModels[Chambers]):
    """Models with `rows` valve curves and `friction` friction elements."""

    rows: int = 3
    friction: int = 1

    @classmethod
    def sized(cls, training: Training, scales: parameters.DataScales, count: int) -> ChambersModels:
        """Return the models with `count` valve curves."""
        return cls(training, scales, rows=count)

    @classmethod
    def small(cls, training: Training, scales: parameters.DataScales, rows: int) -> ChambersModels:
        """Return models of the smallest size worth a fit."""
        return cls(training, scales, rows=rows)

    @classmethod
    def on_nodes_of(cls, body: Chambers, interval_s: float, training: Training) -> ChambersModels | None:
        """Return the models on the nodes of `body`; None if a fit gives other numbers of nodes."""
        counts = tuple(map(len, (body.map.at, body.check.at, body.refill.at)))
        if counts != (len(FLOWS), len(DROPS), len(SUCTIONS)) or len(body.map.rows) < 2:
            return None
        scales = parameters.scales_of(body, body.check.at[-1] / DROPS[-1], body.map.at[-1] / FLOWS[-1], interval_s)
        return cls(training, scales, rows=len(body.map.rows), friction=len(body.side.friction))

    @staticmethod
    def kernel() -> Kernel:
        """Return the compiled free run."""
        return run_chambers  # type: ignore[no-any-return]

    @staticmethod
    def arrays_of(body: Chambers, interval_s: float) -> ChamberArrays:
        """Return the kernel's view of a structure."""
        elements = body.side.friction
        lists = [
            parameters.shared_parameters(body.valve, body.side),
            [body.area_ratio, body.compression_m_N, body.rebound_m_N, body.mount_m_N],
            body.check.values,
            body.refill.values,
            np.ravel(body.map.rows),
            [one.stiffness_N_m for one in elements],
            [one.yield_N for one in elements],
            [body.friction_growth_1_N],
        ]
        parts = [np.asarray(one, dtype=np.float64) for one in lists]
        k = np.concatenate(parts)
        starts = np.cumsum([len(part) for part in parts])
        shared = int(starts[0])
        side = shared - len(body.side.position_m) - 3
        places = [side, side + 1, side + 2, side + 3, *range(shared, shared + 4), *starts[1:-1]]
        return ChamberArrays(
            k, np.array(places, dtype=np.int64), np.array(body.valve.characteristic.at), np.array(body.map.at),
            np.array(body.check.at), np.array(body.refill.at), np.array(body.side.position_m), len(body.map.rows),
            len(elements), interval_s, body.side.max_acceleration_m_s2,
        )  # fmt: skip

    @staticmethod
    def own_quantities(body: Chambers, stroke_m: float) -> dict[str, float]:
        """Return the quantities of chambers and seals."""
        ratio = 1.0 + body.area_ratio
        mount = {"Stiffness of mounts and rod [N/mm]": 1e-3 / body.mount_m_N} if body.mount_m_N > 0.0 else {}
        return {
            "Stiffness of the compression chamber [N/mm]": 1e-3 * ratio**2 / body.compression_m_N,
            "Stiffness of the rebound chamber [N/mm]": 1e-3 / body.rebound_m_N,
            **mount,
            "Rod area over annulus area": body.area_ratio,
            "Friction of the seals [N]": sum(min(e.yield_N, e.stiffness_N_m * stroke_m) for e in body.side.friction),
        }

    @cached_property
    def layout(self) -> parameters.Layout:
        """The parameters."""
        size, speed = self.scales.force_N, self.scales.speed_m_s
        softest = SOFTEST_M_N
        return parameters.Layout(
            (
                *parameters.valve_groups(self.scales),
                *parameters.side_groups(self.scales),
                parameters.group("ratio", RATIO, LEAST_RATIO, MOST_RATIO),
                parameters.group("compression", CHAMBER_M_N, STIFFEST_M_N, softest),
                parameters.group("rebound", CHAMBER_M_N, STIFFEST_M_N, softest),
                parameters.group("mount", MOUNT_M_N, 0.0, softest),
                self._check(speed),
                self._refill(speed),
                self._map(size),
                parameters.group("friction", np.full(self.friction, FRICTION_N_M), 1.0, 1e9),
                parameters.group("friction_yield", size * np.geomspace(*YIELD, self.friction), 1e-5 * size, size),
                parameters.group("growth", 0.1 / size, 0.0, 10.0 / size),
            )
        )

    def _check(self, speed: float) -> parameters.Group:
        zero = int(np.flatnonzero(DROPS == 0.0)[0])
        back = -0.03 * np.diff(np.sqrt(-DROPS[: zero + 1]))
        through = 4.0 * np.diff(np.sqrt(DROPS[zero:] / DROPS[-1]))
        rises = speed * np.concatenate([back, through])
        return parameters.group("check", rises, 1e-6 * speed, 1e3 * speed, parameters.rises_to_nodes(len(DROPS), zero))

    def _refill(self, speed: float) -> parameters.Group:
        zero = int(np.flatnonzero(SUCTIONS == 0.0)[0])
        rises = speed * np.append(1e-3, 3.0 * np.diff(np.sqrt(SUCTIONS[zero:] / SUCTIONS[-1])))
        return parameters.group(
            "refill", rises, 1e-6 * speed, 1e3 * speed, parameters.rises_to_nodes(len(SUCTIONS), zero)
        )

    def _map(self, size: float) -> parameters.Group:
        """The valve's curves through the origin; for flow back into the rebound chamber they are one."""
        count = len(FLOWS)
        one = parameters.rises_to_nodes(count, 1)
        matrix = np.hstack([np.tile(one[:, :1], (self.rows, 1)), np.kron(np.eye(self.rows), one[:, 1:])])
        levels = np.arange(self.rows) / (self.rows - 1)
        shape = np.diff(FLOWS[2:])
        rises = [np.append(0.1 + 0.45 * level, 0.6 * (1.0 + 0.3 * level) * shape) for level in levels]
        least = parameters.MIN_RISE * np.tile(np.append(1.0, shape), self.rows)
        start, low = np.concatenate([[BACK], *rises]), np.append(1e-4, least)
        return parameters.group("map", size * start, size * low, 10.0 * size, matrix)

    @cached_property
    def _places(self) -> I:
        return self.layout.places(NAMES)

    def arrays(self, k: F) -> ChamberArrays:
        """Return the kernel's view of the model."""
        s = self.scales
        return ChamberArrays(
            k, self._places, s.currents_A, s.speed_m_s * FLOWS, s.force_N * DROPS, s.force_N * SUCTIONS, s.positions_m,
            self.rows, self.friction, s.interval_s, s.max_acceleration_m_s2,
        )  # fmt: skip

    def body(self, theta: F) -> Chambers:
        """Return the structure with these parameters."""
        k, s = self.layout.k(theta), self.scales
        values = {g.name: self.layout.part(k, g.name) for g in self.layout.groups}
        friction = zip(values["friction"], values["friction_yield"], strict=True)
        return Chambers(
            parameters.build_valve(s, values),
            float(values["ratio"][0]),
            float(values["compression"][0]),
            float(values["rebound"][0]),
            float(values["mount"][0]),
            IncreasingCurve(parameters.as_floats(s.force_N * DROPS), parameters.as_floats(values["check"])),
            IncreasingCurve(parameters.as_floats(s.force_N * SUCTIONS), parameters.as_floats(values["refill"])),
            FlowMap(
                parameters.as_floats(s.speed_m_s * FLOWS),
                tuple(map(parameters.as_floats, values["map"].reshape(self.rows, -1))),
            ),
            float(values["growth"][0]),
            parameters.build_side(s, values, tuple(FrictionElement(float(a), float(b)) for a, b in friction)),
            REACH,
        )


def tick_facts(body: Chambers, model: Model) -> dict[str, object]:
    """Return the numbers and tables of the tick in C."""
    ratio, mount = 1.0 + body.area_ratio, body.mount_m_N
    growth = f"1.0 + ({number(body.friction_growth_1_N)} * past->rebound_N)"
    factor = f" * ((past->rebound_N > 0.0) ? ({growth}) : 1.0)"
    return {
        **physical_facts(body, model),
        "friction_factor": factor if body.friction_growth_1_N > 0.0 else "",
        "rows": len(body.map.rows),
        "map_tables": map_tables(body.map),
        "flow_tables": [*_flow_tables("CHECK", body.check), *_flow_tables("REFILL", body.refill)],
        "pieces": {"check": len(body.check.at) - 1, "refill": len(body.refill.at) - 1, "valve": len(body.map.at) - 1},
        "ratio": ratio,
        "stored": {
            "cc": body.compression_m_N + ratio * ratio * mount,
            "cr": -ratio * mount,
            "rr": body.rebound_m_N + mount,
        },
        "close": CLOSE,
        "quick_steps": QUICK_STEPS,
        "max_search_steps": MAX_SEARCH_STEPS,
    }


def _flow_tables(name: str, flow: IncreasingCurve) -> list[ConstantTable]:
    """Return the nodes of a flow over its pressure drop, and intercept and slope of its pieces."""
    slopes = find_slopes(flow.at, flow.values)
    starts = zip(flow.at, flow.values, slopes, strict=False)  # a piece begins at each node but the last
    return [
        ConstantTable(f"{name}_DROPS", flow.at),
        ConstantTable(f"{name}_OFFSETS", [value - slope * at for at, value, slope in starts]),
        ConstantTable(f"{name}_SLOPES", slopes),
    ]


KIT = physical_kit(
    ChambersModels,
    "two chambers with valves",
    Chambers,
    count_option("curves", "valve curves of a model with chambers", 2, 8),
    (3, 5),
    CTick("chambers", tick_facts, "model of two chambers"),
)
