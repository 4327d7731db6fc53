"""Plants that changed after the model was identified, and the model identified anew on what they have become."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ces_identify.identify import identify
from ces_identify.polynomial.limits import Limits
from ces_identify.structure_kit import Options
from ces_observer.model import Model
from ces_rig.dampers.effects import Withheld
from ces_rig.dampers.hydraulic.effects import Hydraulic
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.experiment import GRID_S, load_experiment, measured, packaged
from ces_rig.live.rig import Settings
from ces_rig.live.script import Script
from ces_rig.withheld import plants
from ces_rig.withheld.scaling import scale_to

GAP_N = 150.0  # RMS on SCALING_S of noise stroke: some 12 % of the force
SCALING_S = 8.0
IDENTIFIED = ("noise", "sweep", "road")  # packaged experiments, as the sample model
FIRST_SEED = 100  # of runs; identification has its own
STROKES: Mapping[str, Settings] = {
    "noise stroke": Settings(drive="script", script=Script(kind="noise", amplitude_m=0.025, loop_s=60.0)),
    "vehicle on a road": Settings(drive="vehicle"),
}
PLANT = plants.Plant("hydraulic", Hydraulic(Damper()))


@dataclass(frozen=True)
class Case:
    """What is changed in a plant: an effect, or a driver that gives another current than it is told."""

    name: str
    effect: str = ""
    driver: float = 1.0

    def drawn(self, seed: int) -> Withheld | None:
        """Return the effect with proportions drawn by `seed`, as strong as to make a gap of GAP_N."""
        if not self.effect:
            return None
        drawn = plants.draw(PLANT.kind, self.effect, np.random.default_rng([seed, 1]))
        time = np.arange(round(SCALING_S / GRID_S) + 1) * GRID_S
        experiment = load_experiment(packaged()["road"])
        stroke = load_experiment(packaged()["noise"]).stroke.samples(time, np.random.default_rng([seed, 2]))
        current = experiment.current.samples(time, stroke, np.random.default_rng([seed, 3]))
        return scale_to(PLANT, drawn, GAP_N, time, stroke, current)


CASES = (
    Case("as identified"),
    Case("driver gives 85 % of the command", driver=0.85),
    Case("driver gives 115 % of the command", driver=1.15),
    Case("valve lag", "valve_lag"),
    Case("friction", "friction"),
    Case("temperature fade", "temperature_fade"),
    Case("leakage", "leakage"),
    Case("current sensor's scale", "current_scale"),
)


def rigged(settings: Settings, withheld: Withheld | None, seed: int) -> Settings:
    """Return the rig's settings with the effect in it."""
    if withheld is None:
        return replace(settings, seed=FIRST_SEED + seed)
    numbers = {"severity": withheld.severity, **withheld.proportions}
    told = ", ".join(f"{key}: {value!r}" for key, value in numbers.items())
    return replace(settings, seed=FIRST_SEED + seed, withheld=(f"{withheld.name}: {{{told}}}",))


def identified_anew(withheld: Withheld | None, seed: int, starts: int) -> Model:
    """Return a model of the changed plant, identified on the experiments that the sample model is of."""
    recordings = []
    for name in IDENTIFIED:
        experiment = load_experiment(packaged()[name])
        time = np.arange(round(experiment.settings.duration_s / GRID_S) + 1) * GRID_S
        stroke = experiment.stroke.samples(time, np.random.default_rng([seed, 4]))
        current = experiment.current.samples(time, stroke, np.random.default_rng([seed, 5]))
        true = plants.signals(PLANT, () if withheld is None else (withheld,), time, stroke, current)
        recordings.append(measured(true, experiment.sensors, seed, name))
    limits = Limits(starts=starts, threads=1, seconds=600.0)
    return identify(recordings, (), Options(split=1.0, limits=limits)).model
