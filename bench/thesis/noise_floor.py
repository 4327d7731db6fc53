"""The limit for any model: the cost J that measurement noise alone causes on each packaged experiment.

    python -m bench.thesis.noise_floor

prints a Markdown table: J of the measured against the noise-free force, and J of the damper itself driven with the
recorded, noisy position and current (`load_rig`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ces_identify.preparation.cost import cost
from ces_identify.recordings.recording import Recording
from ces_rig.experiment import Experiment, load_experiment, measure, packaged_experiments, simulate_truth
from ces_rig.simulation import make_rig_force

Array = NDArray[np.float64]


def noise_floors(experiment: Experiment) -> tuple[float, float]:
    """Return J of the measured force against the noise-free one, and against the damper driven with the recording."""
    true = simulate_truth(experiment)
    recording = measure(experiment, true)
    force = recording.channel("force")
    _, noise_free = experiment.sensors.force.sample(true.time_s, true.force_N)
    return cost(force.values, noise_free), cost(force.values, simulate_driven(experiment, recording))


def simulate_driven(experiment: Experiment, recording: Recording) -> Array:
    """Return the force [N] of the damper driven with the recorded position and current, at the force's stamps."""
    position, current, force = (recording.channel(name) for name in ("position", "current", "force"))
    time = (position.stamps_ns - position.stamps_ns[0]) * 1e-9
    measured_current = experiment.sensors.current_source == "measured"
    function = make_rig_force(experiment.damper, experiment.settings.tare, measured_current)
    simulated = function(time, position.values, np.interp(position.stamps_ns, current.stamps_ns, current.values))
    return np.asarray(np.interp(force.stamps_ns, position.stamps_ns, simulated))


if __name__ == "__main__":
    print("| experiment | noise floor J | the damper itself on the recorded position J |\n|---|---:|---:|")
    for name, path in packaged_experiments().items():
        print("| {} | {:.2f} | {:.2f} |".format(name, *noise_floors(load_experiment(path))))
