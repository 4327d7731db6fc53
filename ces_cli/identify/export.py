"""`ces export`: writes a model as a flat file for the C++ node, as C source for a microcontroller, or as an FMU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import MODEL, OptionRule, OutputRequest, option
from ces_cli.terminal.outputs import print_document, without_text
from ces_data.outputs import OUT, require_outputs
from ces_identify.export import export_model
from ces_observer.errors import CesError, OptionName
from ces_observer.json_text import write_all_atomically
from ces_observer.model import Model, load_model
from ces_observer.proof.certificate import Certificate, summarize
from ces_observer.records import declare

PRINTED = b"Printed from ces_observer/tick/"  # of a common core, which several models in a folder share
FORMATS = {
    "ces": "flat file of the C++ node",
    "c": "C99, with its header beside it",
    "fmu": "FMI 2.0 co-simulation",
}
FORM = ", ".join(f"FILE.{kind} ({what})" for kind, what in FORMATS.items())


@dataclass(frozen=True, kw_only=True)
class ExportRequest(OutputRequest):
    """Write a model as a flat file, which the C++ node of the package ces_observer_cpp loads while it runs; as C99 for
    a microcontroller, the numbers of the model with their header and the core, which is the same for every model; or as
    an FMU for co-simulation (FMI 2.0) that contains the same C code, compiled for this machine and as source for
    others. All compute what the observer computes, with its reasons for withholding a force, and with the estimates of
    a model with a delay; the C needs only math.h and allocates no memory. The FMU takes position [m] and current [A]
    and returns force [N], speed [m/s], valid, clamped and reason. Every communication point is a sample; any spacing
    works, best is the model's rate.
    """

    program = "export"
    example = (
        "ces export model.json --out rear_damper.ces\n  ces export model.json --out rear_damper.c\n"
        "  ces export model.json --out rear_damper.fmu"
    )
    option_rules = (
        OptionRule(
            "sources_only",
            lambda values: values["out"].suffix == ".fmu",
            "applies to an FMU only; remove it",
        ),
    )

    model: Path = declare(MODEL)
    out: Path = option(meaning=FORM, metavar="FILE")
    name: str | None = option(
        None, "name of the model, prefix of every identifier in C (default: from FILE)", metavar="NAME"
    )
    sources_only: bool = option(False, "write an FMU without a binary; needs no C compiler")
    allow_uncertified: bool = option(False, "export a model whose stability cannot be proved (unsafe)")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(ExportRequest, argv)
    kind, out = _kind(request.out), request.out
    outputs: dict[OptionName | str, Path | None] = {OUT: out}
    for name in _names_beside(out) if kind == "c" else ():
        beside = out.with_name(name)
        if not (name in export_model.CORE and beside.is_file() and PRINTED in beside.read_bytes()):
            outputs[f"the file {name} beside it"] = beside
    require_outputs(request.overwrite, outputs, inputs=[request.model])
    with without_text(request.json):
        certificate = _export(request, kind)
        if certificate.holds:
            summary = summarize(certificate.to_mapping())
            bound = "" if "|force|" in summary else f"; {certificate.force_claim}"
            print(f"proved stable: {summary}{bound}")
        else:
            terminal.print_warning(
                "--allow-uncertified: the stability of this model is not proved; do not use it on a vehicle"
            )
    if request.json:
        facts = {"proved_stable": certificate.holds, "bounds": certificate.bounds}
        print_document("export", {"model": request.model, "written": out, **facts})
    return 0


def _names_beside(out: Path) -> tuple[str, ...]:
    """Return the names of the files that are written beside FILE.c."""
    return out.with_suffix(".h").name, *export_model.CORE


def _export(request: ExportRequest, kind: str) -> Certificate:
    """Write the file that the options name, and those beside it; return the certificate of the model."""
    model, out = load_model(request.model), request.out
    name = request.name or export_model.identifier(out.stem)
    export_model.require_usable_names(name, out.stem if kind == "c" else name)
    compiler = export_model.find_compiler() if kind == "fmu" and not request.sources_only else []
    certificate = _certificate(model, request)
    files: Mapping[str, str | bytes]
    if kind == "ces":
        files = {out.name: export_model.write_flat(model, name, certificate)}
        print(f"{out}: flat file {name}, {model.size}, {len(files[out.name]) / 1e3:.0f} kB")
    elif kind == "c":
        files = export_model.export_c(model, name, out.stem, certificate)
        beside = ", ".join(_names_beside(out))
        print(f"{out}, {beside}: {name}_step and {name}_tick, {model.size}")
    else:
        with terminal.step("compiling"):
            files = {out.name: export_model.export_fmu(model, name, certificate, compiler)}
        what = (
            export_model.binary_path(name) if compiler else "sources only; sources/BUILD.txt says how to compile them"
        )
        print(f"{out}: FMI 2.0 co-simulation {name}, {model.size}, {what}")
    write_all_atomically({out.with_name(file): content for file, content in files.items()})
    return certificate


def _kind(out: Path) -> str:
    kind = out.suffix.removeprefix(".")
    if kind not in FORMATS:
        allowed = [f".{name} ({what})" for name, what in FORMATS.items()]
        raise CesError(f"{out}: expected a name that ends in {' or '.join(allowed)}")
    return kind


def _certificate(model: Model, request: ExportRequest) -> Certificate:
    """Return the certificate of the model; raises CesError if it does not hold, unless the options allow that."""
    with terminal.step("proving stability"):
        certificate = model.certify()
    if not (certificate.holds or request.allow_uncertified):
        raise CesError(
            f"{request.model}: its stability cannot be proved ({certificate.doubt}); identify it again with a "
            "certificate, or use ",
            OptionName("allow_uncertified", True),
        )
    return certificate
