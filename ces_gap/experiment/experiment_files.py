"""The next experiment and the files that describe it: one for `ces rig`, one for a real rig."""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from typing import Any

import numpy as np
import yaml

from ces_gap.trace import F
from ces_identify.schema_files import schema_line


@dataclass(frozen=True)
class NextExperiment:
    """The next experiment: `recipe` for `ces rig`; `time_s`, `position_m`, `current_A` (n,) for its CSV file.

    `separates` are the effects that it distinguishes, `distance_N` [N] RMS the difference of their forces.
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
    """Return texts by name: `next_experiment.yaml`, which `ces rig` runs, and `next_experiment.csv` for a real rig."""
    table, header = StringIO(), "time_s,position_m,current_A"
    columns = np.stack([experiment.time_s, experiment.position_m, experiment.current_A], axis=1)
    np.savetxt(table, columns, fmt=("%.3f", "%.7f", "%.4f"), delimiter=",", header=header, comments="")
    purpose = " ".join(experiment.purpose.split())
    recipe = f"{schema_line('experiment')}# {purpose}\n" + yaml.safe_dump(
        experiment.recipe, sort_keys=False, allow_unicode=True
    )
    return {"next_experiment.csv": table.getvalue(), "next_experiment.yaml": recipe}
