"""The Python door: recordings to models, models to forces, and the gap between simulation and reality.

    import ces

    model = ces.identify(df, structure="auto")   # a DataFrame, a bag, a log, or several
    print(model.validate("rig/road"))
    model.save("model.json")

Wherever a recording is expected, these are taken: the path of a bag or log, a pandas DataFrame, a mapping of arrays, a
`Recording`, or several of them; wherever a model is, the path of its file is, too. Units are SI; position, speed and
force are positive in compression. Keyword names are the programs' option names, with `_` for `-`. A mistake of the
user's raises `CesError` with one line.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, replace
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ces_observer import __version__ as __version__
from ces_observer.errors import CesError
from ces_observer.estimator import Estimator
from ces_observer.lazy_names import import_on_use

if TYPE_CHECKING:
    from ces_data.reading import PathInput, RecordingInputs
    from ces_gap.calibrate.calibration import Calibration
    from ces_gap.diagnosis import Diagnosis
    from ces_gap.pipeline import DiagnoseOptions
    from ces_identify.characteristics.rows import Characteristics
    from ces_identify.comparison.comparison import Comparison
    from ces_identify.scripting.damper_model import DamperModel
    from ces_identify.scripting.model import Model
    from ces_identify.scripting.progress import ProgressInput
    from ces_identify.scripting.recording import Recording
    from ces_identify.simulations.simulation import Simulation
    from ces_identify.validation.cost_table import Evaluations
    from ces_identify.validation.evaluate import Evaluation
    from ces_observer import model
    from ces_report.shell import PageHead

    SimulationInput = Simulation | model.Model | Callable[..., Any] | PathInput
    FitInput = str | Sequence[str] | Mapping[str, tuple[float, float] | None]
    SimulationInputs = SimulationInput | Sequence[SimulationInput] | Mapping[str, SimulationInput]

MEANT = {
    "held_out": ("validation",), "test": ("validation", "held_out"), "validate": ("validation", "held_out"),
    "validation": ("held_out",), "random_state": ("seed",), "n_jobs": ("threads",), "verbose": ("progress",),
    "na": ("lags",), "nb": ("lags",), "nk": ("lags",), "order": ("terms",),
}  # fmt: skip  # options by the names that other functions and tools have for them

__all__ = [
    "Calibration", "CesError", "Characteristics", "Comparison", "DamperModel", "Diagnosis", "Estimator", "Evaluation",
    "Model", "Recording", "calibrate", "characterise", "compare", "diagnose", "identify", "simulate", "validate",
]  # fmt: skip

__getattr__ = import_on_use(
    __name__,
    {
        "ces_gap.calibrate.calibration": ("Calibration",),
        "ces_gap.diagnosis": ("Diagnosis",),
        "ces_identify.characteristics.rows": ("Characteristics",),
        "ces_identify.comparison.comparison": ("Comparison",),
        "ces_identify.scripting.damper_model": ("DamperModel",),
        "ces_identify.scripting.model": ("Model",),
        "ces_identify.scripting.recording": ("Recording",),
        "ces_identify.validation.evaluate": ("Evaluation",),
    },
)


def identify(
    recordings: RecordingInputs,
    structure: str = "polynomial",
    *,
    validation: RecordingInputs = (),
    signals: PathInput | None = None,
    teacher: SimulationInput | None = None,
    ignore_findings: bool = False,
    progress: ProgressInput = None,
    **options: Any,
) -> Model:
    """Identify a model; neither the fit nor the selection sees the `validation` recordings.

    `structure` is a name of `ces identify --structure`, or "auto": the best of several, or a mean. `options` are those
    of the command line (`time`, `terms`, `split`, `delay`, ...). `signals` is the signals file of bags. `teacher` is a
    simulation whose force is learnt instead of the measured one. `progress` is called with a text and a share; by
    default a notebook or terminal shows one line, False none. Warns of what looks wrong. Raises CesError if the
    recordings hold too little, have seconds in common, or would make a wrong model (sign, units, delays), unless
    `ignore_findings`.
    """
    from ces_data.reading import SIGNALS, as_recordings
    from ces_gap.augmented import file_of
    from ces_identify.options import IdentifyRequest, list_options
    from ces_identify.scripting.model import identify_model
    from ces_identify.scripting.progress import show_progress
    from ces_identify.simulations.simulation import replace_force
    from ces_identify.validation.cost_table import teacher_facts

    if not isinstance(structure, str):
        raise CesError(
            "structure: expected a name; with X and y as scikit-learn has them, take ces.DamperModel().fit(X, y)"
        )
    _require_options(identify, options, [option.name for option in list_options()])
    request = IdentifyRequest.of({"structure": structure, "ignore_findings": ignore_findings, **options})
    if isinstance(validation, int | float):
        raise CesError(
            f"validation: is {validation!r}; expected recordings; a part of each given one is kept by split=0.75"
        )
    subject, name = (None, "") if teacher is None else _open(teacher, "teacher")
    need = SIGNALS[: 3 if subject is None else 2]
    given = as_recordings(recordings, signals, need=need)
    held_out = as_recordings(validation, signals, need=need, required=False, called="validation")
    with show_progress(progress) as tell:
        if subject is None:
            return identify_model(request, given, held_out, tell)
        learnt, kept = ([replace_force(one, subject.force(one)) for one in some] for some in (given, held_out))
        model = identify_model(request, learnt, kept, tell)
    facts = teacher_facts(model, model.evaluated, name, file_of(name), [*given, *held_out])
    return replace(model, provenance={**model.provenance, "teacher": facts})


def validate(model: SimulationInput, recordings: RecordingInputs) -> Evaluations:
    """Return the free run of a model on each recording, a tuple with `to_frame`, as `Model.validate` does.

    Of another simulation, the cost is that of a comparison: at the position samples, 0.5 s after each start.
    """
    from ces_identify.scripting.model import as_model
    from ces_identify.scripting.simulating import validate as validate_simulation
    from ces_identify.simulations.simulation import ModelSimulation

    simulation, _ = _open(model, "model")
    if isinstance(simulation, ModelSimulation):
        return as_model(simulation.model).validate(recordings)
    return validate_simulation(simulation, recordings)


def simulate(
    model: SimulationInput, recording: Any = None, position_m: Any = None, current_A: Any = None, *, time_s: Any = None
) -> Any:
    """Return the force [N] of a model or another simulation at every position sample, as `Model.simulate` does."""
    from ces_identify.scripting.simulating import simulate as run_simulation

    return run_simulation(_open(model, "model")[0], recording, position_m, current_A, time_s)


def compare(
    models: SimulationInputs,
    recordings: RecordingInputs,
    *,
    report: PathInput | None = None,
    title: str = "",
    note: str = "",
    overwrite: bool = False,
) -> Comparison:
    """Compare models or other simulations, a list or by name, on the same recordings; write the page to `report`.

    The result's `pairs` say of every two whether their costs differ by more than chance, its `notes()` which costs are
    no test. Raises CesError for fewer than two.
    """
    from ces_data.reading import as_recordings
    from ces_identify.comparison.compared_models import make_compared_model
    from ces_identify.comparison.comparison import compare as compare_models
    from ces_identify.comparison.comparison_report import write_comparison

    target = _require_output("report", report, overwrite)
    named = [make_compared_model(name, simulation) for name, simulation in _open_all("models", models).items()]
    given = as_recordings(recordings)
    result = compare_models(named, given)
    if target is not None:
        write_comparison(target, result, _head(title, note, given))
    return result


def characterise(
    recordings: RecordingInputs,
    *,
    model: SimulationInputs = (),
    rules: PathInput | Mapping[str, Any] | None = None,
    out: PathInput | None = None,
    title: str = "",
    note: str = "",
    overwrite: bool = False,
) -> Characteristics:
    """Return what a damper dyno shows of recordings, beside simulations; write page and tables to `out`.

    `model` is one simulation, or several, in a list or by name; `rules` are those of a bench, a file or its content.
    """
    from ces_data.reading import as_recordings
    from ces_identify.characteristics.characterise import characterise as characterise_recordings
    from ces_identify.characteristics.page import write_characteristics

    target = _require_output("out", out, overwrite)
    given = as_recordings(recordings)
    result = characterise_recordings(given, simulations=_open_all("model", model), rules=rules)
    if target is not None:
        write_characteristics(target, result, _head(title, note, given))
    return result


def diagnose(
    simulation: SimulationInput,
    real: RecordingInputs,
    *,
    held_out: RecordingInputs = (),
    reference: RecordingInputs = (),
    out: PathInput | None = None,
    title: str = "",
    note: str = "",
    overwrite: bool = False,
    progress: ProgressInput = None,
    **options: Any,
) -> Diagnosis:
    """Return where the gap of a simulation to `real` recordings lies and which effects cause it.

    `simulation` is a model, a function of (time_s, position_m, current_A) that returns force_N, what `--sim` takes, or
    any `Simulation`. `reference` recordings are free of the effect; `held_out` ones only judge (default: a part of
    `real`). `progress` is that of `identify`. `options` are `effects`, `threads`, `seed`, `tolerance`, `experiment`,
    `fit`. `out` is a folder for gap.json, augmented.json, report.html (`title`, `note`) and the next experiment. Raises
    CesError for what cannot be diagnosed.
    """
    from ces_data.reading import as_recordings
    from ces_gap import pipeline
    from ces_gap.augmented import name_simulation
    from ces_gap.inputs.checks import check_recordings
    from ces_gap.result_files import result_files
    from ces_identify.numerics.least_squares import one_blas_thread
    from ces_identify.scripting.progress import show_progress

    how, target = _diagnose_options(options), _require_output("out", out, overwrite)
    subject, name = _open(simulation)
    recordings, kept = as_recordings(real, called="real"), as_recordings(held_out, required=False, called="held_out")
    references = as_recordings(reference, required=False, called="reference")
    notes = check_recordings(recordings, kept, references)
    with one_blas_thread(), show_progress(progress) as tell:
        result = pipeline.diagnose(subject, name, recordings, kept, references, how, tell)
    result = replace(result, notes=(*notes, *result.notes))
    if target is not None:
        head = _head(title, note, [*recordings, *kept, *references])
        roles = (("real", recordings), ("held_out", kept), ("reference", references))
        _write(target, lambda folder: result_files(result, name_simulation(name, folder), roles, head))
    return result


def calibrate(
    simulation: SimulationInput,
    real: RecordingInputs,
    *,
    held_out: RecordingInputs = (),
    fit: FitInput = (),
    out: PathInput | None = None,
    title: str = "",
    note: str = "",
    overwrite: bool = False,
    progress: ProgressInput = None,
) -> Calibration:
    """Return the named parameters of a simulation fitted to `real` recordings, with intervals.

    `fit` names some of them (NAME or NAME=LOW..HIGH, or a mapping from NAME to (LOW, HIGH)); without it, all. `out`
    is a folder for calibrated.json and report.html. Raises CesError if nothing can be fitted.
    """
    from ces_data.findings import warn
    from ces_data.reading import as_recordings
    from ces_gap.augmented import name_simulation
    from ces_gap.calibrate.calibration import calibrate as calibrate_simulation
    from ces_gap.inputs.checks import check_recordings
    from ces_gap.report.calibration import calibration_files
    from ces_identify.numerics.least_squares import one_blas_thread
    from ces_identify.scripting.progress import show_progress

    target = _require_output("out", out, overwrite)
    subject, name = _open(simulation)
    recordings, kept = as_recordings(real, called="real"), as_recordings(held_out, required=False, called="held_out")
    for text in check_recordings(recordings, kept, []):
        warn(text)
    with one_blas_thread(), show_progress(progress) as tell:
        result = calibrate_simulation(subject, name, recordings, kept, _as_fit(fit), tell)
    if target is not None:
        head = _head(title, note, [*recordings, *kept])
        used = {"real": recordings, "held_out": kept}
        _write(target, lambda folder: calibration_files(result, name_simulation(name, folder), used, head))
    return result


def _diagnose_options(given: Mapping[str, Any]) -> DiagnoseOptions:
    """Return the options of a diagnosis; raises CesError for a name that none has."""
    from ces_cli.diagnose.diagnosis import DiagnoseRequest
    from ces_gap.effects.effect import Effect
    from ces_gap.pipeline import DiagnoseOptions

    _require_options(diagnose, given, [field.name for field in fields(DiagnoseOptions)])
    for option in DiagnoseRequest.options():
        if given.get(option.name) is not None and option.kind in (int, float):
            option.check(given[option.name])
    if not all(isinstance(effect, Effect) for effect in given.get("effects", ())):
        raise CesError("effects: expected effects of your own (ces_gap.Effect); the library's are always tried")
    share = {"tolerance": 0.01 * given["tolerance"]} if given.get("tolerance") is not None else {}
    return DiagnoseOptions(**{**given, **share, "fit": _as_fit(given.get("fit") or ())})


def _as_fit(given: FitInput) -> tuple[str, ...]:
    """Return the parameters that may change as the program has them: NAME or NAME=LOW..HIGH. Raises CesError."""
    if not isinstance(given, Mapping):
        return (given,) if isinstance(given, str) else tuple(given)
    words = []
    for name, ends in given.items():
        if ends is not None and (not isinstance(ends, Sequence) or isinstance(ends, str) or len(ends) != 2):
            raise CesError(f"fit: {name} is {ends!r}; expected (LOW, HIGH), or None for its own range")
        words.append(name if ends is None else f"{name}={ends[0]}..{ends[1]}")
    return tuple(words)


def _require_options(function: Callable[..., Any], given: Mapping[str, Any], known: Sequence[str]) -> None:
    """Raise CesError for a keyword that a function has not."""
    from ces_observer.errors import suggest

    if unknown := next((name for name in given if name not in known), None):
        own = [name for name in signature(function).parameters if name != "options"]
        meant = next((name for name in MEANT.get(unknown, ()) if name in [*known, *own]), unknown)
        raise CesError(f"{unknown}: is no option of {function.__name__}{suggest(meant, dict.fromkeys([*known, *own]))}")


def _head(title: str, note: str, recordings: Sequence[Any]) -> PageHead:
    """Return what the page of a result says of itself."""
    from ces_data.recording import describe_days
    from ces_report.shell import PageHead

    return PageHead(title, note, recorded=describe_days(recordings))


def _require_output(name: str, given: PathInput | None, overwrite: bool) -> Path | None:
    """Return the file of a `report`, or a folder. Raises CesError unless it can be written."""
    from ces_data.outputs import REPORT, require_outputs
    from ces_data.reading import as_path

    path = None if given is None else as_path(given, name)
    if name == REPORT.name:
        require_outputs(overwrite, {REPORT: path})
    else:
        require_outputs(overwrite, folders={name: path})
    return path


def _write(folder: Path, make: Callable[[Path], Mapping[str, str]]) -> None:
    """Write files into a folder, all or none."""
    from ces_observer.json_text import write_all_atomically

    folder.mkdir(parents=True, exist_ok=True)
    write_all_atomically({folder / name: text for name, text in make(folder).items()})


def _open_all(name: str, given: SimulationInputs) -> dict[str, Simulation]:
    """Return simulations by name: the given names, or those of files, functions and structures. Raises CesError."""
    import ces_identify.scripting  # noqa: F401  # warns of a compilation
    from ces_identify.comparison.comparison import name_sources
    from ces_observer.model import Model

    if isinstance(given, Mapping):
        return {str(own): _open(simulation, name)[0] for own, simulation in given.items()}
    several: Sequence[Any] = given if isinstance(given, list | tuple) else [given]
    opened = [_open(simulation, name) for simulation in several]
    sources = [
        one.structure if isinstance(one, Model) else getattr(one, "__qualname__", own)
        for one, (_, own) in zip(several, opened, strict=True)
    ]
    names = name_sources(sources)
    counts = [names[: k + 1].count(own) for k, own in enumerate(names)]
    distinct = [f"{own} {n}" if n > 1 else own for own, n in zip(names, counts, strict=True)]
    return {own: simulation for own, (simulation, _) in zip(distinct, opened, strict=True)}


def _open(given: SimulationInput, called: str = "simulation") -> tuple[Simulation, str]:
    """Return a simulation, and the name that results give it. Raises CesError, which says `called`, for others."""
    from ces_cli.terminal.inputs import open_simulation
    from ces_data.reading import as_path
    from ces_identify.simulations.simulation import FunctionSimulation, ModelSimulation, Simulation
    from ces_observer.model import Model

    if isinstance(given, Simulation):
        return given, str(getattr(given, "name", type(given).__name__))
    if isinstance(given, Model):
        return ModelSimulation(given), "model"
    if called == "model" and isinstance(given, Mapping | list | tuple):
        raise CesError("model: expected one; ces.compare takes several, by name or in a list")
    if callable(given):
        name = f"{given.__module__}:{getattr(given, '__qualname__', 'function')}"
        return FunctionSimulation(name, given), name
    spec = given if isinstance(given, str) else str(as_path(given, called, "simulation"))
    return open_simulation(spec), spec


def __dir__() -> list[str]:
    return __all__
