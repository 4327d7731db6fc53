"""The tick of a hydraulic network in C: numbers and tables for hydraulic.{c,h}.j2."""

from __future__ import annotations

from itertools import chain

from ces_identify.structures.kit import ConstantTable, number
from ces_identify.structures.physical import curve_tables, physical_facts
from ces_observer.model import Model
from ces_observer.structures.curves import Bypass, FlowMap
from ces_observer.structures.hydraulic import (
    CLOSE,
    EDGES,
    MAX_STEPS,
    NEAR,
    PATIENCE,
    ROUNDING,
    STILL_N,
    TURN,
    WARMEST,
    WARMING_S,
    Hydraulic,
    oil_pieces,
)


def tick_facts(body: Hydraulic, model: Model) -> dict[str, object]:
    """Return the numbers and tables of the tick in C; compliances are those by tick."""
    rate, growth = model.sampling.rate_Hz, body.friction_growth_1_N
    flows: dict[str, FlowMap] = {name: getattr(body, name) for name in EDGES}
    tables = [
        [
            ConstantTable(f"{name}_FLOWS".upper(), flow.at),
            ConstantTable(f"{name}_DROPS".upper(), list(chain(*flow.rows))),
        ]
        for name, flow in flows.items()
    ]
    shares = [1.0 / (1.0 + rate * getattr(body, f"{name}_s")) for name in EDGES]
    factor = f" * (1.0 + ({number(growth)} * fmax(past->pressures[1], 0.0)))" if growth else ""
    return {
        **physical_facts(body, model),
        "friction_factor": factor,
        "edges": [
            {"name": name.upper(), "nodes": len(flow.at), "rows": len(flow.rows), "new_share": share}
            for (name, flow), share in zip(flows.items(), shares, strict=True)
        ],
        "edge_tables": list(chain(*tables)),
        **_oil_facts(body),
        **_bypass_facts(body.bypass),
        "bypass_laminar_N": body.bypass_laminar_N,
        "fade": body.fade_1_W,
        "warming": 1.0 / (1.0 + rate * WARMING_S),
        "warmest": WARMEST,
        "spring_m_N": body.mount_m_N,
        "ratio": 1.0 + body.area_ratio,
        "compression": _write_compliance(rate * body.compression_m_N, body.compression_growth_1_m),
        "rebound": _write_compliance(rate * body.rebound_m_N, body.rebound_growth_1_m),
        "mount": rate * body.mount_m_N,
        "give": rate * body.mount_m_N + body.creep_m_Ns,
        "laminar_N": body.laminar_N,
        "most_N": body.most_N,
        "still_N": STILL_N,
        "max_steps": MAX_STEPS,
        "patience": PATIENCE,
        "turn": TURN,
        "rounding": ROUNDING,
        "near": NEAR,
        "close": CLOSE,
    }


def _write_compliance(compliance_m_N: float, growth_1_m: float) -> str:
    """Return the C text of a chamber's compliance, which grows over the stroke."""
    return number(compliance_m_N) + (f" * exp({number(growth_1_m)} * position)" if growth_1_m else "")


def _oil_facts(body: Hydraulic) -> dict[str, object]:
    """Return the pieces of the oil's curve, and the one in use at a start."""
    pieces = oil_pieces(body.reservoir_N, body.air)
    _, ends, values, slopes = zip(*pieces, strict=True)
    return {
        "oil_pieces": len(pieces),
        "oil_at_rest": next(n for n, end in enumerate(ends) if end >= 0.0),
        "oil_tables": [
            ConstantTable("OIL_ENDS", [-body.reservoir_N, *ends[:-1]]),
            ConstantTable("OIL", values),
            ConstantTable("OIL_SLOPES", slopes),
        ],
    }


def _bypass_facts(bypass: Bypass | None) -> dict[str, object]:
    if bypass is None:
        return {"bypass_tables": []}
    tables = curve_tables("BYPASS_POSITIONS", "BYPASS", bypass.position_m, bypass.logarithms)
    return {"bypass_tables": tables, "bypass_pieces": len(bypass.values) - 1}
