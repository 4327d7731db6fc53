"""Short rides of the virtual rig, and a baseline identified from two of them."""

from functools import cache

import pytest

from ces_data.recording import Recording
from ces_gap.baseline.identified import IdentifiedBaseline, identify_baseline
from ces_identify.structures.auto import default_sizes
from ces_rig.experiments.virtual import parse_experiment, run

SLOW = "slow"  # a pilot stage that needs twice as long


@cache
def rig_ride(seed: int, worn: str = "", seconds: float = 8.0) -> Recording:
    """A random stroke under a random current; `worn` names what is wrong with the damper."""
    damper = {"ces_valve": {"pilot_rise_s": 0.022, "pilot_fall_s": 0.016}} if worn == SLOW else {}
    description = {
        "name": f"{worn or 'new'}{seed}",
        "duration_s": seconds,
        "seed": seed,
        "stroke": {"kind": "noise", "peak_to_peak_m": 0.07, "cutoff_Hz": 8.0},
        "current": {"kind": "filtered_noise", "cutoff_Hz": 4.0},
        "damper": damper,
    }
    return run(parse_experiment(description, "rig_rides"))


@cache
def identified() -> IdentifiedBaseline:
    """A small hydraulic network of two rides of the new damper."""
    with pytest.MonkeyPatch.context() as patch:
        sizes = {**default_sizes(), "kind": "uniflow", "curves": "2"}
        patch.setattr("ces_gap.baseline.identified.default_sizes", lambda: sizes)
        return identify_baseline([rig_ride(1), rig_ride(2)], structure="hydraulic")
