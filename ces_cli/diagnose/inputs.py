"""From the options of `ces diagnose`: settings of the diagnosis, and recordings with their predictions."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.simulations import import_from_here, with_predictions
from ces_gap.baseline.identified import MODEL, identify_baseline
from ces_gap.effects.user_effects import user_effect
from ces_gap.pipeline import DiagnoseOptions
from ces_gap.progress import Progress
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_identify.structures.auto import AUTO
from ces_observer.errors import CesError
from ces_observer.signals import Signals


def build_diagnose_options(options: argparse.Namespace, threads: int) -> DiagnoseOptions:
    """Return the settings of the diagnosis, with the user's own effects; `threads` is the default of --threads."""
    import_from_here()
    effects = tuple(user_effect(spec) for spec in options.effects)
    threads, tolerance = options.threads or threads, None if options.tolerance is None else 0.01 * options.tolerance
    return DiagnoseOptions(effects=effects, threads=threads, seed=options.seed, tolerance=tolerance)


def read_with_predictions(simulation: Simulation | None, path: Path, signals: Signals) -> Recording:
    """Return a recording with its measured force and, if recorded there, the simulation's force."""
    recording = terminal.read_one(path, signals, terminal.FORCE)
    return recording if simulation is None else with_predictions(simulation, path, recording, signals)


def require_one_source(options: argparse.Namespace) -> None:
    """Raise CesError unless the options give a simulation or references to identify one from."""
    if not options.identify and options.sim is None:
        raise CesError("no simulation: give --sim SIM, or --identify with --reference BAG...")
    if options.identify and not options.reference:
        raise CesError("--identify needs --reference BAG...: recordings free of the effect, from which to identify")


def take_simulation(
    given: Simulation | None,
    reference: Sequence[Recording],
    options: argparse.Namespace,
    threads: int,
    progress: Progress,
) -> tuple[Simulation, str]:
    """Return the simulation and its name: the one `given`, or a model of the references, saved in --out."""
    if given is not None:
        return given, str(options.sim)
    baseline = identify_baseline(reference, options.structure or AUTO, threads, progress)
    options.out.mkdir(parents=True, exist_ok=True)
    saved = baseline.save(options.out / MODEL)
    return saved, saved.name
