"""A model in your own simulation loop: a mass on a spring and the estimated damper, one estimator step a sample.

    python examples/model_in_a_loop.py config/models/sample.json

The same samples as arrays give the same forces (`ces.simulate`).
"""

import sys

import numpy as np

import ces

STEP_NS = 1_000_000  # 1 kHz
MASS_kg, SPRING_N_m, CURRENT_A = 250.0, 40_000.0, 0.5


def main(model_json: str, seconds: float = 3.0) -> float:
    """Return the largest difference [N] between the loop's forces and the batch simulation."""
    model = ces.Model.load(model_json)
    estimator = ces.Estimator(model)
    position_m, speed_m_s, forces, positions = 0.02, 0.0, [], []
    stamps = range(0, round(seconds * 1e9), STEP_NS)
    for stamp_ns in stamps:
        force_N = estimator.step(stamp_ns, position_m, CURRENT_A)  # None: withheld, estimator.reason says why
        forces.append(np.nan if force_N is None else force_N)
        positions.append(position_m)
        acceleration = -(SPRING_N_m * position_m + (force_N or 0.0)) / MASS_kg
        speed_m_s += acceleration * STEP_NS * 1e-9
        position_m += speed_m_s * STEP_NS * 1e-9
    batch = ces.simulate(model, np.array(stamps) * 1e-9, positions, CURRENT_A)
    difference = float(np.nanmax(np.abs(np.array(forces) - batch)))
    print(f"amplitude {max(positions[-500:]):.4f} m after {seconds:g} s; loop and batch differ by {difference:.1e} N")
    return difference


if __name__ == "__main__":
    main(sys.argv[1])
