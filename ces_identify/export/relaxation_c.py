"""The parts of the exported C that depend on a relaxation model; templates/relaxation.{c,h}.j2 hold the C."""

from __future__ import annotations

from ces_identify.export.c_text import ConstantTable
from ces_identify.export.physical_c import map_tables, physical_facts
from ces_observer.model import Model
from ces_observer.structures.relaxation import Relaxation

MAX_NEWTON_STEPS = 200  # in a bracket: enough for any pair of floats of such numbers
CLOSE = 1e-13  # relative change of the flow that ends a step


def relaxation_facts(relaxation: Relaxation, model: Model) -> dict[str, object]:
    """Return the numbers and tables of the tick."""
    facts = physical_facts(relaxation.valve, relaxation.side, relaxation.reach, model)
    interval = 1.0 / model.sampling.rate_Hz
    rows = range(len(relaxation.map.rows))
    return {
        **facts,
        "rows": len(rows),
        "map_tables": map_tables(relaxation.map),
        "springs": len(relaxation.springs),
        "spring_tables": [
            ConstantTable("RESTORING", [stiffness for stiffness, _ in relaxation.restoring]),
            ConstantTable("RESTORING_LIMITS", [limit for _, limit in relaxation.restoring]),
            ConstantTable("SPRING_STEPS", [one.stiffness_N_m * interval for one in relaxation.springs]),
            ConstantTable(
                "YIELDS", [one.yield_N[row] for row in rows for one in relaxation.springs], len(relaxation.springs)
            ),
        ],
        "mid_stroke": relaxation.mid_stroke_m,
        "pieces": len(relaxation.map.at) - 1,
        "compliance": relaxation.compliance_m_N,
        "held": relaxation.compliance_m_N + interval * relaxation.leak_m_Ns,
        "close": CLOSE,
        "max_newton_steps": MAX_NEWTON_STEPS,
    }
