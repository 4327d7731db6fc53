"""`ces diagnose`: locates the gap between a simulation and reality, finds its cause and says how far it shrinks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import FIT, HELD_OUT, JOBS, JSON, OVERWRITE, REAL, SIGNALS, never_with, only_with
from ces_cli.terminal.outputs import require_outputs
from ces_cli.terminal.recordings import RECORDING, VEHICLE
from ces_cli.terminal.simulations import HELP
from ces_gap.calibrate.free import NONE
from ces_identify.options import SEED, THREADS
from ces_identify.structures.auto import AUTO
from ces_observer.options import Option, in_group
from ces_observer.structures import STRUCTURES

NAMES = [one.option for one in STRUCTURES.values() if one.is_offered]
IDENTIFY = "without --sim: identify a model of the --reference recordings and diagnose with it; DIR/model.json"
OWN_EFFECTS = "your own effects in addition to the library's (subclasses of ces_gap.Effect)"
NO_GAP = "share of the RMS force below which a gap counts as none"
OPTIONS = (
    Option("sim", None, HELP, metavar="SIM"),
    Option("identify", False, IDENTIFY),
    Option(
        "structure",
        None,
        "of the model that --identify fits; auto (default): the lowest cost on held-out parts of the references; "
        f"or {', '.join(NAMES)}",
        choices=(AUTO, *NAMES),
        metavar="NAME",
    ),
    REAL,
    HELD_OUT,
    replace(
        FIT,
        meaning=f"{FIT.meaning}; {NONE}: all keep their values. With --reference, those that may have changed since",
        none="all that the simulation declares compete with the effects; with --reference none",
    ),
    replace(
        HELD_OUT,
        name="reference",
        none="",
        meaning="recordings known to be free of the effect; the simulation's own error is learned from them first",
    ),
    SIGNALS,
    Option("out", meaning="folder to write, created if necessary", kind=Path, metavar="DIR"),
    Option("effects", (), OWN_EFFECTS, metavar="module:Class", together=True),
    replace(THREADS, meaning="default: all processors; with --each, one for each diagnosis", none=""),
    Option(
        "tolerance", None, NO_GAP, 0.0, 100.0, "%", kind=float, none="1, but at most twice the noise", metavar="PERCENT"
    ),
    replace(SEED, meaning="random seed"),
    Option(
        "each",
        None,
        "one diagnosis for each recording of --real, or for each folder of recordings; the same command continues "
        "an interrupted run",
        choices=(RECORDING, VEHICLE),
    ),
    *(*in_group("fleets", JOBS), JSON, OVERWRITE),
)
RULES = (
    only_with("structure", "identify", "applies to --identify; a simulation given by --sim has its own"),
    never_with(
        "sim",
        "identify",
        "does not apply with --identify, which takes a model of the references as simulation; remove one",
    ),
    only_with("jobs", "each", "applies to fleets; add --each recording or --each vehicle"),
    never_with("held_out", "each", "has no effect with --each: a part of each recording or vehicle is held out"),
    never_with("overwrite", "each", "has no effect with --each: the same command continues the fleet in --out"),
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    if options.each is not None:
        from ces_cli.diagnose.fleet import run_fleet

        return run_fleet(options)
    require_outputs(options.overwrite, folders={"--out": options.out})
    from ces_cli.diagnose.diagnosis import run_diagnosis

    run_diagnosis(options, terminal.command_line("diagnose", argv))
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    return terminal.parser(
        "diagnose",
        "Find where a simulation differs from recordings of the real damper, which missing effect is the cause, and "
        "how far the gap shrinks with that effect added. Writes gap.json, augmented.json (the simulation with the "
        "effects, itself a SIM), report.html and, where it would help, the next experiment.",
        "ces diagnose --sim model.json --real worn/* --reference new/* --out gap\n"
        "  ces diagnose --identify --reference new/* --real worn/* --out gap\n"
        "  ces diagnose --sim damper.fmu --real 'fleet/*' --each vehicle --reference new/* --out fleet_gap",
        *OPTIONS,
        rules=RULES,
    )
