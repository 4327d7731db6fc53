"""From your own CSV to a model: read columns, identify, validate on a recording that the fit has not seen, save.

    python examples/csv_to_model.py estimation.csv validation.csv model.json

The files have the columns time_s, position_m, current_A and force_N, with a header line.
"""

import sys

import numpy as np

from ces_identify import IdentifyOptions, Limits, Recording, identify, make_recording, validate


def read_csv(path: str) -> Recording:
    """Read one experiment; position and force are positive in compression."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    return make_recording(table["time_s"], table["position_m"], table["current_A"], table["force_N"], name=path)


def main(estimation_csv: str, validation_csv: str, model_json: str, seconds: float = 20.0) -> float:
    """Return the cost J [%] on the validation recording."""
    estimation, validation = read_csv(estimation_csv), read_csv(validation_csv)
    options = IdentifyOptions(limits=Limits(time=seconds, terms=12, starts=2))
    result = identify(estimation, options=options)
    evaluations = validate(result.model, validation)
    result.model.save(model_json)
    print(f"{result.model.size}, J = {evaluations[0].cost:.2f} % on {validation_csv}; wrote {model_json}")
    return evaluations[0].cost


if __name__ == "__main__":
    main(*sys.argv[1:4])
