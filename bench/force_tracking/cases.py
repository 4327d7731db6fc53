"""Plants that changed after the model was identified, and models identified on the changed plants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ces_identify.identification import identify
from ces_identify.polynomial.search_limits import Limits
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.model import Model
from ces_rig.dampers.effects import WithheldEffect
from ces_rig.dampers.hydraulic.effects import Hydraulic
from ces_rig.dampers.hydraulic.parameters import Damper
from ces_rig.experiment import GRID_S, load_experiment, measure_signals, packaged_experiments
from ces_rig.live.rig import RigSettings
from ces_rig.live.script import Script
from ces_rig.withheld import plants
from ces_rig.withheld.scaling import scale_to_gap

GAP_N = 150.0  # [N] RMS over SCALING_S of the noise stroke: about 12 % of the force
SCALING_S = 8.0
IDENTIFIED = ("noise", "sweep", "road")  # packaged experiments, those of the sample model
FIRST_SEED = 100  # of runs; identification has its own
STROKES: Mapping[str, RigSettings] = {
    "noise stroke": RigSettings(drive="script", script=Script(kind="noise", amplitude_m=0.025, loop_s=60.0)),
    "vehicle on a road": RigSettings(drive="vehicle"),
}
PLANT = plants.BlindPlant("hydraulic", Hydraulic(Damper()))


@dataclass(frozen=True)
class TrackingCase:
    """A change in a plant: an effect, or a driver whose current differs from its command."""

    name: str
    effect: str = ""
    driver: float = 1.0

    def draw_effect(self, seed: int) -> WithheldEffect | None:
        """Return the effect with proportions drawn from `seed`, scaled to a gap of GAP_N."""
        if not self.effect:
            return None
        effect = plants.draw_effect(PLANT.kind, self.effect, np.random.default_rng([seed, 1]))
        time = np.arange(round(SCALING_S / GRID_S) + 1) * GRID_S
        experiment = load_experiment(packaged_experiments()["road"])
        stroke = load_experiment(packaged_experiments()["noise"]).stroke.samples(time, np.random.default_rng([seed, 2]))
        current = experiment.current.samples(time, stroke, np.random.default_rng([seed, 3]))
        return scale_to_gap(PLANT, effect, GAP_N, time, stroke, current)


CASES = (
    TrackingCase("as identified"),
    TrackingCase("driver gives 85 % of the command", driver=0.85),
    TrackingCase("driver gives 115 % of the command", driver=1.15),
    TrackingCase("valve lag", "valve_lag"),
    TrackingCase("friction", "friction"),
    TrackingCase("temperature fade", "temperature_fade"),
    TrackingCase("leakage", "leakage"),
    TrackingCase("current sensor's scale", "current_scale"),
)


def with_effect(settings: RigSettings, withheld: WithheldEffect | None, seed: int) -> RigSettings:
    """Return the rig's settings with the effect."""
    if withheld is None:
        return replace(settings, seed=FIRST_SEED + seed)
    numbers = {"severity": withheld.severity, **withheld.proportions}
    text = ", ".join(f"{key}: {value!r}" for key, value in numbers.items())
    return replace(settings, seed=FIRST_SEED + seed, withheld=(f"{withheld.name}: {{{text}}}",))


def identify_again(withheld: WithheldEffect | None, seed: int, starts: int) -> Model:
    """Return a model of the changed plant, identified on the experiments of the sample model."""
    recordings = []
    for name in IDENTIFIED:
        experiment = load_experiment(packaged_experiments()[name])
        time = np.arange(round(experiment.settings.duration_s / GRID_S) + 1) * GRID_S
        stroke = experiment.stroke.samples(time, np.random.default_rng([seed, 4]))
        current = experiment.current.samples(time, stroke, np.random.default_rng([seed, 5]))
        true = plants.simulate_signals(PLANT, () if withheld is None else (withheld,), time, stroke, current)
        recordings.append(measure_signals(true, experiment.sensors, seed, name))
    limits = Limits(starts=starts, threads=1, seconds=600.0)
    return identify(recordings, (), IdentifyOptions(split=1.0, limits=limits)).model
