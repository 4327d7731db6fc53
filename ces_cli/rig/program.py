"""`ces rig`: runs an experiment on the virtual rig and writes its sensor signals as a bag."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, OVERWRITE, RIG_SEED, SIGNALS, never_with
from ces_cli.terminal.outputs import print_document, require_outputs
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Recording
from ces_rig.errors import RigError
from ces_rig.experiment import Experiment, find_experiment, load_experiment, packaged_experiments, run, with_seed


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.list:
        return _list(options.json)
    if options.experiment is None or options.out is None:
        parser.error("expected EXPERIMENT and --out BAG (or --list)")
    path = find_experiment(options.experiment)
    require_outputs(options.overwrite, bags={"--out": options.out}, inputs=[path, options.signals])
    experiment = load_experiment(path)
    _record(experiment if options.seed is None else with_seed(experiment, options.seed), options)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "rig",
        "Run an experiment on the virtual dyno rig and write a bag with position, current and force (synthetic data).",
        "ces rig sine_4hz --out sine_4hz",
    )
    text = "experiment file (YAML) or the name of a packaged one"
    p.add_argument("experiment", nargs="?", metavar="EXPERIMENT", help=text)
    p.add_argument("--out", type=Path, metavar="BAG", help="bag folder to write")
    terminal.add_options(p, RIG_SEED, SIGNALS, JSON, OVERWRITE)
    p.add_argument("--list", action="store_true", help="list the packaged experiments and exit")
    p.rules = (never_with(ALL, "list", "does not apply with --list", but="list json"),)
    return p


def _list(as_json: bool) -> int:
    experiments = packaged_experiments()
    if as_json:
        loaded = [(name, path, load_experiment(path).settings) for name, path in experiments.items()]
        rows = [
            {"name": name, "duration_s": settings.duration_s, "description": settings.description, "path": path}
            for name, path, settings in loaded
        ]
        print_document("rig", {"experiments": rows})
        return 0
    width = max(map(len, experiments)) + 2
    for name, path in experiments.items():
        settings = load_experiment(path).settings
        print(f"{name:<{width}}{settings.duration_s:4.0f} s  {settings.description}")
    return 0


def _record(experiment: Experiment, options: argparse.Namespace) -> None:
    signals = terminal.load_described_signals(options)
    with terminal.err.status(f"running {experiment.settings.name}"):
        recording = run(experiment)
    topics = recording_topics(recording, signals)
    if not topics:
        raise RigError(
            f"{signals.source}: describes none of the signals that the rig records: {', '.join(recording.channels)}"
        )
    notes = {"ces_rig": f"synthetic: experiment {recording.name}, seed {experiment.settings.seed}"}
    write_bag(options.out, topics, overwrite=options.overwrite, notes=notes)
    if options.json:
        print_document("rig", _as_json(recording, experiment, options.out))
        return
    samples = ", ".join(f"{len(channel)} {name}" for name, channel in recording.channels.items())
    force = recording.channel("force").values
    print(f"{options.out}: {samples} samples; force {force.min():.0f} to {force.max():.0f} N")


def _as_json(recording: Recording, experiment: Experiment, out: Path) -> dict[str, object]:
    """Return the document of --json for a recorded experiment."""
    channels = {
        name: {"unit": channel.unit, "samples": len(channel), "low": channel.values.min(), "high": channel.values.max()}
        for name, channel in recording.channels.items()
    }
    return {"experiment": recording.name, "seed": experiment.settings.seed, "bag": out, "channels": channels}
