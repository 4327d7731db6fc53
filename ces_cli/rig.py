"""`ces rig`: runs an experiment on the virtual rig and writes its sensor signals as a bag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, RIG_SEED, BagRequest, argument, never_with, option
from ces_cli.terminal.outputs import print_document
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.outputs import OUT, require_outputs
from ces_data.signals_file import load_signals
from ces_observer.records import declare
from ces_rig.errors import RigError
from ces_rig.experiments.virtual import find_experiment, load_experiment, packaged_experiments, run, with_seed

EXPERIMENT = "experiment file (YAML) or the name of a packaged one"


@dataclass(frozen=True, kw_only=True)
class RigRequest(BagRequest):
    """Run an experiment on the virtual dyno rig and write a bag with position, current and force (synthetic data)."""

    program = "rig"
    example = "ces rig sine_4hz --out sine_4hz"
    option_rules = (never_with(ALL, "list", "does not apply with --list", but="list json"),)

    experiment: str | None = argument(None, EXPERIMENT, metavar="EXPERIMENT", count="?")
    out: Path | None = option(None, "bag folder to write", metavar="BAG")
    seed: int | None = declare(RIG_SEED)
    list: bool = option(False, "list the packaged experiments and exit")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    parser = terminal.parser(RigRequest)
    request = parser.read(argv)
    if request.list:
        _list(request.json)
    elif request.experiment is None or request.out is None:
        parser.error("expected EXPERIMENT and --out BAG (or --list)")
    else:
        _record(request, request.experiment, request.out)
    return 0


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


def _record(request: RigRequest, name: str, out: Path) -> None:
    path = find_experiment(name)
    require_outputs(request.overwrite, bags={OUT: out}, inputs=[path, request.signals])
    experiment = load_experiment(path)
    if request.seed is not None:
        experiment = with_seed(experiment, request.seed)
    signals = load_signals(request.signals)
    with terminal.step(f"running {experiment.settings.name}"):
        recording = run(experiment)
    topics = recording_topics(recording, signals)
    if not topics:
        raise RigError(
            f"{signals.source}: describes none of the signals that the rig records: {', '.join(recording.channels)}"
        )
    seed = experiment.settings.seed
    notes = {"ces_rig": f"synthetic: experiment {recording.name}, seed {seed}"}
    write_bag(out, topics, overwrite=request.overwrite, notes=notes)
    if request.json:
        channels = {
            name: {"unit": one.unit, "samples": len(one), "low": one.values.min(), "high": one.values.max()}
            for name, one in recording.channels.items()
        }
        print_document("rig", {"experiment": recording.name, "seed": seed, "bag": out, "channels": channels})
        return
    samples = ", ".join(f"{len(channel)} {name}" for name, channel in recording.channels.items())
    force = recording.channel("force").values
    print(f"{out}: {samples} samples; force {force.min():.0f} to {force.max():.0f} N")
