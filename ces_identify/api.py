"""The functions for scripts: read a recording, identify, simulate, validate, compare, plot.

Import them from `ces_identify`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ces_identify import identification
from ces_identify.comparison.compared_model import make_compared_model
from ces_identify.comparison.comparison import Comparison, compare
from ces_identify.identification import IdentificationResult
from ces_identify.polynomial.search_limits import Listener
from ces_identify.preparation.series import prepare
from ces_identify.recordings import bag_reader, log_import
from ces_identify.recordings.bag_writer import recording_topics, write_bag
from ces_identify.recordings.checks import require_usable
from ces_identify.recordings.log_mapping import load_dyno_mapping
from ces_identify.recordings.recording import Channel, Recording
from ces_identify.recordings.signals_file import load_signals
from ces_identify.sense.content import require_distinct
from ces_identify.sense.sense import require_sensible, sense_together
from ces_identify.simulations.simulate import sample_force
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.structures import KITS
from ces_identify.structures.kit import IdentifyOptions, Size
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.errors import CesError
from ces_observer.model import Model

if TYPE_CHECKING:
    from matplotlib.figure import Figure

EPOCH_NS = 10**18  # stamps of recordings made of arrays count from here


def read_recording(
    path: str | Path, *, signals: str | Path | None = None, need: Sequence[str] = ("position", "current", "force")
) -> Recording:
    """Read and check a rosbag2 folder or `.mcap` file; `signals` is a signals file (default: the packaged one).

    Each signal in `need` must be there. Warns of what looks wrong; raises CesError for what cannot be used.
    """
    recording = bag_reader.read_recording(Path(path), load_signals(Path(signals) if signals else None), need)
    _warn(recording)
    return recording


def read_log(path: str | Path, *, mapping: str | Path) -> Recording:
    """Read and check a log of any format that `ces import` reads; `mapping` is its mapping file. Raises CesError."""
    recording = log_import.import_log(Path(path), load_dyno_mapping(Path(mapping)))
    _warn(recording)
    return recording


def make_recording(
    time_s: ArrayLike, position_m: ArrayLike, current_A: ArrayLike, force_N: ArrayLike | None = None, *, name: str = ""
) -> Recording:
    """Return a recording of arrays of shape (n,); position and force are positive in compression."""
    stamps = EPOCH_NS + np.rint(np.asarray(time_s, dtype=np.float64) * 1e9).astype(np.int64)
    columns = {"position": ("m", position_m), "current": ("A", current_A), "force": ("N", force_N)}
    channels = {
        signal: Channel(signal, unit, stamps, np.asarray(values, dtype=np.float64))
        for signal, (unit, values) in columns.items()
        if values is not None
    }
    return Recording(name or "recording", channels)


def write_recording(recording: Recording, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a recording as a rosbag2 folder with the topics of the packaged signals file. Raises CesError."""
    write_bag(Path(path), recording_topics(recording, load_signals()), overwrite=overwrite)


def identify(
    recordings: Recording | Sequence[Recording],
    *,
    validation: Sequence[Recording] = (),
    structure: str = "polynomial",
    options: IdentifyOptions | None = None,
    listener: Listener = lambda result: None,
    go_on: bool = False,
    **sizes: Size,
) -> IdentificationResult:
    """Identify a model; neither the fit nor the selection sees the `validation` recordings.

    `structure` is "polynomial", "sigmoid" (sizes `units` and `lags`, such as "2,4,5") or "anfis" (size `rules`, such as
    "7x2", or `memberships`, such as "4x4"). `listener` is called with each improvement. Warns of what looks wrong;
    raises CesError if the recordings hold too little, have seconds in common, or would make a wrong model (sign, units,
    delays), unless `go_on`.

        result = identify([read_recording("bags/noise")], validation=[read_recording("bags/road")])
        result.model.save(Path("model.json"))
    """
    if structure not in KITS:
        raise CesError(f"structure '{structure}' is unknown; expected one of {', '.join(KITS)}")
    kit = KITS[structure]
    known = {size.name: size.default for size in kit.sizes}
    if not sizes.keys() <= known.keys():
        raise CesError(f"structure '{structure}' has no size {', '.join(sizes.keys() - known.keys())}")
    try:
        fitter = kit.fitter({**known, **sizes})
    except ValueError as error:
        raise CesError(f"structure '{structure}': {error}") from None
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    require_distinct(given, validation)
    found = sense_together([*given, *validation])
    forced = require_sensible(found, go_on)
    for finding in found:
        warnings.warn(finding.text, stacklevel=2)
    return identification.identify(given, validation, options, listener, fitter).with_forced(forced)


def validate(model: Model, recordings: Recording | Sequence[Recording]) -> list[Evaluation]:
    """Return the free run of `model` on each recording with its cost J [%] (`cost`) and RMS error (`rms_N`).

    Raises CesError for a recording without a measured force.
    """
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    return evaluate(model, [prepare(recording, model.sampling) for recording in given], VALIDATION)


def compare_models(
    models: Mapping[str, Model | Simulation],
    recordings: Recording | Sequence[Recording],
    *,
    part: tuple[float, float] = (0.0, 1.0),
    timing: bool = True,
) -> Comparison:
    """Compare models, or other simulations, by name on the same recordings with a measured force.

    Only the `part` (shares from 0 to 1) of each recording is scored; `timing` also measures the time of a tick. The
    result's `pairs` say of every two models whether their costs differ by more than chance, its `notes()` which costs
    are no test. Raises CesError for fewer than two models.

        comparison = compare_models({"ours": a, "theirs": b}, [read_recording("bags/road")])
        print(comparison.pairs[0].text, *comparison.notes())
    """
    given = [recordings] if isinstance(recordings, Recording) else list(recordings)
    named = [
        make_compared_model(name, ModelSimulation(one) if isinstance(one, Model) else one)
        for name, one in models.items()
    ]
    return compare(named, given, part, timing=timing)


def simulate(model: Model, recording: Recording) -> NDArray[np.float64]:
    """Return the force [N] at every position sample (n,), as the observer would publish it; NaN where it withholds."""
    return sample_force(model, recording)


def simulate_arrays(
    model: Model, time_s: ArrayLike, position_m: ArrayLike, current_A: ArrayLike
) -> NDArray[np.float64]:
    """Return the force [N] for arrays of shape (n,), as `simulate`."""
    return sample_force(model, make_recording(time_s, position_m, current_A))


def plot(evaluations: Sequence[Evaluation]) -> Figure:
    """Return a matplotlib figure of measured and simulated force, a row for each evaluation."""
    from ces_identify.report.cost_figure import draw_costs

    return draw_costs(evaluations)


def _warn(recording: Recording) -> None:
    for finding in require_usable(recording):
        warnings.warn(f"{recording.name}: {finding.text}", stacklevel=3)
