"""`ces compare`: simulations, campaigns and recordings, told apart by what they are, compared by their costs."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ces_cli.terminal import terminal
from ces_cli.terminal.options import JSON, OVERWRITE, REPORT, SIGNALS
from ces_cli.terminal.outputs import name_report, print_document, require_outputs
from ces_cli.terminal.recordings import find_bags, print_findings
from ces_cli.terminal.simulations import find_file, open_simulation, with_predictions
from ces_data.arrays import F
from ces_data.recording import Recording
from ces_identify.campaign.campaign_page import write_campaign_page
from ces_identify.campaign.campaign_rows import CampaignRows, pooled_cost, read_campaign
from ces_identify.comparison.compared_models import ComparedModel, make_compared_model, name_sources
from ces_identify.comparison.comparison import MAX_DRAWN, Comparison, compare, cost_table, headline, join
from ces_identify.comparison.comparison_report import (
    comparison_document,
    model_table,
    pair_table,
    recording_table,
    write_comparison,
)
from ces_identify.jobs.results import Row
from ces_identify.simulations.fmu import SPEC
from ces_identify.simulations.simulation import Simulation, find_predictions
from ces_identify.validation.cost_table import NONE
from ces_observer.errors import CesError
from ces_observer.signals import Signals
from ces_report.table import Column, Table

FILES = (".json", ".yaml", ".yml")
RESULTS = "results.jsonl"
MAX_PAIRS = 6  # that the terminal shows
USAGE = "usage: ces compare A.json B.json ... BAG..."


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_intermixed_args(argv)  # arguments may follow options
    words = sort_words(options.words)
    options.report = name_report(options.report, words.names, [path.stem for path in find_bags(words.bags)])
    require_outputs(options.overwrite, {"--report": options.report}, inputs=[*words.inputs, options.signals])
    facts = {"command": terminal.command_line("compare", argv)}
    if words.campaigns and not words.bags and not words.simulations:
        _show_campaign(words.campaigns, options, facts)
    else:
        _compare_and_print(words, options, facts)
    if options.report is not None and not options.json:
        print(f"report: {options.report}")
    return 0


def _compare_and_print(words: ComparedWords, options: argparse.Namespace, facts: dict[str, str]) -> None:
    chosen = front_models(words.campaigns, max(MAX_DRAWN - len(words.simulations), 1))
    if len(words.simulations) + len(chosen) < 2:
        raise CesError(_describe_too_few([*words.simulations, *chosen.values()], words))
    if not words.bags:
        raise CesError(f"no recording given; {USAGE}")
    signals = terminal.load_described_signals(options)
    recordings = {path: terminal.read_one(path, signals, terminal.FORCE) for path in find_bags(words.bags)}
    found = print_findings(list(recordings.values()))
    models = _open_models(words.simulations, chosen, recordings, signals)
    with terminal.err.status("comparing") as status:
        comparison = compare(models, list(recordings.values()), options.part, announce=status.update)
    if options.report is not None:
        write_comparison(options.report, comparison, facts["command"])
        for note in comparison.notes_on_charts():
            terminal.print_warning(note)
    if options.json:
        print_document("compare", {**comparison_document(comparison), "findings": found})
        return
    several = [recording_table(comparison)] if len(comparison.recordings) > 1 else []
    pairs = [pair_table(comparison)] if len(comparison.pairs) <= MAX_PAIRS else []
    tables: list[Table[Any]] = [cost_table(comparison), *several, *pairs, model_table(comparison)]
    for table in tables:
        terminal.print_table(terminal.lay_out(table))
    for line in sentences(comparison):
        terminal.print_line(line)


def sentences(comparison: Comparison) -> Iterator[str]:
    """Yield what the differences say, and what to know before believing them."""
    yield headline(comparison)
    if any(math.isfinite(cost.cost) and cost.interval is None for m in comparison.models for cost in m.costs):
        yield f"{NONE}: too short for an interval"
    others = [m.name for m in comparison.models if m.model.model is None]
    if others:
        yield f"{NONE} for {join(others)}: no size, time of a tick, bound or envelope, because it is no model file"
    if len(comparison.pairs) > MAX_PAIRS:
        yield f"{len(comparison.pairs)} pairs of models: all differences with --report or --json"
    if any(m.force_bound_N is not None for m in comparison.models):
        yield "bound: |force| for inputs within the model's envelope, proved when it was identified"
    if comparison.machine:
        yield f"µs/tick: the observer's estimator on this machine ({comparison.machine}), models in turns"
    yield from (f"note: {note}" for note in comparison.notes())


def _describe_too_few(models: Sequence[str | Path], words: ComparedWords) -> str:
    """Return the message for fewer than two models, with what the other arguments were taken for."""
    found = f"one model given ({models[0]})" if models else "no model given"
    others = f"; taken as recordings: {', '.join(words.bags)}" if words.bags else ""
    return f"{found}{others}; expected at least two models or other simulations; {USAGE}"


def _show_campaign(folders: Sequence[Path], options: argparse.Namespace, facts: Mapping[str, str]) -> None:
    """Print the fronts of a campaign, and write its page to --report. Raises CesError for several campaigns."""
    for name, unused in (("--signals", options.signals is None), ("--part", options.part == (0.0, 1.0))):
        if not unused:
            raise CesError(f"{name} applies to recordings; add some to compare the models on the campaign's front")
    if len(folders) > 1:
        raise CesError("several campaigns and no recording; add recordings to compare the models on their fronts")
    (folder,) = folders
    results = _read(folder)
    if options.report is not None:
        write_campaign_page(options.report, results, folder, folder.resolve().name, facts)
    if options.json:
        front = results.front_keys()
        cells = [{"name": results.full_name(row), "on_front": row["key"] in front, **row} for row in results.done]
        print_document("compare", {"campaign": str(folder), "cells": cells})
        return
    recommended = {row["key"] for row in results.recommended().values()}
    for name in filter(results.of_bags, results.bags):
        table = _front_table(results, name)
        terminal.print_table(terminal.lay_out(table, lambda row: "bold" * (row["key"] in recommended)))
    for row in results.failed:
        terminal.print_warning(f"{results.full_name(row)}: {row['status']}: {row['reason']}")


def _front_table(results: CampaignRows, bags: str) -> Table[Row]:
    def figure(heading: str, value: Callable[[Row], float | None]) -> Column[Row]:
        def text(row: Row) -> str:
            return NONE if (number := value(row)) is None else f"{number:.2f}"

        return Column(heading, text, figure=True, terminal_only=True)

    columns: list[Column[Row]] = [
        Column("model", results.name, terminal_only=True),
        Column("file", lambda row: f"models/{row['key'][:8]}….json", terminal_only=True),
        Column("size", lambda row: str(row["parameters"]), figure=True, terminal_only=True),
        figure("selection", lambda row: row["selection_J"]),
        *(figure(name, partial(_pooled, name)) for name in results.sets),
    ]
    rows = [row for row in _front(results) if row["bags"] == bags]
    return Table(columns, rows, f"front of the models identified on {bags}; costs J in %")


def _pooled(name: str, row: Row) -> float | None:
    return pooled_cost(row, name)[0]


def front_models(folders: Sequence[Path], count: int) -> dict[str, str]:
    """Return by name the model files on the fronts of campaigns, at most `count` with the lowest selection cost.

    Says so if it leaves some out. Raises CesError if a campaign has no model.
    """
    found = []
    for folder in folders:
        results = _read(folder)
        for row in _front(results):
            parts = [folder.resolve().name] if len(folders) > 1 else []
            parts += [row["bags"]] if len(results.bags) > 1 else []
            name = "/".join([*parts, results.name(row).replace(", ", " ")])  # no commas: sentences list several
            found.append((row, name, folder))
    found.sort(key=lambda one: one[0]["selection_J"])
    if len(found) > count:
        terminal.print_warning(
            f"{len(found)} models on the fronts; compared are the {count} with the lowest selection cost"
        )
    return {name: str(folder / "models" / f"{row['key']}.json") for row, name, folder in found[:count]}


def _read(folder: Path) -> CampaignRows:
    results = read_campaign(folder)
    if not results.done:
        raise CesError(f"{folder}: no cell of this campaign has a model")
    return results


def _front(results: CampaignRows) -> list[Row]:
    keys = results.front_keys()
    return [row for row in results.done if row["key"] in keys]


@dataclass(frozen=True)
class ComparedWords:
    """The arguments by kind: specifications of simulations, folders of campaigns, and words that name bags."""

    simulations: tuple[str, ...]
    campaigns: tuple[Path, ...]
    bags: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """The names of simulations and campaigns."""
        return [*name_sources(self.simulations), *(path.resolve().name for path in self.campaigns)]

    @property
    def inputs(self) -> list[Path | None]:
        """The files and folders that are read."""
        return [*map(find_file, self.simulations), *self.campaigns, *map(Path, self.bags)]


def sort_words(words: Sequence[str]) -> ComparedWords:
    """Return the arguments by kind; raises CesError for a simulation that is given twice."""
    simulations = [
        word
        for word in words
        if word.startswith("topic:")
        or SPEC.fullmatch(word)
        or Path(word).suffix.lower() in FILES
        or (":" in word and not Path(word).exists())
    ]
    for word in simulations:
        if simulations.count(word) > 1:
            raise CesError(f"{word} is given twice; a model does not differ from itself")
    campaigns = [word for word in words if (Path(word) / RESULTS).is_file()]
    bags = [word for word in words if word not in simulations and word not in campaigns]
    return ComparedWords(tuple(simulations), tuple(map(Path, campaigns)), tuple(bags))


def _open_models(
    simulations: Sequence[str],
    chosen: Mapping[str, str],
    recordings: Mapping[Path, Recording],
    signals: Signals,
) -> list[ComparedModel]:
    """Return the simulations and the `chosen` files by name; predictions are read from the recordings' bags."""
    specs = [*simulations, *chosen.values()]
    known = {path: name for name, path in chosen.items()}
    models = []
    for name, spec in zip(name_sources(specs), specs, strict=True):
        simulation = open_simulation(spec)
        if find_predictions(simulation) is not None:
            extended = {one.source: with_predictions(simulation, p, one, signals) for p, one in recordings.items()}
            simulation = PredictedSimulation(simulation, extended)
        models.append(make_compared_model(known.get(spec, name), simulation, spec))
    return models


@dataclass(frozen=True)
class PredictedSimulation(Simulation):
    """A simulation whose force is in the bags; `extended` holds each recording with it, by the recording's source."""

    simulation: Simulation
    extended: Mapping[str, Recording]

    @property
    def innermost(self) -> Simulation:
        """The simulation inside."""
        return self.simulation.innermost

    def force(self, recording: Recording) -> F:
        """Return the recorded force [N] at every position sample (n,)."""
        return self.simulation.force(self.extended[recording.source])


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    p = terminal.parser(
        "compare",
        "Compare models, or any other simulations, on the same recordings with a measured force: the cost J of each "
        "free run with its interval, whether the differences are larger than chance (a paired test that allows for "
        "slow changes, Holm's correction), and what each model is. A recording that a model was identified on is no "
        "test and is marked.",
        "ces compare model.json best.json bags/sine_4hz bags/road --report compare.html",
    )
    text = (
        "simulations to compare (MODEL.json, AUGMENTED.json, RIG.yaml, FILE.fmu, module:function, topic:/name), the "
        "folder of a campaign for the models on its front (alone: its page), and recordings"
    )
    p.add_argument("words", nargs="+", metavar="SIM|BAG", help=text)
    terminal.add_options(p, SIGNALS)
    terminal.add_part(p)
    terminal.add_options(p, REPORT, JSON, OVERWRITE)
    return p
