"""The functions for scripts: read a recording, identify, simulate, validate, compare.

Import them from `ces_identify`. Wherever recordings are expected, paths are, too; wherever a model is, the path of its
file is. Keyword names are those of the command line. Every mistake of a user is a CesError of one line.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.check import check_together, require_sound
from ces_data.checks.content import require_distinct
from ces_data.reading import SIGNALS, PathInput, RecordingInput, RecordingInputs, as_path, as_recordings, kind_of
from ces_data.recording import Channel, Recording
from ces_data.signals_file import load_signals
from ces_identify import identification
from ces_identify.comparison.compared_models import make_compared_model
from ces_identify.comparison.comparison import Comparison, compare
from ces_identify.identification import IdentificationResult
from ces_identify.numerics.search import Listener
from ces_identify.options import IdentifyRequest
from ces_identify.prepare.series import prepare
from ces_identify.simulations.simulate import sample_force
from ces_identify.simulations.simulation import ModelSimulation, Simulation
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.validation.cost_table import Evaluations
from ces_identify.validation.evaluate import VALIDATION, Evaluation, evaluate
from ces_observer.errors import CesError
from ces_observer.model import Model, load_model

EPOCH_NS = 10**18  # stamps of recordings made of arrays count from here
ModelInput: TypeAlias = "Model | PathInput"


def make_recording(
    time_s: ArrayLike, position_m: ArrayLike, current_A: ArrayLike, force_N: ArrayLike | None = None, *, name: str = ""
) -> Recording:
    """Return a recording of arrays of shape (n,); position and force are positive in compression."""
    stamps = EPOCH_NS + np.rint(_as_numbers("time_s", time_s) * 1e9).astype(np.int64)
    columns = {"position": ("m", position_m), "current": ("A", current_A), "force": ("N", force_N)}
    channels = {
        signal: Channel(signal, unit, stamps, _as_numbers(signal, values))
        for signal, (unit, values) in columns.items()
        if values is not None
    }
    return Recording(name or "recording", channels)


def write_recording(recording: Recording, path: PathInput, *, overwrite: bool = False) -> None:
    """Write a recording as a rosbag2 folder with the topics of the packaged signals file. Raises CesError."""
    write_bag(as_path(path, "path"), recording_topics(recording, load_signals()), overwrite=overwrite)


def identify(
    recordings: RecordingInputs,
    *,
    validation: RecordingInputs = (),
    structure: str = "polynomial",
    signals: PathInput | None = None,
    options: IdentifyOptions | None = None,
    listener: Listener = lambda result: None,
    ignore_findings: bool = False,
    **named: Any,
) -> IdentificationResult:
    """Identify a model; neither the fit nor the selection sees the `validation` recordings.

    `structure` is a name of `ces identify --structure`, or "auto": the best of several, or a mean. Further names are
    those of the command line (`time`, `terms`, `split`, `units`, ...), as `IdentifyRequest` has them; they count more
    than `options`. `signals` is the signals file for
    recordings given as paths. `listener` is called with each improvement. Warns of what looks wrong; raises CesError if
    the recordings hold too little, have seconds in common, or would make a wrong model (sign, units, delays), unless
    `ignore_findings`.

        result = identify("bags/noise", validation="bags/road", time=20)
        result.model.save("model.json")
    """
    if options is not None and not isinstance(options, IdentifyOptions):
        raise CesError(f"options: expected IdentifyOptions; got {kind_of(options)}")
    base = None if options is None else IdentifyRequest.of_settings(options)
    request = IdentifyRequest.of({"structure": structure, "ignore_findings": ignore_findings, **named}, base)
    how, fitter = request.options(options), request.fitter()
    given = as_recordings(recordings, signals)
    held_out = as_recordings(validation, signals, required=False)
    require_distinct(given, held_out)
    findings = check_together([*given, *held_out])
    require_sound(findings, request.ignore_findings)
    for finding in findings:
        warnings.warn(finding.text, stacklevel=2)
    result = identification.identify(given, held_out, how, listener, fitter)
    return result.require_explained(findings, request.ignore_findings)


def validate(
    model: ModelInput, recordings: RecordingInputs = (), *, signals: PathInput | None = None
) -> list[Evaluation]:
    """Return the free run of a model on each recording with its cost J [%] (`cost`) and RMS (`rms_N`).

    Raises CesError for a recording without a measured force.

        validate("model.json", ["bags/road", "bags/noise"])
    """
    loaded = _as_model(model)
    series = [prepare(recording, loaded.sampling) for recording in as_recordings(recordings, signals)]
    return Evaluations(evaluate(loaded, series, VALIDATION))


def compare_models(
    models: Mapping[str, ModelInput | Simulation],
    recordings: RecordingInputs,
    *,
    part: tuple[float, float] = (0.0, 1.0),
    signals: PathInput | None = None,
) -> Comparison:
    """Compare models, or other simulations, by name on the same recordings with a measured force.

    Only the `part` (shares from 0 to 1) of each recording is scored. The result's `pairs` say of every two models
    whether their costs differ by more than chance, its `notes()` which costs are no test.
    Raises CesError for fewer than two models.

        print(compare_models({"ours": "a.json", "theirs": "b.json"}, "bags/road"))
    """
    if not isinstance(models, Mapping):
        raise CesError(f"models: expected models by their names, as in {{'a': 'a.json'}}; got {kind_of(models)}")
    named = [
        make_compared_model(name, given if isinstance(given, Simulation) else ModelSimulation(_as_model(given)))
        for name, given in models.items()
    ]
    return compare(named, as_recordings(recordings, signals), part)


def simulate(model: ModelInput, recording: RecordingInput) -> NDArray[np.float64]:
    """Return the force [N] at every position sample (n,), as the observer would publish it; NaN where it withholds."""
    loaded, given = _as_model(model), as_recordings(recording, need=SIGNALS[:2])
    if len(given) > 1:
        raise CesError(f"{len(given)} recordings given; expected one")
    return sample_force(loaded, given[0])


def simulate_arrays(
    model: ModelInput, time_s: ArrayLike, position_m: ArrayLike, current_A: ArrayLike
) -> NDArray[np.float64]:
    """Return the force [N] for arrays of shape (n,), as `simulate`."""
    return sample_force(_as_model(model), make_recording(time_s, position_m, current_A))


def _as_numbers(name: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise CesError(f"{name}: expected an array of numbers; got {kind_of(values)}") from None


def _as_model(given: ModelInput) -> Model:
    return given if isinstance(given, Model) else load_model(as_path(given, "model"))
