"""The experiment that would tell more, and the files that describe it: one for `ces rig`, one for a real rig."""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

F = NDArray[np.float64]


@dataclass(frozen=True)
class NextExperiment:
    """The experiment that would tell more: `recipe` for `ces rig`; `time_s`, `position_m`, `current_A` (n,) its CSV.

    `separates` are the effects it tells apart and `distance_N` by how much; empty where no twin asked for it.
    """

    name: str
    purpose: str
    recipe: dict[str, Any]
    time_s: F
    position_m: F
    current_A: F
    separates: tuple[str, ...] = ()
    distance_N: float = 0.0


def experiment_files(experiment: NextExperiment) -> dict[str, str]:
    """Return the texts by name: `next_experiment.yaml`, which `ces rig` runs, and `next_experiment.csv` for a real rig.

    The columns are `time_s,position_m,current_A`.
    """
    text = StringIO()
    columns = np.stack([experiment.time_s, experiment.position_m, experiment.current_A], axis=1)
    np.savetxt(
        text, columns, fmt=("%.3f", "%.7f", "%.4f"), delimiter=",", header="time_s,position_m,current_A", comments=""
    )
    purpose = " ".join(experiment.purpose.split())
    described = f"# {purpose}\n" + yaml.safe_dump(experiment.recipe, sort_keys=False, allow_unicode=True)
    return {"next_experiment.csv": text.getvalue(), "next_experiment.yaml": described}
