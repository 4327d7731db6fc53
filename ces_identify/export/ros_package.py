"""Export of a model as a ROS 2 package in C++: the observer of one damper as a component and as a program.

A checked `Model` and its signals go in, the files of an ament_cmake package come out. Around the C99 estimator
(`export_c`) it has the rules by which the Python node withholds forces, and the same words on /diagnostics. The C++ is
the same for every model; what depends on the model is in the files whose names end in .j2 (folder ros_package/).
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path

from ces_identify.export.export_c import REASONS, export_c, identifier, render_text
from ces_identify.export.parameter_library import parameter_file, parameter_library
from ces_identify.export.replay_sequence import record_faults
from ces_observer import __version__, damper_observer, tracker
from ces_observer.errors import CesError, ModelError
from ces_observer.estimator import Estimator
from ces_observer.json_text import write_all_atomically
from ces_observer.model import Model
from ces_observer.nodes.parameter_table import NAME, OF_A_DAMPER, OF_THE_NODE, signal_options
from ces_observer.options import Option
from ces_observer.proof.certificate import Certificate
from ces_observer.signals import LARGEST, Constant, Signal, Signals

TEMPLATE = ".j2"
WORDS = {
    **REASONS,
    "SILENT": damper_observer.SILENT,
    "POSITION_NOT_FINITE": damper_observer.POSITION_NOT_FINITE,
    "NO_CURRENT": damper_observer.NO_CURRENT,
    "NO_MOTION": damper_observer.NO_MOTION,
    "OFF_CLOCK": damper_observer.OFF_CLOCK,
}  # for each reason, by its name in C++
PYTHON_ONLY = frozenset(
    {
        "snapshot_after_s",
        "model",
        "model_topic",
        "allow_uncertified",
        "compare_force",
        "cost_warn_J",
        "cost_window_s",
    }
)  # parameters of the Python node that the C++ node does not have
MEANINGS = {
    "snapshot_service": "service of a `ros2 bag record --snapshot-mode` that ~/snapshot calls; empty: none",
    "executor": "what runs the callbacks of the program `observer`: 'events' (auto) is rclcpp's EventsExecutor, "
    "'single' its SingleThreadedExecutor",
    "name": "joint name in the estimate; empty: the one in position.field, else 'damper'",
}  # of parameters that differ here from the Python node's
DEPENDENCIES = (
    *("diagnostic_msgs", "diagnostic_updater", "generate_parameter_library", "lifecycle_msgs", "rcl_interfaces"),
    *("rclcpp", "rclcpp_components", "rclcpp_lifecycle", "rosbag2_interfaces", "rosidl_typesupport_introspection_cpp"),
    *("sensor_msgs", "std_msgs", "std_srvs"),
)  # of the package for any model
CONSTANT = "current.constant"  # which may be not set, so that the node declares it by hand
HEAD = (
    "Parameters of the observer with the compiled model, as of ces_observer's node; the values are the defaults. Units "
    "are m, A and N; position and force are positive in compression. To use a copy of this file: "
)
PACKAGE = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")
RESERVED = (
    "alignas alignof and asm auto bitand bitor bool break case catch char class compl concept const constexpr continue "
    "decltype default delete do double else enum explicit export extern false float for friend goto if inline int long "
    "mutable namespace new noexcept not nullptr operator or private protected public register requires return short "
    "signed sizeof static struct switch template this throw true try typedef typeid typename union unsigned using "
    "virtual void volatile while xor std rclcpp ces test"
)  # in C++, and namespaces that the package uses


@dataclass(frozen=True)
class NodeSignal:
    """A signal as the node's parameters describe it; `constant` is its value [SI] if it is not measured."""

    name: str
    topic: str = ""
    type: str = ""
    field: str = ""
    scale: float = 1.0
    offset: float = 0.0
    delay: float = 0.0
    constant: float | None = None

    @classmethod
    def from_signal(cls, signal: Signal | Constant) -> NodeSignal:
        """Return the description of a signal."""
        if isinstance(signal, Constant):
            return cls(signal.name, constant=signal.value)
        field = signal.field.text
        return cls(signal.name, signal.topic, signal.type, field, signal.scale, signal.offset, signal.delay)


def export_ros_package(model: Model, package: str, signals: Signals, certificate: Certificate) -> dict[str, str]:
    """Return the files of the package by path.

    Raises ModelError if the model cannot be written in C or `package` is not a usable name, and CesError if the
    position is constant.
    """
    require_package_name(package)
    name = identifier(package)
    source, header = export_c(model, name, name, certificate)
    facts = _find_facts(model, package, name, signals, certificate)
    options = _list_parameters(_describe_signals(model, signals))
    files = {
        f"src/model/{name}.c": source,
        f"src/model/{name}.h": header,
        "src/parameters.yaml": parameter_library("observer", [one for one in options if one.name != CONSTANT]),
        "config/observer.yaml": _write_settings(package, options),
        "test/sequence.txt": record_faults(model),
    }
    for path, text in _list_files(resources.files("ces_identify.export") / "ros_package"):
        files[path.removesuffix(TEMPLATE)] = render_text(text, facts) if path.endswith(TEMPLATE) else text
    return files


def package_name(text: str) -> str:
    """Return `text` as a package name: `Front-Damper` becomes `front_damper`."""
    name = re.sub(r"[^0-9a-z]+", "_", text.lower()).strip("_")
    return name if name and name[0].isalpha() else f"model_{name}".rstrip("_")


def require_package_name(package: str) -> None:
    """Raise ModelError unless `package` is a name for a ROS 2 package and a C++ namespace."""
    if not PACKAGE.fullmatch(package) or len(package) < 2 or package in RESERVED.split():
        raise ModelError(f"package '{package}': expected lower-case letters, digits and _, and no word of C++")


def write_package(folder: Path, files: Mapping[str, str], overwrite: bool = False) -> None:
    """Write a package: into a temporary folder beside `folder`, which is then renamed.

    With `overwrite`, the files of a package that exists are replaced; others in its folder stay. Raises CesError if
    `folder` cannot be written, or as `require_package` does.
    """
    require_package(folder, overwrite)
    if folder.is_dir() and any(folder.iterdir()):
        for parent in {(folder / path).parent for path in files}:
            parent.mkdir(parents=True, exist_ok=True)
        write_all_atomically({folder / path: text for path, text in files.items()})
        return
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        try:
            temporary.chmod(0o755)
            for path, text in files.items():
                (temporary / path).parent.mkdir(parents=True, exist_ok=True)
                (temporary / path).write_text(text, encoding="utf-8")
            temporary.replace(folder)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise CesError(f"{folder}: cannot be written: {error.strerror}") from None


def require_package(folder: Path, overwrite: bool = False) -> None:
    """Raise CesError unless `folder` is empty or missing, or with `overwrite` a ROS 2 package."""
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if not overwrite:
        raise CesError(f"{folder}: exists; name a new folder, or replace its files, your changes too, with --overwrite")
    if not (folder / "package.xml").is_file():
        raise CesError(f"{folder}: is not a ROS 2 package, so it is not replaced; name a new folder")


def _list_files(folder: Traversable, prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield path and text of each file, in the order of the paths."""
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):
        if entry.is_dir():
            yield from _list_files(entry, f"{prefix}{entry.name}/")
        else:
            yield prefix + entry.name, entry.read_text(encoding="utf-8")


def _find_facts(model: Model, package: str, name: str, signals: Signals, certificate: Certificate) -> dict[str, object]:
    described = _describe_signals(model, signals)
    types = sorted({signal.type for signal in described.values() if signal.type})
    return {
        "package": package,
        "name": name,
        "NAME": name.upper(),
        "version": __version__,
        "digest": model.digest(),
        "model": model,
        "certificate": certificate,
        "reasons": REASONS,
        "words": WORDS,
        "motion": model.sampling.motion,
        "delay": model.best.sampling.delay_ticks,
        "delay_ns": Estimator(model).delay_ns,
        "own": "delayed" if model.sampling.delay_s else "now",
        "bands": [one.band for one in model.each],
        "causes": (tracker.RESTARTED, tracker.UNSETTLED),
        "signals": described,
        "largest": LARGEST,
        "types": [_find_header(one) for one in types],
        "dependencies": sorted({*DEPENDENCIES, *(one.partition("/")[0] for one in types)}),
    }


def _find_header(name: str) -> dict[str, str]:
    """Return the name of a message type `package/msg/Type`, its C++ type, and the header that declares it."""
    package, _, kind = name.split("/")
    words = re.sub(r"([a-z0-9])([A-Z])", r"\1_\2", re.sub(r"(.)([A-Z][a-z]+)", r"\1_\2", kind))
    return {"name": name, "cpp": f"{package}::msg::{kind}", "header": f"{package}/msg/{words.lower()}.hpp"}


def _describe_signals(model: Model, signals: Signals) -> dict[str, NodeSignal]:
    """Return the signals that the node reads, by name; one without a topic is to be set as parameters."""
    position = NodeSignal.from_signal(signals["position"])
    if position.constant is not None:
        raise CesError(f"{signals.source}: signal 'position' is constant; expected topic, type and field")
    described = {"position": position, "current": NodeSignal.from_signal(signals["current"])}
    if name := model.sampling.motion:
        motion = signals.by_name.get(name)
        described[name] = NodeSignal.from_signal(motion) if isinstance(motion, Signal) else NodeSignal(name)
    return described


def _list_parameters(signals: Mapping[str, NodeSignal]) -> list[Option]:
    """Return the parameters of the Python node that the C++ node has, too, and those of its signals."""
    common = [replace(one, meaning=MEANINGS.get(one.name, one.meaning)) for one in (*OF_THE_NODE, *OF_A_DAMPER, NAME)]
    listed = [one for one in common if one.name not in PYTHON_ONLY]
    for name, signal in signals.items():
        listed += signal_options(name, asdict(signal))
    return listed


def _write_settings(package: str, options: Iterable[Option]) -> str:
    """Return the parameter file of the package; a measured current has no constant, and a constant one no topic."""
    constant = any(one.name == CONSTANT and one.default is not None for one in options)
    shown = [one for one in options if not constant or one.name.partition(".")[0] != "current" or one.name == CONSTANT]
    head = f"ros2 run {package} observer --ros-args --params-file observer.yaml"
    return parameter_file(HEAD + head, [one for one in shown if one.default is not None])
