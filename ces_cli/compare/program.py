"""`ces compare`: models and other simulations on the same recordings, with the differences of their costs."""

from __future__ import annotations

import argparse
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from ces_cli.compare.arguments import ComparedWords, open_models, read_recordings, sort_words
from ces_cli.compare.campaign_fronts import front_models, show_campaigns
from ces_cli.compare.comparison_tables import MAX_PAIRS, cost_table, model_table, pair_table, recording_table, sentences
from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import find_bags
from ces_cli.terminal.findings import print_findings
from ces_cli.terminal.json_output import add_json, print_document
from ces_cli.terminal.outputs import add_overwrite, add_report, name_report, require_outputs
from ces_identify.comparison.comparison import MAX_DRAWN, Comparison, compare
from ces_identify.comparison.comparison_json import comparison_document
from ces_identify.comparison.comparison_page import write_comparison
from ces_identify.recordings.checks import Finding
from ces_observer.errors import CesError

USAGE = "usage: ces compare A.json B.json ... BAG..."


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_intermixed_args(argv)  # arguments may follow options
    words = sort_words(options.words)
    options.report = name_report(options.report, words.names, [path.stem for path in find_bags(words.bags)])
    require_outputs(options.overwrite, {"--report": options.report}, inputs=[*words.inputs, options.signals])
    facts = {"command": shlex.join(["ces", "compare", *(sys.argv[2:] if argv is None else argv)])}
    if words.campaigns and not words.bags and not words.simulations:
        _require_recordings_for_options(options)
        show_campaigns(words.campaigns, options, facts)
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
    specs = {path: name for name, path in chosen.items()}
    recordings = read_recordings(words.bags, signals)
    found = print_findings([recording for _, recording in recordings])
    models = open_models([*words.simulations, *specs], recordings, signals, specs)
    with terminal.err.status("comparing") as status:
        comparison = compare(models, [one for _, one in recordings], options.part, announce=status.update)
    if options.report is not None:
        write_comparison(options.report, comparison, facts)
        for note in comparison.notes_on_charts():
            terminal.print_warning(note)
    _print(comparison, found, options.json)


def _describe_too_few(models: Sequence[str | Path], words: ComparedWords) -> str:
    """Return the message for fewer than two models, with what the other arguments were taken for."""
    found = f"one model given ({models[0]})" if models else "no model given"
    others = f"; taken as recordings: {', '.join(words.bags)}" if words.bags else ""
    return f"{found}{others}; expected at least two models or other simulations; {USAGE}"


def _require_recordings_for_options(options: argparse.Namespace) -> None:
    for name, unused in (("--signals", options.signals is None), ("--part", options.part == (0.0, 1.0))):
        if not unused:
            raise CesError(f"{name} applies to recordings; add some to compare the models on the campaign's front")


def _print(comparison: Comparison, found: Sequence[Finding], as_json: bool) -> None:
    if as_json:
        print_document("compare", {**comparison_document(comparison), "findings": found})
        return
    recordings = [recording_table(comparison)] if len(comparison.recordings) > 1 else []
    pairs = [pair_table(comparison)] if len(comparison.pairs) <= MAX_PAIRS else []
    for table in (cost_table(comparison), *recordings, *pairs, model_table(comparison)):
        terminal.print_table(table)
    for line in sentences(comparison):
        terminal.out.print(line, highlight=False, soft_wrap=True)


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
    terminal.add_signals(p)
    terminal.add_part(p)
    add_report(p)
    add_json(p)
    add_overwrite(p)
    return p
