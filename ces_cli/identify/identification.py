"""One identification, as `ces identify` and the node `identify` run it: options in, model and report out."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ces_cli.identify.distillation import with_teacher
from ces_cli.identify.structures import candidate_rules, select_identify_function
from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import find_bags, with_distinct_names
from ces_cli.terminal.outputs import name_report, require_outputs
from ces_cli.terminal.simulations import find_file, open_simulation, with_teacher_force
from ces_identify.identification import IdentificationResult, count_starts
from ces_identify.polynomial.search_limits import Limits, SearchResult
from ces_identify.preparation.weighting import parse_weighting
from ces_identify.progress_file import SearchProgressFile
from ces_identify.recordings.checks import Finding
from ces_identify.recordings.recording import Recording
from ces_identify.sense.content import require_distinct
from ces_identify.sense.sense import require_sensible, sense_together
from ces_identify.structures.kit import IdentifyOptions
from ces_observer.errors import CesError

AUTO = "auto"  # the differentiator: measured speed, or fused acceleration, if all recordings have it


class Progress(Protocol):
    """Receives the results of a search while it runs; `listen` is called from any thread."""

    def listen(self, result: SearchResult) -> None:
        """Receive an improvement or the end of a start."""


ShowProgress = Callable[[Limits], AbstractContextManager[Progress]]


@dataclass(frozen=True)
class Identification:
    """The inputs of an identification.

    `bags` and `validation` are recordings with the force to learn, `measured` all of them as logged. `forced` are the
    findings in spite of which --force goes on, `findings` all of the sense check.
    """

    options: argparse.Namespace
    bags: Sequence[Recording]
    validation: Sequence[Recording]
    measured: Sequence[Recording]
    how: IdentifyOptions
    forced: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()

    def run(self, show_progress: ShowProgress) -> IdentificationResult:
        """Search, write the model and return it; Ctrl-C stops with the best model so far. Raises CesError."""
        with self._open_progress_file() as file:
            result = self._search(show_progress, file)
            if self.options.teacher is not None:
                result = with_teacher(result, self.options.teacher, self.measured)
            result = result.with_forced(self.forced)
            result.model.save(self.options.out)
        return result

    def _search(self, show_progress: ShowProgress, file: SearchProgressFile) -> IdentificationResult:
        with show_progress(self.how.limits) as progress:

            def listen(result: SearchResult) -> None:
                progress.listen(result)
                file.listen(result)

            return select_identify_function(self.options)(self.bags, self.validation, self.how, listen)

    def _open_progress_file(self) -> SearchProgressFile:
        limits = self.how.limits
        facts = {
            "structure": self.options.structure,
            "seconds": limits.seconds,
            "starts": limits.starts,
            "recordings": [recording.name for recording in self.bags],
            "validation": [recording.name for recording in self.validation],
        }
        return SearchProgressFile("identify", self.options.out, facts)


def prepare_identification(options: argparse.Namespace) -> Identification:
    """Read and check all files that `options` name, before the long search; raises CesError."""
    if not options.bags:
        raise CesError("no recording given; usage: ces identify BAG... --out MODEL.json")
    paths = [find_bags(words, repeated=True) for words in (options.bags, options.validate)]
    tested = paths[1] or paths[0]
    options.report = name_report(options.report, [options.out.stem], [path.stem for path in tested])
    outputs = {"--out": options.out, "--report": options.report, "--picture": options.picture}
    inputs = [*paths[0], *paths[1], options.signals, options.candidates, find_file(options.teacher or "")]
    require_outputs(options.overwrite, outputs, inputs=inputs)
    rules = candidate_rules(options)
    weighting = parse_weighting(options.weight)
    measured = _read_recordings(options, [*paths[0], *paths[1]])
    bags, validation = (_apply_teacher(options, some, measured) for some in paths)
    require_distinct(bags, validation)
    found = sense_together([*bags, *validation])
    forced = require_sensible(found, options.force)
    for finding in found:
        terminal.print_warning(finding.text)
    split = options.split if options.split is not None else 1.0 if validation else 0.75
    searches = (options.starts, options.seed, options.threads)
    limits = Limits(options.terms, options.time, options.target, *searches, method=options.method)
    how = IdentifyOptions(
        split,
        rules,
        limits,
        options.rate,
        options.bandwidth,
        not options.no_certificate,
        weighting,
        not options.no_band,
        None if options.differentiator == AUTO else options.differentiator,
    )
    return Identification(options, bags, validation, tuple(measured.values()), how, forced, found)


def write_report_page(result: IdentificationResult, options: argparse.Namespace, command: str) -> None:
    """Write the report to options.report; raises CesError if it cannot be written."""
    from ces_identify.report import write_report

    best = result.search_results[0]
    trials = sum(f.trials for f in result.search_results)
    facts = {
        "command": command,
        "selection": f"{describe_starts(result, options)}, {trials} trials",
        "end of search": best.ended,
    }
    write_report(options.report, f"Model {options.out.name}", result.model, result.evaluations, facts)


def describe_starts(result: IdentificationResult, options: argparse.Namespace) -> str:
    """Return which start was best, and how many starts led to a model."""
    seed = result.search_results[0].seed
    count = count_starts(result.search_results)
    return f"best: start {seed - options.seed + 1} of {options.starts} (seed {seed}); {count} led to a model"


def _read_recordings(options: argparse.Namespace, paths: Sequence[Path]) -> dict[Path, Recording]:
    """Return the recordings as logged; with a teacher, the force may be missing."""
    signals = terminal.load_described_signals(options)
    need = terminal.FORCE if options.teacher is None else terminal.FORCE[:2]
    return with_distinct_names({path: terminal.read_one(path, signals, need) for path in paths})


def _apply_teacher(
    options: argparse.Namespace, paths: Sequence[Path], measured: Mapping[Path, Recording]
) -> list[Recording]:
    """Return the recordings with the force to learn."""
    if options.teacher is None:
        return [measured[path] for path in paths]
    teacher, signals = open_simulation(options.teacher), terminal.load_described_signals(options)
    return [with_teacher_force(teacher, path, measured[path], signals) for path in paths]
