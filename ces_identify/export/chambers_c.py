"""The parts of the exported C that depend on a model with chambers; templates/chambers.{c,h}.j2 hold the C."""

from __future__ import annotations

from ces_identify.export.c_text import ConstantTable
from ces_identify.export.physical_c import find_slopes, map_tables, physical_facts
from ces_observer.model import Model
from ces_observer.structures.chambers import Chambers
from ces_observer.structures.increasing_curves import IncreasingCurve

QUICK_STEPS = 4  # Newton steps in both pressures, before a search in one of them
MAX_SEARCH_STEPS = 200  # of a bisection: enough for any pair of floats of such numbers
CLOSE = 1e-13  # relative change of the pressure that ends the search


def chambers_facts(chambers: Chambers, model: Model) -> dict[str, object]:
    """Return the numbers and tables of the tick."""
    ratio, mount = 1.0 + chambers.area_ratio, chambers.mount_m_N
    return {
        **physical_facts(chambers.valve, chambers.side, chambers.reach, model),
        "rows": len(chambers.map.rows),
        "map_tables": map_tables(chambers.map),
        "flow_tables": [*_flow_tables("CHECK", chambers.check), *_flow_tables("REFILL", chambers.refill)],
        "pieces": {
            "check": len(chambers.check.at) - 1,
            "refill": len(chambers.refill.at) - 1,
            "valve": len(chambers.map.at) - 1,
        },
        "ratio": ratio,
        "stored": {
            "cc": chambers.compression_m_N + ratio * ratio * mount,
            "cr": -ratio * mount,
            "rr": chambers.rebound_m_N + mount,
        },
        "growth": chambers.friction_growth_1_N,
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
