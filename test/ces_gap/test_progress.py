"""Optional steps: what the data prevent becomes a note, a mistake in the program surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from ces_gap.errors import GapError
from ces_gap.progress import OptionalSteps


def test_what_the_data_prevent_becomes_a_note_and_a_mistake_surfaces() -> None:
    def refuse() -> int:
        raise GapError("too short; record longer")

    steps = OptionalSteps()
    assert steps.run("map", lambda: 3, 0) == 3 and steps.notes == []
    assert steps.run("map", refuse, 7) == 7
    assert steps.run("inverse", lambda: float(np.linalg.inv(np.zeros((2, 2)))[0, 0]), 1.0) == 1.0
    assert steps.notes[0] == "map not available: too short; record longer"
    assert steps.notes[1].startswith("inverse not available: ")
    with pytest.raises(LookupError):
        steps.run("map", lambda: {}["a"], None)
