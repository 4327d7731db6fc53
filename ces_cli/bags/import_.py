"""`ces import`: converts logs of dynos and measurement systems to bags that all other programs read."""

from __future__ import annotations

from argparse import Namespace
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ces_cli.bags.signals import print_proposal
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, JSON, OVERWRITE, SIGNALS, Argument, never_with
from ces_cli.terminal.outputs import print_document, require_outputs, schema_line, without_text
from ces_cli.terminal.progress import FileProgress
from ces_data.bags.writer import recording_topics, write_bag
from ces_data.checks.check import check_recording
from ces_data.findings import DelayFinding, Finding, findings, mean_rate
from ces_data.log_formats import LOG_FORMATS
from ces_data.logs.log_file import open_log, refuse_bag
from ces_data.logs.log_import import to_recording
from ces_data.logs.log_mapping import TEMPLATE, DynoMapping, load_dyno_mapping
from ces_data.mapping.proposals import MappingProposal, propose_mapping
from ces_data.recording import Recording
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.options import Option
from ces_observer.signals import Signal, Signals


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError; writes no bag unless all files can be read."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.template:
        print(schema_line("import") + TEMPLATE, end="")
        return 0
    for path in options.files:
        refuse_bag(path)
    if options.propose and len(options.files) == 1 and options.out is None and options.mapping is None:
        _propose(options.files[0], options)
        return 0
    if options.propose:
        parser.error("--propose takes one FILE and prints its mapping: ces import FILE --propose > my.yaml")
    if not options.files or options.out is None:
        parser.error("expected FILE and --out BAG, or FILE and --propose (writes a mapping), or --template")
    if options.mapping is not None and (options.rate or options.dbc):
        parser.error(f"with --mapping, give 'rate' and 'dbc' in {options.mapping}")
    with without_text(options.json):
        bags = _import(options)
    if options.json:
        print_document("import", {"bags": [_as_json(*one) for one in bags]})
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    kinds = "log: " + ", ".join(" ".join(suffixes) for suffixes in LOG_FORMATS.values())
    text = "mapping of columns to signals; examples are in share/ces_observer/config/import"
    rate = "rate of a log without a time column (no --mapping)"
    return terminal.parser(
        "import",
        "Convert logs to bags. Without --mapping, the columns are found by their names, units and numbers, and what "
        "was found is said; what is not certain is refused, and --propose writes a mapping to correct. The mapping "
        "file says which columns hold time, position, current and force, and how to scale them to s, m, A and N. "
        "One FILE becomes the bag --out; several FILEs become one bag each in the folder --out.",
        "ces import my_log.csv --out recording\n"
        "  ces import my_log.csv --propose > my_dyno.yaml\n"
        "  ces import sweep_*.csv --mapping config/import/utfsm_mr.yaml --out recordings",
        Argument("files", (), kinds, kind=Path, metavar="FILE", count="*"),
        Option("mapping", None, text, kind=Path, none="found, and said", metavar="MAP.yaml"),
        Option("out", None, "bag to write, or folder for several", kind=Path, metavar="BAG"),
        *(SIGNALS, OVERWRITE, JSON),
        Option("propose", False, "print a mapping for FILE with reasons, and exit"),
        Option("rate", None, rate, 1e-3, 1e6, kind=float, metavar="HZ"),
        Option("dbc", (), "database of a CAN log (no --mapping)", kind=Path, metavar="FILE"),
        Option("template", False, "print a commented mapping file and exit"),
        rules=(
            never_with(ALL, "template", "does not apply with --template", but="template"),
            never_with("json overwrite signals", "propose", "does not apply with --propose, which prints a mapping"),
        ),
    )


def _propose(path: Path, options: Namespace) -> None:
    """Print the proposal for one log; what it says is explained on the error stream."""
    proposal = _find_mapping(path, options)
    print(schema_line("import") + proposal.text, end="")
    print_proposal(proposal.selection, terminal.err)
    for note in proposal.log.notes:
        terminal.print_line(f"{path}: {note}", console=terminal.err)


def _find_mapping(path: Path, options: Namespace) -> MappingProposal:
    with FileProgress("reading", path) as bar:
        return propose_mapping(path, rate=options.rate, dbc=options.dbc, progress=bar.listen)


def _import(options: Namespace) -> list[tuple[Path, Recording, tuple[Finding, ...]]]:
    """Import all files; return their bags, recordings and findings. Raises CesError."""
    mapping = load_dyno_mapping(options.mapping) if options.mapping else None
    signals = terminal.load_described_signals(options)
    for signal in signals.list_topic_signals():
        if (signal.scale, signal.offset) != (1.0, 0.0):
            raise SignalsError(
                f"{options.signals}: {signal.name} has scale {signal.scale:g} and offset {signal.offset:g}; an "
                "imported bag is in SI units: give the log's scale in "
                f"{options.mapping or 'the mapping (--mapping)'}, and none here"
            )
    stem, count = Counter(path.stem for path in options.files).most_common(1)[0]
    several = len(options.files) > 1
    if count > 1:
        raise RecordingError(f"{count} files are named '{stem}' and would give the same bag; import them one by one")
    bags = [options.out / path.stem if several else options.out for path in options.files]
    for bag in bags:
        inputs = [*options.files, options.mapping, options.signals]
        require_outputs(options.overwrite, bags={"--out": bag}, inputs=inputs)
    recordings = [_read(path, mapping, options) for path in options.files]
    return [(bag, one, _write(one, bag, signals, options)) for bag, one in zip(bags, recordings, strict=True)]


def _read(path: Path, mapping: DynoMapping | None, options: Namespace) -> Recording:
    """Read one log with the mapping, or with one that is found; raises RecordingError if that is not certain."""
    if mapping is None:
        proposal = _find_mapping(path, options)
        recording, said = proposal.read(), (*proposal.log.notes, *proposal.found)
    else:
        with FileProgress("reading", path) as bar:
            log = open_log(path, mapping, bar.listen)
            recording, said = to_recording(log, mapping), tuple(log.notes)
    if said:
        print(f"{path}: {', '.join(said)}")
    for remark in proposal.remarks if mapping is None else ():
        terminal.print_warning(f"{path}: {remark}; taken as logged")
    return recording


def _write(recording: Recording, bag: Path, signals: Signals, options: Namespace) -> tuple[Finding, ...]:
    """Write a bag; what is wrong with the recording is printed and returned."""
    source, mapping = recording.source, str(options.mapping or "a mapping (--propose writes one)")
    with terminal.err.status(f"checking {source}"):
        found = (*findings(recording), *check_recording(recording))
    for finding in found:  # the remedy is in the mapping; a delay stays in the signals file, which later programs read
        text = finding.text
        text = text if isinstance(finding, DelayFinding) else text.replace("the signals file", mapping)
        terminal.print_warning(f"{source}: {text}")
    written = [name for name in recording.channels if isinstance(signals.by_name.get(name), Signal)]
    for name in recording.channels.keys() - set(written):
        terminal.print_warning(f"{source}: {name} is left out; give it a topic in the signals file")
    topics = recording_topics(recording, signals.without_delays())
    with FileProgress("writing", bag) as bar:
        notes = {"imported_from": Path(source).name}
        write_bag(bag, topics, overwrite=options.overwrite, notes=notes, progress=bar.listen)
    position = recording.channel("position")
    print(f"{bag}: {len(position)} samples of {', '.join(written)} at {mean_rate(position):.1f} Hz")
    return found


def _as_json(bag: Path, recording: Recording, found: tuple[Finding, ...]) -> dict[str, object]:
    position = recording.channel("position")
    facts = {"file": recording.source, "bag": bag, "samples": len(position), "rate_Hz": mean_rate(position)}
    return {**facts, "channels": list(recording.channels), "findings": found}
