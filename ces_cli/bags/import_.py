"""`ces import`: converts logs of dynos and measurement systems to bags that all other programs read."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path

from ces_cli.bags.signals import print_proposal
from ces_cli.terminal import terminal
from ces_cli.terminal.options import ALL, BagRequest, argument, never_with, option
from ces_cli.terminal.outputs import print_document, schema_line, without_text
from ces_cli.terminal.progress import FileProgress
from ces_data.bags.storage import ALONE, MEASURED, SPEED
from ces_data.bags.writer import open_bag_writer, recording_topics
from ces_data.checks.check import check_recording
from ces_data.checks.derivatives import compare_derivative
from ces_data.findings import SECOND, DelayFinding, Finding, findings, rate_between_pauses, sort_findings
from ces_data.log_formats import LOG_FORMATS
from ces_data.logs.log_file import MAX_ROWS, LogTable, open_log, refuse_bag
from ces_data.logs.log_import import read_blocks
from ces_data.logs.log_mapping import TEMPLATE, DynoMapping, load_dyno_mapping
from ces_data.mapping.proposals import MappingProposal, propose_mapping, split_damper
from ces_data.mapping.times import describe_time
from ces_data.outputs import OUT, require_outputs
from ces_data.recording import Recording
from ces_data.samples import INTEGRATED, align_speed, velocity_beside
from ces_data.signals_file import load_signals
from ces_observer.errors import RecordingError, SignalsError
from ces_observer.signals import Signal, Signals

LOGS = "log: " + ", ".join(" ".join(suffixes) for suffixes in LOG_FORMATS.values())
LOGS += "; FILE#NAME for one of several dampers in it"
MAPPING = "mapping of columns to signals; examples are in share/ces_observer/config/import"


@dataclass(frozen=True, kw_only=True)
class ImportRequest(BagRequest):
    """Convert logs to bags. Without --mapping, the columns are found by their names, units and numbers, and what was
    found is said; what is not certain is refused, and --propose writes a mapping to correct. The mapping file says
    which columns hold time, position, current and force, and how to scale them to s, m, A and N. One FILE becomes the
    bag --out; several FILEs become one bag each in the folder --out.
    """

    program = "import"
    example = (
        "ces import my_log.csv --out recording\n"
        "  ces import my_log.csv --propose > my_dyno.yaml\n"
        "  ces import sweep_*.csv --mapping config/import/utfsm_mr.yaml --out recordings"
    )
    option_rules = (
        never_with(ALL, "template", "does not apply with --template", but="template"),
        never_with("json overwrite signals", "propose", "does not apply with --propose, which prints a mapping"),
    )

    files: tuple[Path, ...] = argument((), LOGS, metavar="FILE", count="*")
    mapping: Path | None = option(None, MAPPING, none="found, and said", metavar="MAP.yaml")
    out: Path | None = option(None, "bag to write, or folder for several", metavar="BAG")
    propose: bool = option(False, "print a mapping for FILE with reasons, and exit")
    rate: float | None = option(None, "rate of a log without a time column (no --mapping)", 1e-3, 1e6, metavar="HZ")
    dbc: tuple[Path, ...] = option((), "database of a CAN log (no --mapping)", metavar="FILE")
    template: bool = option(False, "print a commented mapping file and exit")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError; writes no bag unless all files can be read."""
    parser = terminal.parser(ImportRequest)
    request = parser.read(argv)
    if request.template:
        print(schema_line("import") + TEMPLATE, end="")
        return 0
    for path in request.files:
        refuse_bag(path)
    if request.propose and len(request.files) == 1 and request.out is None and request.mapping is None:
        _propose(request.files[0], request)
        return 0
    if request.propose:
        parser.error("--propose takes one FILE and prints its mapping: ces import FILE --propose > my.yaml")
    if not request.files or request.out is None:
        parser.error("expected FILE and --out BAG, or FILE and --propose (writes a mapping), or --template")
    if request.mapping and (named := [path for path in request.files if split_damper(path)[1]]):
        parser.error(f"with --mapping, which names the columns of a damper, expected {split_damper(named[0])[0]}")
    if request.mapping is not None and (request.rate or request.dbc):
        parser.error(f"with --mapping, give 'rate' and 'dbc' in {request.mapping}")
    with without_text(request.json):
        bags = _import(request, request.out)
    if request.json:
        print_document("import", {"bags": [log.as_json() for log in bags]})
    return 0


def _propose(path: Path, request: ImportRequest) -> None:
    """Print the proposal for one log; what it says is explained on the error stream."""
    with FileProgress("reading", path) as bar:
        proposal = _find_mapping(path, request, bar)
    print(schema_line("import") + proposal.text, end="")
    print_proposal(proposal.selection, terminal.err)
    for doubt in proposal.doubts:
        if doubt.startswith("time:"):
            terminal.print_line(f"check: {doubt}", "yellow", terminal.err)
    for note in proposal.log.notes:
        terminal.print_line(f"{path}: {note}", console=terminal.err)


def _find_mapping(path: Path, request: ImportRequest, bar: FileProgress) -> MappingProposal:
    return propose_mapping(path, rate=request.rate, dbc=request.dbc, progress=bar.listen)


@dataclass(frozen=True)
class _ImportedLog:
    """What became of a log; `written` are the signals that its bag has."""

    bag: Path
    source: str
    samples: int
    rate_Hz: float
    channels: tuple[str, ...]
    written: tuple[str, ...]
    findings: tuple[Finding, ...]

    def as_json(self) -> dict[str, object]:
        """Return the facts for --json."""
        facts = {"file": self.source, "bag": self.bag, "samples": self.samples, "rate_Hz": self.rate_Hz}
        return {**facts, "channels": self.channels, "findings": self.findings}


def _import(request: ImportRequest, out: Path) -> list[_ImportedLog]:
    """Import all files; their bags get their names when all are written. Raises CesError."""
    mapping = load_dyno_mapping(request.mapping) if request.mapping else None
    signals = load_signals(request.signals)
    for signal in signals.list_topic_signals():
        if (signal.scale, signal.offset) != (1.0, 0.0):
            raise SignalsError(
                f"{request.signals}: {signal.name} has scale {signal.scale:g} and offset {signal.offset:g}; an "
                "imported bag is in SI units: give the log's scale in "
                f"{request.mapping or 'the mapping (--mapping)'}, and none here"
            )
    stems = ["_".join(filter(None, (path.stem, damper))) for path, damper in map(split_damper, request.files)]
    stem, count = Counter(stems).most_common(1)[0]
    several = len(request.files) > 1
    if count > 1:
        raise RecordingError(f"{count} files are named '{stem}' and would give the same bag; import them one by one")
    bags = [out / stem if several else out for stem in stems]
    for bag in bags:
        inputs = [*(split_damper(path)[0] for path in request.files), request.mapping, request.signals]
        require_outputs(request.overwrite, bags={OUT: bag}, inputs=inputs)
    with ExitStack() as opened:
        if several and not out.exists():
            opened.callback(_remove_if_empty, out)
        pairs = zip(request.files, bags, strict=True)
        imported = [_convert(path, bag, mapping, signals, request, opened) for path, bag in pairs]
    for log in imported:
        print(f"{log.bag}: {log.samples} samples of {', '.join(log.written)} at {log.rate_Hz:.1f} Hz")
    return imported


def _remove_if_empty(folder: Path) -> None:
    with suppress(OSError):
        folder.rmdir()


def _convert(
    path: Path, bag: Path, mapping: DynoMapping | None, signals: Signals, request: ImportRequest, opened: ExitStack
) -> _ImportedLog:
    """Write a log into a bag, block by block, with the mapping or one that is found; what is wrong is printed."""
    checks, writer, proposal = BlockChecks(), None, None
    with FileProgress("importing", path) as bar:
        if mapping is None:
            proposal = _find_mapping(path, request, bar)
            log, blocks = proposal.log, proposal.blocks()
        else:
            log = open_log(path, mapping, bar.listen)
            blocks = read_blocks(log, mapping)
        beside = velocity_beside(signals["position"]) if "speed" not in signals.by_name else None
        for block in blocks:
            if writer is None:  # the log can be read
                notes, compared = (
                    {"imported_from": Path(block.source).name},
                    compare_derivative(block, "speed") or "speed",
                )
                if beside is not None and "speed" in block.channels:
                    signals = replace(signals, by_name={**signals.by_name, "speed": beside})
                    notes[SPEED] = MEASURED if "speed" in block.optional else ALONE
                writer = opened.enter_context(open_bag_writer(bag, overwrite=request.overwrite, notes=notes))
            writer.write(recording_topics(align_speed(block), signals.without_delays()))
            checks.add(block)
            bar.rows = checks.samples
            source, channels = block.source, tuple(block.channels)
        faults = checks.finish()
    found = proposal.found if proposal else ()
    if mapping is not None and isinstance(log, LogTable):
        found = (describe_time(log, mapping.time, mapping.rate),)
    if remarks := [*log.notes, *found]:
        print(f"{path}: {', '.join(remarks)}")
    if "speed" in channels:
        use = "a model uses it if told to (--speed measured), and then needs it on the vehicle"
        print(f"{path}: {f'{compared}; {use}' if 'speed' in block.optional else INTEGRATED}")
    if checks.blocks > 1:
        parts = f"the first {MAX_ROWS} rows and {SHARE:.0%} of the others"
        print(f"{path}: checked for faults; for signs, units and delays in {parts}")
    for remark in proposal.remarks if proposal else ():
        terminal.print_warning(f"{path}: {remark}")
    for finding in faults:  # the remedy is in the mapping; a delay stays in the signals file that later programs read
        corrected = finding.text.replace("the signals file", str(request.mapping or "a mapping (--propose writes one)"))
        terminal.print_warning(f"{source}: {finding.text if isinstance(finding, DelayFinding) else corrected}")
    written = tuple(name for name in channels if isinstance(signals.by_name.get(name), Signal))
    for name in set(channels) - set(written):
        terminal.print_warning(f"{source}: {name} is left out; give it a topic in the signals file")
    return _ImportedLog(bag, source, checks.samples, checks.rate_Hz, channels, written, faults)


SHARE = 0.1  # of a block of a long log but the first, in which signs, units and delays are checked; faults in all of it
NUMBER = re.compile(r"[-+]?\d[\d.e+-]*")


class BlockChecks:
    """Takes the blocks of a recording; says how many samples of the position it has, and what is wrong."""

    def __init__(self) -> None:
        self.samples, self.blocks = 0, 0
        self._steps, self._span_s = 0, 0.0  # intervals without pauses, and how long they are
        self._ends_ns: tuple[int, ...] = ()
        self._found: list[tuple[Finding, str]] = []
        self._last: Recording | None = None

    @property
    def rate_Hz(self) -> float:
        """The mean rate of the position samples between pauses, 0 if they have no span."""
        return self._steps / self._span_s if self._span_s else 0.0

    def add(self, block: Recording) -> None:
        """Take a block and check the one before; a short last one is checked together with it."""
        stamps = block.channel("position").stamps_ns
        if len(stamps):
            ends = (*self._ends_ns, int(stamps.min()), int(stamps.max()))
            self._ends_ns = min(ends), max(ends)
        if rate := rate_between_pauses(stamps):
            self._steps, self._span_s = self._steps + len(stamps), self._span_s + len(stamps) / rate
        self.samples += len(stamps)
        if self._last is not None and 2 * len(stamps) < len(self._last.channel("position")):
            self._last = Recording.join([self._last, block])
            return
        if self._last is not None:
            self._check(self._last)
        self._last = block

    def finish(self) -> tuple[Finding, ...]:
        """Return the findings, the worst first; of a long log each once, with the number of parts that show it."""
        if self._last is not None:
            self._check(self._last, last=True)
        if self.blocks == 1:
            return tuple(finding for finding, _ in self._found)
        same: dict[tuple[str, ...], list[tuple[Finding, str]]] = {}
        for one, when in self._found:
            same.setdefault((one.severity, one.signal, NUMBER.sub("", one.text)), []).append((one, when))
        merged = []
        for (finding, when), *more in same.values():
            parts = f"in {1 + len(more)} of {self.blocks} parts of the log"
            text = f"{finding.text} ({parts}; the numbers are of that {when}, with times from its start)"
            merged.append(replace(finding, text=text))
        return sort_findings(merged)

    def _check(self, block: Recording, last: bool = False) -> None:
        if self.blocks or not last:  # a slow channel may have no sample in it
            block = replace(block, channels={name: c for name, c in block.channels.items() if len(c)})
        faults, is_first = list(findings(block)), self.blocks == 0
        if is_first or "position" in block.channels:
            faults += check_recording(block if is_first else block.share(0.0, SHARE))
        stamps = [int(c.stamps_ns[at]) for c in block.channels.values() if len(c) for at in (0, -1)]
        ends = [(f(stamps, default=0) - min(self._ends_ns, default=0)) / SECOND for f in (min, max)]
        self._found += [(finding, f"from {ends[0]:.3f} s to {ends[1]:.3f} s") for finding in faults]
        self.blocks += 1
