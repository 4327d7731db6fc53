"""`ces export`: writes a model as C source for a microcontroller, an FMU for a simulation tool, or a ROS 2 package."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import JSON, MODEL, OVERWRITE, SIGNALS, OptionRule, never_with, only_with
from ces_cli.terminal.outputs import print_document, require_outputs, without_text
from ces_identify.export.export_c import export_c, identifier, require_exportable
from ces_identify.export.export_fmu import binary_path, export_fmu, find_compiler
from ces_identify.export.ros_package import (
    export_ros_package,
    package_name,
    require_package,
    require_package_name,
    write_package,
)
from ces_observer.errors import CesError
from ces_observer.json_text import write_all_atomically, write_atomically
from ces_observer.model import Model, load_model
from ces_observer.options import Option
from ces_observer.proof.certificate import Certificate, summarize

FORMATS = {"c": "C99, with its header beside it", "fmu": "FMI 2.0 co-simulation"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    inputs = [options.model, options.signals]
    if options.ros_package is not None:
        require_outputs(
            options.overwrite, folders={"--ros-package": options.ros_package}, inputs=inputs, names=["package.xml"]
        )
    else:
        header = options.out.with_suffix(".h") if _kind(options) == "c" else None
        require_outputs(options.overwrite, {"--out": options.out, "the header of --out": header}, inputs=inputs)
    with without_text(options.json):
        certificate = _export_package(options) if options.ros_package else _export_file(options)
        if certificate.holds:
            summary = summarize(certificate.to_mapping())
            bound = "" if "|force|" in summary else f"; {certificate.force_claim}"
            print(f"stable: {summary} (proved){bound}")
        else:
            terminal.print_warning(
                "--allow-uncertified: the stability of this model is not proved; do not use it on a vehicle"
            )
    if options.json:
        facts = {"proved_stable": certificate.holds, "bounds": certificate.bounds}
        print_document("export", {"model": options.model, "written": options.ros_package or options.out, **facts})
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    package = "new folder for an ament_cmake package; its name is the package's name"
    p = terminal.parser(
        "export",
        "Write a model as one self-contained C99 file with its header, as an FMU for co-simulation (FMI 2.0) that "
        "contains the same C code, compiled for this machine and as source for others, or as a ROS 2 package in C++ "
        "around it. All are the observer's estimator with its reasons for withholding a force, and all give the "
        "estimates of a model with a delay; the C needs only math.h and allocates no memory in a step. The FMU takes "
        "position [m] and current [A] and returns force [N], speed [m/s], valid, clamped and reason. Every "
        "communication point is a sample; any spacing works, best is the model's rate. The ROS 2 package has the "
        "observer node as a component and as a program.",
        "ces export model.json --out rear_damper.c\n  ces export model.json --format fmu --out rear_damper.fmu\n"
        "  ces export model.json --ros-package ~/ros2_ws/src/rear_damper_observer --signals vehicle.yaml",
        MODEL,
        rules=(
            only_with("signals", "ros_package", "applies to --ros-package only; remove it"),
            never_with("format sources_only", "ros_package", "does not apply to --ros-package; remove it"),
            OptionRule(
                "sources_only",
                lambda options: (options.format or options.out.suffix.removeprefix(".")) == "fmu",
                "applies to an FMU only; remove it for C",
            ),
        ),
    )
    terminal.add_options(
        p.add_mutually_exclusive_group(required=True),
        Option("out", None, "FILE.c (FILE.h beside it) or FILE.fmu", kind=Path, metavar="FILE"),
        Option("ros_package", None, package, kind=Path, metavar="DIR"),
    )
    name = "prefix of every identifier (default: derived from FILE), or name of the package"
    terminal.add_options(
        p,
        Option("format", None, "default: from the suffix of FILE", choices=tuple(FORMATS)),
        Option("name", None, name, metavar="NAME"),
        Option("sources_only", False, "write an FMU without a binary; needs no C compiler"),
        Option("allow_uncertified", False, "export a model whose stability cannot be proved (unsafe)"),
        *(SIGNALS, JSON, OVERWRITE),
    )
    return p


def _export_file(options: argparse.Namespace) -> Certificate:
    model, out = load_model(options.model), options.out
    kind = _kind(options)
    name = options.name or identifier(out.stem)
    require_exportable(model, name, out.stem if kind == "c" else name)
    compiler = find_compiler() if kind == "fmu" and not options.sources_only else []
    certificate = _certificate(model, options)
    if kind == "c":
        source, header = export_c(model, name, out.stem, certificate)
        write_all_atomically({out.with_suffix(".h"): header, out: source})
        print(f"{out}, {out.with_suffix('.h').name}: {name}_step and {name}_tick, {model.size}")
        return certificate
    with terminal.err.status("compiling"):
        content = export_fmu(model, name, certificate, compiler)
    write_atomically(out, content)
    what = binary_path(name) if compiler else "sources only; sources/BUILD.txt says how to compile them"
    print(f"{out}: FMI 2.0 co-simulation {name}, {model.size}, {what}")
    return certificate


def _export_package(options: argparse.Namespace) -> Certificate:
    model = load_model(options.model)
    folder: Path = options.ros_package
    package = options.name or package_name(folder.resolve().name)
    signals = terminal.load_described_signals(options)
    require_package_name(package)
    require_package(folder, options.overwrite)
    certificate = _certificate(model, options)
    with terminal.err.status("writing the package and the sequence that its test replays"):
        write_package(folder, export_ros_package(model, package, signals, certificate), options.overwrite)
    print(f"{folder}: ROS 2 package {package}, component {package}::Observer, program observer, {model.size}")
    return certificate


def _kind(options: argparse.Namespace) -> str:
    out: Path = options.out
    kind = str(options.format or out.suffix.removeprefix("."))
    if kind not in FORMATS or out.suffix != f".{kind}":
        allowed = [f".{name} ({what})" for name, what in FORMATS.items() if options.format in (None, name)]
        raise CesError(f"{out}: expected a name that ends in {' or '.join(allowed)}")
    return kind


def _certificate(model: Model, options: argparse.Namespace) -> Certificate:
    """Return the certificate of the model, or of the delayed one in its file if that does not hold."""
    with terminal.err.status("proving stability"):
        certificate, *others = (one.certify() for one in model.each)
    certificate = next((one for one in others if not one.holds), certificate)
    if not (certificate.holds or options.allow_uncertified):
        raise CesError(
            f"{options.model}: its stability cannot be proved ({certificate.doubt}); identify it again with a "
            "certificate, or use --allow-uncertified"
        )
    return certificate
