"""From the options of `ces diagnose`: settings of the diagnosis, and recordings with their predictions."""

from __future__ import annotations

import argparse
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.simulations import import_from_here, with_predictions
from ces_gap.effects.user_effects import user_effect
from ces_gap.pipeline import DiagnoseOptions
from ces_identify.recordings.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_observer.signals import Signals


def build_diagnose_options(options: argparse.Namespace, threads: int) -> DiagnoseOptions:
    """Return the settings of the diagnosis, with the user's own effects; `threads` is the default of --threads."""
    import_from_here()
    effects = tuple(user_effect(spec) for spec in options.effects)
    threads, tolerance = options.threads or threads, 0.01 * options.tolerance
    return DiagnoseOptions(effects=effects, threads=threads, seed=options.seed, tolerance=tolerance)


def read_with_predictions(simulation: Simulation, path: Path, signals: Signals) -> Recording:
    """Return a recording with its measured force and, if recorded there, the simulation's force."""
    return with_predictions(simulation, path, terminal.read_one(path, signals, terminal.FORCE), signals)
