"""The gap between a simulation and recordings of the real damper: where it lies, which effect causes it, what helps.

The rooms in reading order: `trace` (recording and simulation on one grid), `effects` (the physics that a simulation may
lack), `baseline` (what the simulation gets wrong without any effect), `inputs` (checked inputs), `inference` (which
effects, how sure), `regions` (in which stroke, speed, current ...), `experiment` (what to record next), `augmented`
(the repaired simulation as a file), `report` (page and gap.json), `fleet` (many diagnoses). `pipeline` runs them.

The names below are what effects of a user's own need; they are imported when they are first used. `import ces` gives
the rest.
"""

from typing import TYPE_CHECKING

from ces_observer.lazy_names import import_on_use

if TYPE_CHECKING:
    from ces_gap.effects.effect import CELL, FLUID, MOTION, PARALLEL, SENSOR, VALVE, Effect, EffectParameter

__all__ = ["CELL", "FLUID", "MOTION", "PARALLEL", "SENSOR", "VALVE", "Effect", "EffectParameter"]

__getattr__ = import_on_use(__name__, {"ces_gap.effects.effect": __all__})
