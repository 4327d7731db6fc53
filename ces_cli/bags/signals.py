"""`ces signals`: proposes a signals file from the topics of bags, with the reason for each guess."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ces_cli.bags.proposal_table import print_proposal, proposal_rows
from ces_cli.terminal import terminal
from ces_cli.terminal.bag_paths import find_bags
from ces_cli.terminal.json_output import add_json, print_document
from ces_cli.terminal.outputs import add_overwrite, require_new_file
from ces_identify.proposal.signals_proposal import SignalsProposal, propose_signals
from ces_identify.schema_files import schema_line
from ces_observer.json_checks import write_atomically


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError if nothing looks like a signal."""
    options = make_parser().parse_args(argv)
    require_new_file(options.out, options.overwrite)
    paths = find_bags(options.bags)
    with terminal.err.status("reading all topics"):
        proposal = propose_signals(paths)
    text = schema_line("signals") + proposal.text
    if options.out:
        write_atomically(options.out, text)
    if options.json:
        print_document("signals", _as_json(proposal))
    elif options.out is None:
        print(text, end="")
    print_proposal(
        proposal.selection, terminal.err if options.json or options.out is None else terminal.out, proposal.skipped
    )
    if options.out:
        example = f"{options.out}#{proposal.selection.names[0]}" if proposal.selection.names else f"{options.out}"
        terminal.err.print(f"signals: {options.out}", highlight=False, soft_wrap=True)
        terminal.err.print(f"next:    {_next_step(proposal, paths[0], example)}", highlight=False, soft_wrap=True)
    return 0


def _next_step(proposal: SignalsProposal, bag: Path, example: str) -> str:
    """Return what to do with the file: complete it, if nothing looks like a signal that all programs need."""
    missing = list(dict.fromkeys(found.signal for found in proposal.selection.missing))
    if missing:
        return f"complete {example} by hand: nothing was found for {' and '.join(missing)} (its comments say why)"
    return f"ces info {bag} --signals '{example}'"


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    parser = terminal.parser(
        "signals",
        "Propose a signals file from the topics that bags hold: which field is position, current and force, in which "
        "unit and with which sign, with the reason for each guess, and with what could not be known. Without --out the "
        "file goes to the standard output. Several bags have to have the same topics.",
        "ces signals bags/noise --out my_signals.yaml",
    )
    parser.add_argument("bags", nargs="+", metavar="BAG", help="rosbag2 folder, .mcap, .db3 or .bag file, or a glob")
    parser.add_argument("--out", type=Path, metavar="FILE", help="signals file to write (YAML)")
    add_json(parser)
    add_overwrite(parser)
    return parser


def _as_json(proposal: SignalsProposal) -> dict[str, Any]:
    return {
        "dampers": list(proposal.selection.names),
        "signals": proposal_rows(proposal.selection),
        "checks": list(proposal.selection.checks),
        "not_examined": proposal.skipped,
    }
