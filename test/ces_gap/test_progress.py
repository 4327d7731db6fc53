"""Optional steps: what the data prevent becomes a note, a mistake in the program surfaces."""

from __future__ import annotations

import numpy as np
import pytest

from ces_gap.errors import GapError
from ces_gap.progress import OptionalSteps


def refuse() -> int:
    raise GapError("too short; record longer")


def test_a_result_passes_and_leaves_no_note() -> None:
    steps = OptionalSteps()
    assert steps.run("map", lambda: 3, 0) == 3 and steps.notes == []


def test_a_refusal_and_numerical_errors_become_notes() -> None:
    steps = OptionalSteps()
    assert steps.run("map", refuse, 7) == 7
    assert steps.run("inverse", lambda: float(np.linalg.inv(np.zeros((2, 2)))[0, 0]), 1.0) == 1.0
    assert steps.notes[0] == "map not available: too short; record longer"
    assert steps.notes[1].startswith("inverse not available: ")


@pytest.mark.parametrize("mistake", [lambda: {}["a"], lambda: int("x")])
def test_a_mistake_in_the_program_surfaces(mistake: object) -> None:
    with pytest.raises((LookupError, ValueError)):
        OptionalSteps().run("map", mistake, None)  # type: ignore[arg-type]
