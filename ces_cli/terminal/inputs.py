"""What arguments name: recordings (bags, folders that hold bags, globs of either) and simulations.

A simulation is a model, a result, a rig, an FMU, module:function, or predictions in a bag.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ces_cli.terminal import terminal
from ces_data.bags.find import FILES, find_bags
from ces_data.bags.reader import list_topics, read_recording
from ces_data.checks.check import check_each
from ces_data.findings import Finding
from ces_data.recording import Recording
from ces_identify.simulations.fmu import SPEC
from ces_identify.simulations.simulation import (
    FunctionSimulation,
    ModelSimulation,
    RecordedSimulation,
    Simulation,
    find_predictions,
    function_simulation,
    replace_force,
)
from ces_observer.errors import CesError
from ces_observer.model import load_model
from ces_observer.signals import Signal, Signals

RECORDING, VEHICLE = "recording", "vehicle"


@dataclass(frozen=True)
class FleetUnit:
    """One recording of a fleet, or the recordings of one vehicle, which are in one folder."""

    name: str
    paths: tuple[Path, ...]


def find_fleet_units(words: Sequence[str], each: str) -> list[FleetUnit]:
    """Return a unit for each recording that the arguments name, or for each folder that holds some (`each`)."""
    groups: dict[Path, list[Path]] = {}
    for path in find_bags(words):
        groups.setdefault(path if each == RECORDING else path.resolve().parent, []).append(path)
    names = make_distinct_names([path.resolve() for path in groups])
    return [FleetUnit(name, tuple(paths)) for name, paths in zip(names, groups.values(), strict=True)]


def with_distinct_names(recordings: Mapping[Path, Recording]) -> dict[Path, Recording]:
    """Return the recordings; if two have the same name, all get the shortest ends of their paths that differ."""
    if len({recording.name for recording in recordings.values()}) == len(recordings):
        return dict(recordings)
    names = make_distinct_names([path.resolve() for path in recordings])
    pairs = zip(recordings.items(), names, strict=True)
    return {path: replace(one, name=name + _find_span(one, path)) for (path, one), name in pairs}


def _find_span(recording: Recording, path: Path) -> str:
    """Return what the name of a part of a recording adds to that of its file."""
    own = path.stem if path.is_file() else path.resolve().name
    return recording.name.removeprefix(own) if recording.name.startswith(f"{own} ") else ""


def make_distinct_names(paths: Sequence[Path]) -> list[str]:
    """Return the shortest ends of the paths that differ from each other, each joined into one word."""
    for depth in range(1, 8):
        names = ["_".join([*path.parts[-depth:-1], path.stem if path.suffix in FILES else path.name]) for path in paths]
        if len(set(names)) == len(names):
            return [name.replace("/", "_").replace(" ", "_") for name in names]
    return [f"{path.name}_{number}" for number, path in enumerate(paths, start=1)]


def print_findings(recordings: Sequence[Recording]) -> tuple[Finding, ...]:
    """Print what is wrong with recordings, each and together, one warning line each; return it for --json."""
    with terminal.step("checking the recordings"):
        findings = check_each(recordings)
    print_warnings(findings)
    return findings


def print_warnings(findings: Iterable[Finding]) -> None:
    """Print one warning line for each finding."""
    for finding in findings:
        terminal.print_warning(finding.text)


HELP = (
    "MODEL.json, AUGMENTED.json, CALIBRATED.json, RIG.yaml, module:function, topic:/name, or a co-simulation FILE.fmu, "
    "which runs native code: use only a file that you trust (FILE.fmu:position=NAME,current=NAME,force=NAME names its "
    "variables)"
)
SIMULATIONS_EXPECTED = "MODEL.json, AUGMENTED.json, CALIBRATED.json, RIG.yaml, FILE.fmu, module:function or topic:/name"
FIELDS = {
    "std_msgs/msg/Float64": "data",
    "std_msgs/msg/Float32": "data",
    "geometry_msgs/msg/WrenchStamped": "wrench.force.z",
    "geometry_msgs/msg/Wrench": "force.z",
    "sensor_msgs/msg/JointState": "effort[0]",
}


def open_simulation(spec: str) -> Simulation:
    """Return the simulation that `spec` names; raises CesError."""
    if spec.startswith("topic:"):
        return RecordedSimulation(spec.removeprefix("topic:"))
    if SPEC.fullmatch(spec):
        from ces_identify.simulations.fmu import open_fmu

        return open_fmu(spec)
    path = Path(spec)
    if path.suffix.lower() == ".json":
        return _open_json(path)
    if path.suffix.lower() in (".yaml", ".yml"):
        from ces_rig.experiments.virtual import load_rig

        return FunctionSimulation(str(path), load_rig(path))
    if ":" in spec:
        import_from_here()
        return function_simulation(spec)
    if path.suffix == ".py":
        raise CesError(f"'{spec}' is a file; expected {path.stem}:FUNCTION, of (time_s, position_m, current_A)")
    raise CesError(f"'{spec}' is no simulation; expected {SIMULATIONS_EXPECTED}")


def _open_json(path: Path) -> Simulation:
    from ces_gap.augmented import is_augmented, load_augmented
    from ces_gap.report.calibration import is_calibrated, load_calibrated

    if is_calibrated(path):
        return load_calibrated(path, open_simulation)
    if not is_augmented(path):
        return ModelSimulation(load_model(path))
    import_from_here()  # for the user's own effects
    return load_augmented(path, open_simulation)


def find_file(spec: str) -> Path | None:
    """Return the file that a simulation is read from; None if it is none."""
    return next((Path(text) for text in (spec, spec.partition(":")[0]) if Path(text).is_file()), None)


def import_from_here() -> None:
    """Let the user's modules be imported from the working directory, as `python -m` would."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)


def with_predictions(simulation: Simulation, path: Path, recording: Recording, signals: Signals) -> Recording:
    """Return the recording with the predictions recorded in its bag, if the simulation reads its force from there."""
    predictions = find_predictions(simulation)
    if predictions is None:
        return recording
    topic = predictions.topic
    types = {t.name.lstrip("/"): t.type for t in list_topics(path)}
    kind = types.get(topic.lstrip("/"))
    if kind is None:
        raise CesError(f"{path}: no topic {topic}; it has {', '.join('/' + t for t in sorted(types))}")
    signal = signals.by_name.get("sim_force")
    if not isinstance(signal, Signal) or signal.topic.lstrip("/") != topic.lstrip("/"):
        described = {"topic": topic, "type": kind, "field": FIELDS.get(kind, "data")}
        signal = Signals.from_mapping({"sim_force": described}, f"topic {topic}")["sim_force"]
    extended = replace(signals, by_name={**signals.by_name, "sim_force": signal})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # printed when the recording was read
        whole = read_recording(path, extended, ("position", "current", "sim_force"))
    return replace(recording, channels={**recording.channels, "sim_force": whole.channel("sim_force")})


def with_teacher_force(teacher: Simulation, path: Path, recording: Recording, signals: Signals) -> Recording:
    """Return the recording with the teacher's force in place of the measured one."""
    return replace_force(recording, teacher.force(with_predictions(teacher, path, recording, signals)))
