"""`ces import`: converts logs of dynos and measurement systems to bags that all other programs read."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ces_cli.bags.signals import print_proposal
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, OVERWRITE, SIGNALS, never_with
from ces_cli.terminal.outputs import print_document, require_outputs, schema_line, without_text
from ces_cli.terminal.progress import FileProgress
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.check import check_recording
from ces_data.findings import DelayFinding, findings, mean_rate
from ces_data.logs.log_file import open_log, refuse_bag
from ces_data.logs.log_import import to_recording
from ces_data.logs.log_mapping import TEMPLATE, DynoMapping, load_dyno_mapping
from ces_data.mapping.proposals import MappingProposal, propose_mapping
from ces_data.recording import Recording
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.signals import Signal, Signals

MAPPING_WORDS = ("--scale", "--unit", "--units", "--offset", "--delimiter", "--decimal", "--blank")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError; writes no bag unless all files can be read."""
    parser = make_parser()
    words = list(sys.argv[1:] if argv is None else argv)
    for word in (word.partition("=")[0] for word in words):
        if word in MAPPING_WORDS:
            parser.error(
                f"{word}: how a column is read belongs in the mapping, as in 'position: {{column: x, scale: 0.001}}'; "
                "'ces import FILE --propose > my.yaml' writes one"
            )
    options = parser.parse_args(words)
    if options.template:
        print(schema_line("import") + TEMPLATE, end="")
        return 0
    if not options.files:
        parser.error("expected FILE and --out, or FILE and --propose, or --template")
    for path in options.files:
        refuse_bag(path)
    if options.propose:
        return _propose(options, parser)
    if options.out is None:
        parser.error("expected --out BAG (or --propose, which writes a mapping)")
    if options.mapping is not None and (options.rate or options.dbc):
        parser.error(f"with --mapping, give 'rate' and 'dbc' in {options.mapping}")
    with without_text(options.json):
        bags = _import(options)
    if options.json:
        print_document("import", {"bags": [_as_json(recording, path) for path, recording in bags.items()]})
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    parser = terminal.parser(
        "import",
        "Convert logs to bags. Without --mapping, the columns are found by their names, units and numbers, and what "
        "was found is said; what is not certain is refused, and --propose writes a mapping to correct. The mapping "
        "file says which columns hold time, position, current and force, and how to scale them to s, m, A and N. "
        "One FILE becomes the bag --out; several FILEs become one bag each in the folder --out.",
        "ces import my_log.csv --out recording\n"
        "  ces import my_log.csv --propose > my_dyno.yaml\n"
        "  ces import sweep_*.csv --mapping config/import/utfsm_mr.yaml --out recordings",
    )
    kinds = "log: .csv .txt .dat .tsv, .json, .mat, .mf4 .mdf, .blf .asc .log (CAN), .bag (ROS 1), .parquet"
    parser.add_argument("files", type=Path, nargs="*", metavar="FILE", help=kinds)
    text = "mapping of columns to signals; examples are in share/ces_observer/config/import (default: found, and said)"
    parser.add_argument("--mapping", type=Path, metavar="MAP.yaml", help=text)
    parser.add_argument("--out", type=Path, metavar="BAG", help="bag to write, or folder for several")
    terminal.add_options(parser, SIGNALS, OVERWRITE, JSON)
    parser.add_argument("--propose", action="store_true", help="print a mapping for FILE with reasons, and exit")
    rate = terminal.number_between(1e-3, 1e6)
    parser.add_argument("--rate", type=rate, metavar="HZ", help="rate of a log without a time column (no --mapping)")
    text = "database of a CAN log; may be repeated (no --mapping)"
    parser.add_argument("--dbc", type=Path, action="append", default=[], metavar="FILE", help=text)
    parser.add_argument("--template", action="store_true", help="print a commented mapping file and exit")
    parser.rules = (
        never_with(ALL, "template", "does not apply with --template", but="template"),
        never_with("json overwrite signals", "propose", "does not apply with --propose, which prints a mapping"),
    )
    return parser


def _propose(options: Namespace, parser: terminal.Parser) -> int:
    """Print the proposal for one log; what it says is explained on the error stream."""
    if len(options.files) != 1 or options.out is not None or options.mapping is not None:
        parser.error("--propose takes one FILE and prints its mapping: ces import FILE --propose > my.yaml")
    proposal = _find_mapping(options.files[0], options)
    print(schema_line("import") + proposal.text, end="")
    print_proposal(proposal.selection, terminal.err)
    for note in proposal.log.notes:
        terminal.print_line(f"{options.files[0]}: {note}", console=terminal.err)
    return 0


def _find_mapping(path: Path, options: Namespace) -> MappingProposal:
    with FileProgress("reading", path) as bar:
        return propose_mapping(path, rate=options.rate, dbc=options.dbc, progress=bar.listen)


def _import(options: Namespace) -> dict[Path, Recording]:
    """Import all files; return the recordings by their bags."""
    mapping = load_dyno_mapping(options.mapping) if options.mapping else None
    signals = terminal.load_described_signals(options)
    for signal in signals.list_topic_signals():
        if (signal.scale, signal.offset) != (1.0, 0.0):
            raise SignalsError(
                f"{options.signals}: {signal.name} has scale {signal.scale:g} and offset {signal.offset:g}; an "
                "imported bag is in SI units: give the log's scale in "
                f"{options.mapping or 'the mapping (--mapping)'}, and none here"
            )
    paths = _bag_paths(options.files, options.out)
    for path in paths:
        inputs = [*options.files, options.mapping, options.signals]
        require_outputs(options.overwrite, bags={"--out": path}, inputs=inputs)
    recordings = [_read(path, mapping, options) for path in options.files]
    for recording, path in zip(recordings, paths, strict=True):
        _write(recording, path, signals, options.overwrite, str(options.mapping or "a mapping (--propose writes one)"))
    return dict(zip(paths, recordings, strict=True))


def _read(path: Path, mapping: DynoMapping | None, options: Namespace) -> Recording:
    """Read one log with the mapping, or with one that is found; raises RecordingError if that is not certain."""
    if mapping is None:
        proposal = _find_mapping(path, options)
        recording = proposal.read()
        print(f"{path}: {', '.join((*proposal.log.notes, *proposal.found))}")
        for remark in proposal.remarks:
            terminal.print_warning(f"{path}: {remark}; taken as logged")
        return recording
    with FileProgress("reading", path) as bar:
        log = open_log(path, mapping, bar.listen)
        recording = to_recording(log, mapping)
    if log.notes:
        print(f"{path}: {', '.join(log.notes)}")
    return recording


def _bag_paths(files: Sequence[Path], out: Path) -> list[Path]:
    """Return the bag to write for each file; raises RecordingError if two would have the same path."""
    if len(files) == 1:
        return [out]
    stem, count = Counter(path.stem for path in files).most_common(1)[0]
    if count > 1:
        raise RecordingError(f"{count} files are named '{stem}' and would give the same bag; import them one by one")
    return [out / path.stem for path in files]


def _as_json(recording: Recording, path: Path) -> dict[str, object]:
    """Return a bag for the document of --json."""
    position = recording.channel("position")
    return {
        "file": recording.source,
        "bag": path,
        "samples": len(position),
        "rate_Hz": mean_rate(position),
        "channels": list(recording.channels),
        "findings": (*findings(recording), *check_recording(recording)),
    }


def _write(recording: Recording, path: Path, signals: Signals, overwrite: bool, mapping: str) -> None:
    with terminal.err.status(f"checking {recording.source}"):
        found = (*findings(recording), *check_recording(recording))
    for finding in found:  # the remedy is in the mapping; a delay stays in the signals file, which later programs read
        text = finding.text
        text = text if isinstance(finding, DelayFinding) else text.replace("the signals file", mapping)
        terminal.print_warning(f"{recording.source}: {text}")
    written = [name for name in recording.channels if isinstance(signals.by_name.get(name), Signal)]
    for name in recording.channels.keys() - set(written):
        terminal.print_warning(f"{recording.source}: {name} is left out; give it a topic in the signals file")
    notes = {"imported_from": Path(recording.source).name}
    topics = recording_topics(recording, signals.without_delays())
    with FileProgress("writing", path) as bar:
        write_bag(path, topics, overwrite=overwrite, notes=notes, progress=bar.listen)
    position = recording.channel("position")
    rate = mean_rate(position)
    print(f"{path}: {len(position)} samples of {', '.join(written)} at {rate:.1f} Hz")
