"""What a controller needs from a model: the inverse map of its steady force, and the lag of force behind current.

Computing it takes a second or two, too long for a running controller: another process does, and passes it on as text.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from math import isfinite

from ces_observer.control.inverse_map import InverseMap
from ces_observer.control.steady_force import compute_inverse_map, current_lag_s
from ces_observer.errors import ModelError
from ces_observer.model import Model


@dataclass(frozen=True)
class ModelInverse:
    """The inverse map, and the lag of the model's force behind the current [s]."""

    map: InverseMap
    lag_s: float

    @classmethod
    def from_model(cls, model: Model, source: str = "model") -> ModelInverse:
        """Compute it; raises ModelError, naming `source`, if the model's envelope does not suffice for control."""
        return cls(compute_inverse_map(model, source), current_lag_s(model))

    def to_json(self) -> str:
        """Return it as text, with exact numbers."""
        return json.dumps({"lag_s": self.lag_s, "map": vars(self.map)})

    @classmethod
    def from_json(cls, text: str) -> ModelInverse:
        """Return the inverse whose text `to_json` returned; raises ModelError for any other text."""
        try:
            values = json.loads(text)
            speeds, currents, forces = (values["map"][name] for name in ("speeds_m_s", "currents_A", "forces_N"))
            table = InverseMap(tuple(speeds), tuple(currents), tuple(map(tuple, forces)))
            if isfinite(values["lag_s"]):
                return cls(table, values["lag_s"])
        except (ValueError, TypeError, KeyError, RecursionError):
            pass
        raise ModelError("the inverse of the model cannot be read; expected the text that the model's check writes")
