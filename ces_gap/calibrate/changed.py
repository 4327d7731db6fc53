"""Parameters that differ from those of the references' damper, as one effect in a few forms: evidence in, effects out.

The references teach what the simulation with its own values leaves; parameters that have changed since compete beside
that correction. A form frees the set of one size that explains most on the tangents at the simulation's values.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ces_data.arrays import F
from ces_gap.calibrate.free import choose_free
from ces_gap.calibrate.parameters import SimulationParameters, find_determined, signatures, with_steps
from ces_gap.calibrate.remembered import RememberedSimulation
from ces_gap.inference.evidence import Evidence
from ces_gap.limits import ParameterLimits
from ces_identify.simulations.simulation import Simulation


def changed_parameters(
    simulation: Simulation, spec: str, evidence: Evidence, fit: Sequence[str]
) -> list[SimulationParameters]:
    """Return the forms of the effect that parameters named by `fit` have changed; none if nothing is determined."""
    free = choose_free(simulation, fit, spec).numbers
    whole = SimulationParameters(RememberedSimulation(simulation), free, adds=True)
    whole = with_steps(whole, evidence.traces, evidence.noise.rms_N)
    start = np.array([p.to_search(p.starts[0]) for p in free])
    jacobian = evidence.whiten(signatures(whole, start, evidence.traces))
    residual, determined = evidence.residual(evidence.alone), find_determined(jacobian, free)
    forms = []
    count = len(determined)
    for size in {*range(1, min(ParameterLimits.MAX_FREED, count) + 1), *([count] if count else [])}:
        steps = {places: _step(jacobian[:, places], residual) for places in combinations(determined, size)}
        best = max(steps, key=lambda places: float(steps[places] @ jacobian[:, places].T @ residual))
        forms.append(whole.hold_others(best).begin_at(start[list(best)] + steps[best]))
    return forms


def _step(jacobian: F, residual: F) -> F:
    """Return the Gauss-Newton step (p,) that explains a residual (r,)."""
    return np.asarray(np.linalg.lstsq(jacobian, residual, rcond=1e-9)[0])
