"""`ces rig`: runs an experiment on the virtual rig and writes its sensor signals as a bag."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, OVERWRITE, RIG_SEED, SIGNALS, Argument, never_with
from ces_cli.terminal.outputs import print_document, require_outputs
from ces_data.bags.writer import recording_topics, write_bag
from ces_observer.options import Option
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import find_experiment, load_experiment, packaged_experiments, run, with_seed


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.list:
        _list(options.json)
    elif options.experiment is None or options.out is None:
        parser.error("expected EXPERIMENT and --out BAG (or --list)")
    else:
        _record(options)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    return terminal.parser(
        "rig",
        "Run an experiment on the virtual dyno rig and write a bag with position, current and force (synthetic data).",
        "ces rig sine_4hz --out sine_4hz",
        Argument(
            "experiment", None, "experiment file (YAML) or the name of a packaged one", metavar="EXPERIMENT", count="?"
        ),
        Option("out", None, "bag folder to write", kind=Path, metavar="BAG"),
        *(RIG_SEED, SIGNALS, JSON, OVERWRITE),
        Option("list", False, "list the packaged experiments and exit"),
        rules=(never_with(ALL, "list", "does not apply with --list", but="list json"),),
    )


def _list(as_json: bool) -> None:
    experiments = [(name, path, load_experiment(path).settings) for name, path in packaged_experiments().items()]
    if as_json:
        rows = [
            {"name": name, "duration_s": settings.duration_s, "description": settings.description, "path": path}
            for name, path, settings in experiments
        ]
        print_document("rig", {"experiments": rows})
        return
    width = max(len(name) for name, _, _ in experiments) + 2
    for name, _, settings in experiments:
        print(f"{name:<{width}}{settings.duration_s:4.0f} s  {settings.description}")


def _record(options: argparse.Namespace) -> None:
    path = find_experiment(options.experiment)
    require_outputs(options.overwrite, bags={"--out": options.out}, inputs=[path, options.signals])
    experiment = load_experiment(path)
    if options.seed is not None:
        experiment = with_seed(experiment, options.seed)
    signals = terminal.load_described_signals(options)
    with terminal.err.status(f"running {experiment.settings.name}"):
        recording = run(experiment)
    topics = recording_topics(recording, signals)
    if not topics:
        raise RigError(
            f"{signals.source}: describes none of the signals that the rig records: {', '.join(recording.channels)}"
        )
    seed = experiment.settings.seed
    notes = {"ces_rig": f"synthetic: experiment {recording.name}, seed {seed}"}
    write_bag(options.out, topics, overwrite=options.overwrite, notes=notes)
    if options.json:
        channels = {
            name: {"unit": one.unit, "samples": len(one), "low": one.values.min(), "high": one.values.max()}
            for name, one in recording.channels.items()
        }
        print_document("rig", {"experiment": recording.name, "seed": seed, "bag": options.out, "channels": channels})
        return
    samples = ", ".join(f"{len(channel)} {name}" for name, channel in recording.channels.items())
    force = recording.channel("force").values
    print(f"{options.out}: {samples} samples; force {force.min():.0f} to {force.max():.0f} N")
