"""Which effects a recalibration of the simulation would explain as well, without references."""

from __future__ import annotations

import numpy as np

from ces_gap.effects.simulation_errors import calibration
from ces_gap.inference.fit import EffectFit
from ces_gap.inference.search import EffectSearchResult

MIN_ABSORBED_SHARE = 0.8  # share of a signature's energy inside the map that makes the effect not separable


def find_absorbed_effects(result: EffectSearchResult) -> tuple[str, ...]:
    """Return the effects whose signatures lie mostly inside the calibration's map; none with references."""
    maps = [f for f in result.alone if f.effects[0] in calibration.FORMS]
    return tuple(f.names[0] for f in result.alone if maps and f not in maps and _is_inside(result, f, maps[0]))


def _is_inside(result: EffectSearchResult, fit: EffectFit, calibrated: EffectFit) -> bool:
    signature = result.baseline_residual - fit.residual
    scale = np.linalg.norm(calibrated.jacobian, axis=0)
    tangents = calibrated.jacobian[:, scale > 0.0] / scale[scale > 0.0]
    outside = signature - tangents @ np.linalg.lstsq(tangents, signature, rcond=None)[0]
    return bool(outside @ outside < (1.0 - MIN_ABSORBED_SHARE) * (signature @ signature))
