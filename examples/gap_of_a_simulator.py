"""The gap of your own simulator: a Python function that lacks friction, recordings of a damper that has it.

    python examples/gap_of_a_simulator.py out_folder

Replace `my_damper` by your simulator and `record` by `ces.Recording.load("my_bag")`.
"""

import sys

import numpy as np

import ces

RATE_Hz, NOISE_N, FRICTION_N = 250.0, 5.0, 60.0


def my_damper(time_s: np.ndarray, position_m: np.ndarray, current_A: np.ndarray) -> np.ndarray:
    """Return the simulated force [N]: damping that grows with the current, no friction."""
    return (800.0 + 1200.0 * current_A) * np.gradient(position_m, time_s)


def record(seed: int, friction_N: float, seconds: float = 12.0) -> ces.Recording:
    """Return a synthetic recording of the damper with seal friction."""
    random = np.random.default_rng(seed)
    time_s = np.arange(round(seconds * RATE_Hz)) / RATE_Hz
    tones = zip(random.uniform(0.002, 0.006, 5), random.uniform(0.5, 6.0, 5), random.uniform(0.0, 6.0, 5), strict=True)
    position_m = sum(a * np.sin(2 * np.pi * f * time_s + phase) for a, f, phase in tones)
    current_A = 0.6 + 0.3 * np.sign(np.sin(2 * np.pi * 0.7 * time_s + seed))
    friction = friction_N * np.tanh(np.gradient(position_m, time_s) / 0.01)
    force_N = my_damper(time_s, position_m, current_A) + friction + random.normal(0.0, NOISE_N, len(time_s))
    return ces.Recording.from_arrays(time_s, position_m, current_A, force_N, name=f"run {seed}")


def main(folder: str) -> str:
    """Return the verdict in a sentence."""
    new, worn = record(1, friction_N=0.0), [record(2, FRICTION_N), record(3, FRICTION_N)]
    diagnosis = ces.diagnose(my_damper, worn, reference=[new], experiment=False, out=folder, overwrite=True)
    print(diagnosis.sentence)
    print("written:", folder)
    return diagnosis.sentence


if __name__ == "__main__":
    main(sys.argv[1])
