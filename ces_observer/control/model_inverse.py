"""What a controller needs of a model: the inverse of its steady force, and how far that lags behind the current.

Making it takes a second or two, which running estimates could not wait for: as text it passes from the process that
makes it to the one that controls.
"""

from __future__ import annotations

import json
from dataclasses import dataclass

from ces_observer.control.inverse_map import InverseMap
from ces_observer.control.steady_force import compute_inverse_map, current_lag_s
from ces_observer.model import Model


@dataclass(frozen=True)
class ModelInverse:
    """The inverse map, and the lag of the model's force behind the current [s]."""

    map: InverseMap
    lag_s: float

    @classmethod
    def from_model(cls, model: Model, source: str = "model") -> ModelInverse:
        """Make it; raises ModelError, naming `source`, if the model's envelope is none to control in."""
        return cls(compute_inverse_map(model, source), current_lag_s(model))

    def to_json(self) -> str:
        """Return it as text, every number exactly."""
        return json.dumps({"lag_s": self.lag_s, "map": vars(self.map)})

    @classmethod
    def from_json(cls, text: str) -> ModelInverse:
        """Return what `to_json` made a text of."""
        read = json.loads(text)
        speeds, currents, forces = (read["map"][name] for name in ("speeds_m_s", "currents_A", "forces_N"))
        return cls(InverseMap(tuple(speeds), tuple(currents), tuple(map(tuple, forces))), read["lag_s"])
