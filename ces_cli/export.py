"""`ces export`: a model as C source for a microcontroller."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ces_cli import terminal
from ces_identify.export_c import export_c, identifier, require_exportable
from ces_observer.certificate import Certificate, certify
from ces_observer.checked import write_beside
from ces_observer.errors import CesError
from ces_observer.model import load_model


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = _parser().parse_args(argv)
    model = load_model(options.model)
    if options.out.suffix != ".c":
        raise CesError(f"{options.out}: expected a name that ends in .c; its header is written beside it")
    name = options.name or identifier(options.out.stem)
    require_exportable(model, name, options.out.stem)
    with terminal.err.status("proving stability"):
        certificate = certify(model)
    if not (certificate.holds or options.allow_uncertified):
        raise CesError(
            f"{options.model}: its stability cannot be proved (past forces may count for {certificate.gain:.3f}, 1 or "
            "more); identify it anew with a certificate, or give --allow-uncertified"
        )
    source, header = export_c(model, name, options.out.stem, certificate)
    write_beside(options.out.with_suffix(".h"), header)
    write_beside(options.out, source)
    print(f"{options.out}, {options.out.with_suffix('.h').name}: {name}_step and {name}_tick, {len(model.terms)} terms")
    _tell(certificate)
    return 0


def _tell(certificate: Certificate) -> None:
    if not certificate.holds:
        terminal.note("--allow-uncertified: nothing proves that this model stays stable; not for a vehicle")
        return
    print(
        f"stable: past forces count for at most {certificate.gain:.3f} < 1 for any input (proved); "
        f"|force| <= {certificate.force_N:.0f} N"
    )


def _parser() -> terminal.Parser:
    p = terminal.parser(
        "export",
        "Write a model as one self-contained C99 file and its header: the same estimator as the observer node's, with "
        "its differentiator and its reasons to withhold, without allocation and with no library but math.h.",
        "ces export model.json --out rear_damper.c",
    )
    p.add_argument("model", type=Path, metavar="MODEL.json")
    p.add_argument(
        "--out", type=Path, required=True, metavar="FILE.c", help="C file to write; FILE.h is written beside it"
    )
    p.add_argument("--name", metavar="NAME", help="beginning of every identifier (default: made from FILE)")
    p.add_argument(
        "--allow-uncertified", action="store_true", help="export a model whose stability cannot be proved (unsafe)"
    )
    return p
