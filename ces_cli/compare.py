"""`ces compare`: simulations and recordings, told apart by what they are, compared by their costs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ces_cli.terminal import terminal
from ces_cli.terminal.inputs import find_file, open_simulation, print_findings, with_predictions
from ces_cli.terminal.options import NEED_REPORT, ReportRequest, argument
from ces_cli.terminal.outputs import name_report, print_document
from ces_data.arrays import F
from ces_data.bags.find import find_bags
from ces_data.outputs import REPORT as REPORT_FILE
from ces_data.outputs import require_outputs
from ces_data.recording import Recording, describe_days
from ces_data.signals_file import load_signals
from ces_identify.comparison import comparison_report
from ces_identify.comparison.compared_models import ComparedModel, make_compared_model
from ces_identify.comparison.comparison import Comparison, compare, name_sources
from ces_identify.comparison.comparison_report import headline, model_table, pair_table
from ces_identify.simulations.fmu import SPEC
from ces_identify.simulations.simulation import Simulation, find_predictions
from ces_observer.errors import CesError
from ces_observer.signals import Signals
from ces_report.shell import PageHead
from ces_report.table import Table

FILES = (".json", ".yaml", ".yml")
MAX_PAIRS = 6  # that the terminal shows
WORDS = (
    "simulations to compare (MODEL.json, AUGMENTED.json, RIG.yaml, FILE.fmu, module:function, topic:/name) "
    "and recordings"
)
USAGE = "usage: ces compare A.json B.json ... BAG..."


@dataclass(frozen=True, kw_only=True)
class CompareRequest(ReportRequest):
    """Compare models, or any other simulations, on the same recordings with a measured force: the cost J of each free
    run with its interval, whether the differences are larger than chance (a paired test that allows for slow changes,
    Holm's correction), and what each model is. A recording that a model was identified on is no test and is marked.
    """

    program = "compare"
    example = "ces compare model.json best.json bags/sine_4hz bags/road --report compare.html"
    option_rules = (NEED_REPORT,)
    intermixed = True

    words: tuple[str, ...] = argument((), WORDS, metavar="SIM|BAG", count="+")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(CompareRequest, argv)
    simulations, bags = sort_words(request.words)
    report = name_report(request.report, name_sources(simulations), [path.stem for path in find_bags(bags)])
    inputs = [*map(find_file, simulations), *map(Path, bags), request.signals]
    require_outputs(request.overwrite, {REPORT_FILE: report}, inputs=inputs)
    models = open_models(simulations)
    if len(models) < 2:
        one = f"one model given ({models[0].source})" if models else "no model given"
        others = f"; taken as recordings: {', '.join(bags)}" if bags else ""
        raise CesError(f"{one}{others}; expected at least two models or other simulations; {USAGE}")
    if not bags:
        raise CesError(f"no recording given; {USAGE}")
    signals = load_signals(request.signals)
    recordings = {path: terminal.read_one(path, signals, terminal.FORCE, request.part) for path in find_bags(bags)}
    findings = print_findings(list(recordings.values()))
    models = [read_predictions(model, recordings, signals) for model in models]
    with terminal.step("comparing") as say:
        comparison = compare(models, list(recordings.values()), announce=say)
    if report is not None:
        command, recorded = terminal.command_line("compare", argv), describe_days(recordings.values())
        head = PageHead(request.title, request.note, command, recorded)
        with terminal.step("writing the report"):
            comparison_report.write_comparison(report, comparison, head)
        for note in comparison.notes_on_charts():
            terminal.print_warning(note)
    if request.json:
        print_document("compare", {**comparison_report.comparison_document(comparison), "findings": findings})
        return 0
    _print_comparison(comparison)
    if report is not None:
        print(f"report: {report}")
    return 0


def sort_words(words: Sequence[str]) -> tuple[list[str], list[str]]:
    """Return simulations and words that name bags; raises CesError for a simulation given twice."""
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
    return simulations, [word for word in words if word not in simulations]


def _print_comparison(comparison: Comparison) -> None:
    several = [comparison_report.recording_table(comparison)] if len(comparison.recordings) > 1 else []
    pairs = [pair_table(comparison.pairs)] if len(comparison.pairs) <= MAX_PAIRS else []
    tables: list[Table[Any]] = [model_table(comparison), *several, *pairs]
    for table in tables:
        terminal.print_table(terminal.lay_out(table))
    for line in sentences(comparison):
        terminal.print_line(line)


def sentences(comparison: Comparison) -> Iterator[str]:
    """Yield what the differences say, and what to know before believing them."""
    yield headline(comparison)
    if len(comparison.pairs) > MAX_PAIRS:
        yield f"{len(comparison.pairs)} pairs of models: all differences with --report or --json"
    if any(m.force_bound_N is not None for m in comparison.models):
        yield "bound: |force| for inputs within the model's envelope, proved when it was identified"
    yield from (f"note: {note}" for note in comparison.notes())


def open_models(simulations: Sequence[str]) -> list[ComparedModel]:
    """Return the simulations by name."""
    names = name_sources(simulations)
    return [
        make_compared_model(name, open_simulation(spec), spec) for name, spec in zip(names, simulations, strict=True)
    ]


def read_predictions(model: ComparedModel, recordings: Mapping[Path, Recording], signals: Signals) -> ComparedModel:
    """Return the model with the predictions in the recordings' bags, if its force is there."""
    if find_predictions(model.simulation) is None:
        return model
    extended = {one.source: with_predictions(model.simulation, p, one, signals) for p, one in recordings.items()}
    return replace(model, simulation=PredictedSimulation(model.simulation, extended))


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
