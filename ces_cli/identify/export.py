"""`ces export`: a model as C source for a microcontroller, or as an FMU for a simulation tool."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_identify.export.export_c import export_c, identifier, require_exportable
from ces_identify.export.export_fmu import binary_path, export_fmu, find_compiler
from ces_observer.errors import CesError
from ces_observer.json_checks import write_all_atomically, write_atomically
from ces_observer.model import Model, load_model
from ces_observer.proof.certificate import Certificate, summarize


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = _parser().parse_args(argv)
    model = load_model(options.model)
    kind = _kind(options)
    name = options.name or identifier(options.out.stem)
    require_exportable(model, name, options.out.stem if kind == "c" else name)
    compiler = find_compiler() if kind == "fmu" and not options.sources_only else []
    certificate = _certificate(model, options)
    if kind == "c":
        _write_c(model, name, options.out, certificate)
    else:
        _write_fmu(model, name, options.out, certificate, compiler)
    _print_certificate(certificate)
    return 0


def _kind(options: argparse.Namespace) -> str:
    """Return the format asked for, by name or by the ending of --out."""
    out: Path = options.out
    kind = str(options.format or out.suffix.removeprefix("."))
    if kind not in _FORMATS or out.suffix != f".{kind}":
        raise CesError(f"{out}: expected a name that ends in {' or '.join(_endings(options.format))}")
    if options.sources_only and kind != "fmu":
        raise CesError("--sources-only: is for --format fmu; C is source anyhow")
    return kind


def _endings(format_: str | None) -> list[str]:
    return [f".{kind} ({what})" for kind, what in _FORMATS.items() if format_ in (None, kind)]


def _certificate(model: Model, options: argparse.Namespace) -> Certificate:
    with terminal.err.status("proving stability"):
        certificate = model.certify()
    if not (certificate.holds or options.allow_uncertified):
        raise CesError(
            f"{options.model}: its stability cannot be proved ({certificate.doubt}); identify it anew with a "
            "certificate, or give --allow-uncertified"
        )
    return certificate


def _write_c(model: Model, name: str, out: Path, certificate: Certificate) -> None:
    source, header = export_c(model, name, out.stem, certificate)
    write_all_atomically({out.with_suffix(".h"): header, out: source})
    print(f"{out}, {out.with_suffix('.h').name}: {name}_step and {name}_tick, {model.size}")


def _write_fmu(model: Model, name: str, out: Path, certificate: Certificate, compiler: Sequence[str]) -> None:
    with terminal.err.status("compiling"):
        content = export_fmu(model, name, certificate, compiler)
    write_atomically(out, content)
    made = binary_path(name) if compiler else "sources only, to be compiled as its sources/BUILD.txt says"
    print(f"{out}: FMI 2.0 co-simulation {name}, {model.size}, {made}")


def _print_certificate(certificate: Certificate) -> None:
    if not certificate.holds:
        terminal.print_warning("--allow-uncertified: nothing proves that this model stays stable; not for a vehicle")
        return
    print(f"stable: {summarize(certificate.to_mapping())} (proved); |force| <= {certificate.force_N:.0f} N")


_FORMATS = {"c": "C99, its header is written beside it", "fmu": "FMI 2.0 co-simulation"}


def _parser() -> terminal.Parser:
    p = terminal.parser(
        "export",
        "Write a model as one self-contained C99 file and its header, or as an FMU for co-simulation (FMI 2.0) that\n"
        "holds the same C, compiled for this machine and as source for others. Either is the observer node's\n"
        "estimator, with its differentiator and its reasons to withhold, without allocation in a step and with no\n"
        "library but math.h. The FMU takes position [m] and current [A] and gives force [N], speed [m/s], valid,\n"
        "clamped and reason; its communication points are the samples, at any distance, best at the model's rate.",
        "ces export model.json --out rear_damper.c\n  ces export model.json --format fmu --out rear_damper.fmu",
    )
    p.add_argument("model", type=Path, metavar="MODEL.json")
    p.add_argument("--out", type=Path, required=True, metavar="FILE", help="FILE.c (FILE.h beside it) or FILE.fmu")
    p.add_argument("--format", choices=tuple(_FORMATS), help="default: by the ending of FILE")
    p.add_argument("--name", metavar="NAME", help="beginning of every identifier (default: made from FILE)")
    p.add_argument("--sources-only", action="store_true", help="an FMU without a binary; needs no C compiler")
    p.add_argument(
        "--allow-uncertified", action="store_true", help="export a model whose stability cannot be proved (unsafe)"
    )
    return p
