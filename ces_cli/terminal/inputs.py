"""What arguments name: recordings (bags, folders that hold bags, globs of either) and simulations.

A simulation is a model, a result, a rig, an FMU, module:function, or predictions in a bag.
"""

from __future__ import annotations

import glob
import re
import sys
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ces_cli.terminal import terminal
from ces_data.bags.mcap import require_complete
from ces_data.bags.reader import list_topics, read_recording
from ces_data.checks.check import check_each
from ces_data.findings import Finding
from ces_data.log_formats import explain_import, is_foreign, is_log
from ces_data.recording import Channel, Recording
from ces_identify.simulations.fmu import SPEC
from ces_identify.simulations.simulation import (
    FunctionSimulation,
    ModelSimulation,
    RecordedSimulation,
    Simulation,
    find_predictions,
    function_simulation,
)
from ces_observer.errors import CesError, RecordingError
from ces_observer.model import load_model
from ces_observer.signals import Signal, Signals

FILES = (".mcap", ".db3", ".bag")
PART = re.compile(r"(.+?)(?:_([0-9]+))?\.(?:mcap|db3)(?:\.zstd)?")  # as recorders name the files of a bag
WILD = "*?["
RECORDING, VEHICLE = "recording", "vehicle"
BAGS_EXPECTED = "expected rosbag2 folders, .mcap or .db3 files, folders of them, or a glob"


@dataclass(frozen=True)
class FleetUnit:
    """One recording of a fleet, or the recordings of one vehicle, which are in one folder."""

    name: str
    paths: tuple[Path, ...]


def find_bags(words: Sequence[str | Path], repeated: bool = False) -> list[Path]:
    """Return the bags that the arguments name, in order; raises CesError for an argument that names none.

    A bag that several arguments name is returned once, or with `repeated` each time. A path that does not exist is
    returned as it is, for the reader's message.
    """
    paths = [path for word in words for path in _match_word(str(word))]
    return paths if repeated else list(dict.fromkeys(paths))


def find_bag(word: str) -> Path:
    """Return the one bag that the argument names; raises CesError if it names several or none."""
    paths = find_bags([word])
    if len(paths) > 1:
        names = ", ".join(str(path) for path in paths[:3])
        raise CesError(f"{word}: names {len(paths)} bags ({names}{', …' if len(paths) > 3 else ''}); expected one")
    return paths[0]


def find_fleet_units(words: Sequence[str], each: str) -> list[FleetUnit]:
    """Return a unit for each recording that the arguments name, or for each folder that holds some (`each`)."""
    groups: dict[Path, list[Path]] = {}
    for path in find_bags(words):
        groups.setdefault(path if each == RECORDING else path.resolve().parent, []).append(path)
    names = make_distinct_names([path.resolve() for path in groups])
    return [FleetUnit(name, tuple(paths)) for name, paths in zip(names, groups.values(), strict=True)]


def _match_word(word: str) -> Iterator[Path]:
    if (folder := Path(word)).is_dir() and not is_bag(folder) and _is_cut_short(folder):
        yield folder
        return
    paths = [Path(word)]
    matched = paths
    if not paths[0].exists() and any(letter in word for letter in WILD):
        matched = [Path(name) for name in sorted(glob.glob(word, recursive=True))]  # noqa: PTH207 - absolute, too
        paths = [p for p in matched if (p.is_dir() or is_bag(p) or is_log(p)) and not is_bag(p.parent)]
    bags = [bag for path in paths for bag in _find_bags_inside(path)]
    if not bags:
        what = "no bag in this folder or below it" if matched == [Path(word)] else "no bag matches"
        inside = (path for first in matched for path in ([first] if first.is_file() else sorted(first.glob("*"))))
        foreign = next(filter(is_foreign, inside), None)
        raise CesError(f"{word}: {what}; " + (f"{foreign} {explain_import(foreign)}" if foreign else BAGS_EXPECTED))
    yield from bags


def _find_bags_inside(path: Path) -> list[Path]:
    """Return the bag that `path` is, or those in and below it; a path that does not exist is returned as it is."""
    if is_bag(path) or not path.is_dir():
        return [path]
    inside = [entry for entry in sorted(path.iterdir()) if entry.is_dir() or is_bag(entry)]
    return [bag for entry in inside for bag in _find_bags_inside(entry)]


def is_bag(path: Path) -> bool:
    """Return whether `path` is a rosbag2 folder, also of a killed recorder, or a bag file by its name."""
    if not path.is_dir():
        return path.suffix in FILES
    if (path / "metadata.yaml").is_file():
        return True
    files = [file for file in path.iterdir() if file.name.removesuffix(".zstd").endswith(FILES)]
    parts = _find_parts(files)
    return parts is not None and parts[0] == path.name  # the numbered files of one recorder, no collection of bags


def _find_parts(files: Sequence[Path]) -> tuple[str, Path] | None:
    """Return the name of the recorder of which all files are the numbered ones, from 0, and the last; else None."""
    parts = {int(match[2] or 0): (match[1], file) for file in files if (match := PART.fullmatch(file.name))}
    if len({name for name, _ in parts.values()}) != 1 or len(parts) != len(files) or 0 not in parts:
        return None
    return parts[max(parts)]


def _is_cut_short(folder: Path) -> bool:
    """Return whether all files in a folder are the numbered MCAP files of one recorder, the last without its end."""
    parts = _find_parts([file for file in folder.iterdir() if file.suffix in (".mcap", ".db3", ".zstd")])
    if parts is None or parts[1].suffix != ".mcap":
        return False
    try:
        require_complete(parts[1])
    except RecordingError:
        return True
    return False


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
    force = teacher.force(with_predictions(teacher, path, recording, signals))
    channel = Channel("force", "N", recording.channel("position").stamps_ns, force)
    return replace(recording, channels={**recording.channels, "force": channel})
