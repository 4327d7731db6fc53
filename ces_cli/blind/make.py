"""`ces blind make`: a plan of cases by seed, made in processes, their answers sealed."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from ces_cli.terminal.progress import JobsProgress
from ces_observer.errors import CesError
from ces_rig.blind.make import make_cases
from ces_rig.blind.plan import GAPS, KINDS, BlindCase, Levels, list_spare_effects, plan_grid, plan_sample
from ces_rig.dampers.effects import EFFECTS, OUTSIDE
from ces_rig.withheld.plants import PLANTS

CALIBRATION = "calibration"  # a plant kept for calibrating probabilities: not drawn unless it is asked for
SMALL = (3.0,)


def make(options: argparse.Namespace) -> int:
    """Make the cases that the options ask for; returns the exit status. Raises CesError."""
    levels = _levels(options)
    plan = (
        plan_grid(levels, options.seed) if options.cases is None else plan_sample(levels, options.seed, options.cases)
    )
    with JobsProgress(len(plan), 0, "cases") as progress:
        digest = make_cases(
            options.out,
            [(case, list_spare_effects(case, levels)) for case in plan],
            options.seconds,
            options.jobs,
            {"seed": options.seed, "planned": len(plan), "plants": list(levels.plants)},
            lambda label: progress.count(f"case {label['case']} is made"),
        )
    print(f"{options.out}/cases: {_describe_plan(plan)}; answers sealed, SHA-256 {digest}")
    return 0


def _levels(options: argparse.Namespace) -> Levels:
    drawn_from = tuple(plant for plant in PLANTS if plant != CALIBRATION)
    return Levels(
        effects=_check_names(options.effects, EFFECTS, EFFECTS, "--effects"),
        outside=OUTSIDE,
        plants=_check_names(options.plants, PLANTS, drawn_from, "--plants"),
        kinds=_check_names(options.kind, KINDS, KINDS, "--kind"),
        gaps=tuple(options.gap_to_noise or (SMALL if options.grid == "small" else GAPS)),
    )


def _check_names(
    given: Sequence[str] | None, known: Sequence[str], default: Sequence[str], option: str
) -> tuple[str, ...]:
    for name in given or ():
        if name not in known:
            raise CesError(f"{option} '{name}': expected {', '.join(known)}")
    return tuple(dict.fromkeys(given or default))


def _describe_plan(plan: Sequence[BlindCase]) -> str:
    return ", ".join(f"{sum(case.kind == kind for case in plan)} {kind}" for kind in KINDS)
