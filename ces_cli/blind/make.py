"""`ces blind make`: plans cases by seed, creates them in parallel processes and seals the answers."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ces_cli.terminal.json_output import print_document
from ces_cli.terminal.progress import JobsProgress
from ces_observer.errors import CesError
from ces_rig.blind.make import make_cases
from ces_rig.blind.plan import GAPS, KINDS, Levels, list_spare_effects, plan_grid, plan_sample
from ces_rig.dampers.effects import EFFECTS, OUTSIDE
from ces_rig.withheld.plants import PLANTS

RESERVED = ("calibration", "monotube")  # for probabilities and for sealed tests: used only if --plants names them
SMALL_GRID_GAPS = (3.0,)


def make(options: argparse.Namespace) -> int:
    """Create the cases that the options describe; returns the exit status. Raises CesError."""
    levels = _levels(options)
    seed, count = options.seed, options.cases
    plan = plan_grid(levels, seed) if count is None else plan_sample(levels, seed, count)
    with JobsProgress(len(plan), 0, "cases") as progress:
        digest = make_cases(
            options.out,
            [(case, list_spare_effects(case, levels)) for case in plan],
            options.seconds,
            options.jobs,
            {"seed": options.seed, "planned": len(plan), "plants": list(levels.plants)},
            lambda label: progress.count(f"case {label['case']} created"),
        )
    count_of = {kind: sum(case.kind == kind for case in plan) for kind in KINDS}
    if options.json:
        print_document("blind-make", {"folder": options.out, "cases": count_of, "sha256": digest})
        return 0
    counts = ", ".join(f"{number} {kind}" for kind, number in count_of.items())
    print(f"{options.out}/cases: {counts}; answers sealed, SHA-256 {digest}")
    return 0


def _levels(options: argparse.Namespace) -> Levels:
    default_plants = tuple(plant for plant in PLANTS if plant not in RESERVED)
    return Levels(
        effects=_check_names(options.effects, EFFECTS, EFFECTS, "--effects"),
        outside=OUTSIDE,
        plants=_check_names(options.plants, PLANTS, default_plants, "--plants"),
        kinds=_check_names(options.kind, KINDS, KINDS, "--kind"),
        gaps=tuple(options.gap_to_noise or (SMALL_GRID_GAPS if options.grid == "small" else GAPS)),
    )


def _check_names(
    names: Sequence[str] | None, known: Sequence[str], default: Sequence[str], option: str
) -> tuple[str, ...]:
    for name in names or ():
        if name not in known:
            raise CesError(f"{option} '{name}': expected {', '.join(known)}")
    return tuple(dict.fromkeys(names or default))
