"""Heat of a damper over an iteration: stroke and current go in, power and the rest that it needs come out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.simulations.simulate import simulate_series
from ces_iterate.commands import INTERVAL_S, Commands
from ces_iterate.design.designer import PowerModel
from ces_iterate.design.knowledge import series_of
from ces_iterate.design.recorded import dissipated_W
from ces_iterate.plan.limits import HeatLimits
from ces_observer.model import Model

F = NDArray[np.float64]

START_SHARE = 0.5  # of the limit: the load at which an experiment may begin


def make_power_model(model: Model | None, heat: HeatLimits) -> PowerModel:
    """Return what predicts the dissipated power: the model, or without one the expected force times the speed."""

    def expected(stroke_m: F, current_A: F) -> F:
        return np.asarray(heat.force_N * np.abs(np.gradient(stroke_m, INTERVAL_S)))

    def simulated(stroke_m: F, current_A: F) -> F:
        assert model is not None
        series = series_of(Commands("candidate", stroke_m, current_A), model.sampling.rate_Hz)
        power = dissipated_W(simulate_series(model, series).force, series.speed)
        power = np.where(np.isfinite(power), power, heat.force_N * np.abs(series.speed))
        return np.asarray(np.interp(np.arange(len(stroke_m)) * INTERVAL_S, series.time_s, power))

    return expected if model is None else simulated


def plan_rest(heat: HeatLimits, load_W: float) -> tuple[float, float]:
    """Return the rest [s] that a damper needs before an experiment, and its load [W] afterwards."""
    rest = heat.cool_down_s(load_W, START_SHARE * heat.power_W)
    return rest, load_W * float(np.exp(-rest / heat.memory_s))
