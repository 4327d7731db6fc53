"""What `ces identify` is asked for: all of it by the program, most of it by the node's parameters of the same names."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

from ces_cli.terminal.options import (
    ALL,
    BAGS_FORM,
    JOBS,
    JSON,
    NEED_REPORT,
    NOTE,
    OVERWRITE,
    PART,
    REPORT,
    SIGNALS,
    TITLE,
    Argument,
    ProgramRequest,
    Values,
    as_field,
    never_with,
    only_with,
)
from ces_identify.options import POLYNOMIALS, IdentifyRequest, list_options
from ces_identify.structures import KITS
from ces_observer.errors import CesError
from ces_observer.options import Option, as_parameter, given_values, in_group

MEASURED = f"recordings with a measured force: {BAGS_FORM}"
BAGS = Option("bags", (), MEASURED, kind=Path, metavar="BAG", together=True)
VALIDATE = Option(
    "validate", (), f"recordings for validation only: {BAGS_FORM}", kind=Path, metavar="BAG", together=True
)
OUT = Option("out", Path("model.json"), "model file to write; its folder must exist", metavar="FILE")
OF_THE_PROGRAM = (
    replace(PART, group="data"),
    TITLE,
    NOTE,
    JSON,
    Option(
        "show_candidates",
        False,
        "print the built-in candidate rules (with --method thesis, those of the thesis) and exit",
        group=POLYNOMIALS,
    ),
    *in_group(
        "many identifications",
        Option(
            "folds",
            0,
            "cross-validate, too: hold out each of K folds of the BAGs once (K = number of BAGs: one at a time); a "
            "single BAG is cut into K stretches. Takes K times as long again; 0: off",
            0,
            1000,
            metavar="K",
        ),
        Option(
            "campaign",
            None,
            "identify every combination that FILE.yaml describes and compare them; --out is then a folder, and the "
            "same command continues an interrupted run",
            kind=Path,
            metavar="FILE.yaml",
        ),
        JOBS,
    ),
)


def list_shared() -> tuple[Option, ...]:
    """Return the options that program and node share."""
    return (VALIDATE, SIGNALS, OUT, REPORT, *list_options(), OVERWRITE)


@dataclass(frozen=True, kw_only=True)
class IdentifyProgramRequest(ProgramRequest):
    """What `ces identify` is asked for: which files go in and out, and the `model` to identify."""

    program = "identify"
    about = (
        "Identify a model of the damping force from one or more recordings. The free-run cost selects the model, and "
        f"its stability is proved. Structures: {', '.join(kit.about for kit in KITS.values())}."
    )
    example = (
        "ces identify bags/noise bags/sweep --validate bags/sine_4hz bags/road --out model.json --report report.html"
    )
    option_rules = (
        never_with("part", "campaign", "does not apply to campaigns; record or export shorter recordings"),
        only_with("jobs", "campaign", "applies to campaigns; add --campaign FILE.yaml (for threads use --threads)"),
        never_with(
            ALL,
            "campaign",
            "has no effect with --campaign; set it in {campaign} instead",
            but="campaign jobs out json ignore_findings",
        ),
        NEED_REPORT,
        never_with(ALL, "show_candidates", "does not apply with --show-candidates", but="show_candidates method"),
    )

    bags: tuple[Path, ...] = ()
    validate: tuple[Path, ...] = ()
    signals: Path | None = None
    out: Path = OUT.default
    report: Path | None = None
    overwrite: bool = False
    teacher: str | None = None
    part: tuple[float, ...] = ()
    title: str = ""
    note: str = ""
    json: bool = False
    show_candidates: bool = False
    folds: int = 0
    campaign: Path | None = None
    jobs: int | None = None
    model: IdentifyRequest = field(default_factory=IdentifyRequest)

    @classmethod
    def options(cls) -> tuple[Option, ...]:
        """Return the options of the program."""
        return (Argument("bags", (), MEASURED, metavar="BAG", count="*"), *list_shared(), *OF_THE_PROGRAM)

    @classmethod
    def of(cls, values: Values, given: Collection[str]) -> Self:
        """Return the request for the values of options that the user has `given`; raises CesError naming an option."""
        own = {declared.name for declared in fields(cls)}
        options = {option.name: option for option in (BAGS, *list_shared(), *OF_THE_PROGRAM)}
        read = {name: as_field(options[name], values[name]) for name in given}
        model = IdentifyRequest.of({name: value for name, value in read.items() if name not in own})
        return cls(**{name: value for name, value in read.items() if name in own}, model=model)


PARAMETERS = tuple(as_parameter(option) for option in (BAGS, *list_shared()))
EXIT_WHEN_DONE = Option("exit_when_done", False, "end after publishing the costs of the model")


def find_given_parameters(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of parameters that are set, by the names of options; raises CesError naming a parameter."""
    given = given_values((BAGS, *list_shared()), values)
    if not given.get(BAGS.name):
        raise CesError(
            "parameter 'bags' is not set; set it to the paths of recordings: -p bags:='[bags/noise, bags/sweep]'"
        )
    return given
