"""`ces import`: converts dyno logs (CSV, JSON, MAT) to bags that all other programs read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ces_cli.terminal import terminal
from ces_identify.recordings.bag_writer import recording_topics, write_bag
from ces_identify.recordings.checks import findings, mean_rate
from ces_identify.recordings.log_import import import_log
from ces_identify.recordings.log_mapping import TEMPLATE, load_dyno_mapping
from ces_identify.recordings.recording import Recording
from ces_identify.sense.sense import sense
from ces_observer.errors import RecordingError
from ces_observer.signals import Signal, Signals


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status. Raises CesError; writes no bag unless all files can be read."""
    parser = make_parser()
    options = parser.parse_args(argv)
    if options.template:
        print(TEMPLATE, end="")
        return 0
    if not options.files or options.mapping is None or options.out is None:
        parser.error("expected FILE, --mapping and --out (or --template)")
    mapping = load_dyno_mapping(options.mapping)
    signals = terminal.load_described_signals(options)
    paths = _bag_paths(options.files, options.out)
    with terminal.err.status("reading"):
        recordings = [import_log(path, mapping) for path in options.files]
    for recording, path in zip(recordings, paths, strict=True):
        _write(recording, path, signals, options.overwrite)
    return 0


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    parser = terminal.parser(
        "import",
        "Convert dyno logs to bags. The mapping file says which columns hold time, position, current and force, and "
        "how to scale them to s, m, A and N. One FILE becomes the bag --out; several FILEs become one bag each in the "
        "folder --out.",
        "ces import sweep_*.csv --mapping config/import/utfsm_mr.yaml --out recordings\n"
        "  ces import --template > my_dyno.yaml",
    )
    parser.add_argument("files", type=Path, nargs="*", metavar="FILE", help="log: .csv .txt .dat .tsv, .json or .mat")
    parser.add_argument("--mapping", type=Path, metavar="MAP.yaml", help="mapping of columns to signals")
    parser.add_argument("--out", type=Path, metavar="BAG", help="bag to write, or folder for several")
    terminal.add_signals(parser)
    parser.add_argument("--overwrite", action="store_true", help="replace existing bags (default: refuse)")
    parser.add_argument("--template", action="store_true", help="print a commented mapping file and exit")
    return parser


def _bag_paths(files: Sequence[Path], out: Path) -> list[Path]:
    """Return the bag to write for each file; raises RecordingError if two would have the same path."""
    if len(files) == 1:
        return [out]
    stem, count = Counter(path.stem for path in files).most_common(1)[0]
    if count > 1:
        raise RecordingError(f"{count} files are named '{stem}' and would give the same bag; import them one by one")
    return [out / path.stem for path in files]


def _write(recording: Recording, path: Path, signals: Signals, overwrite: bool) -> None:
    for finding in (*findings(recording), *sense(recording)):
        terminal.print_warning(f"{recording.source}: {_for_mapping(finding.text)}")
    written = [name for name in recording.channels if isinstance(signals.by_name.get(name), Signal)]
    for name in recording.channels.keys() - set(written):
        terminal.print_warning(f"{recording.source}: {name} is left out; give it a topic in the signals file")
    notes = {"imported_from": Path(recording.source).name}
    write_bag(path, recording_topics(recording, signals.without_delays()), overwrite=overwrite, notes=notes)
    position = recording.channel("position")
    rate = mean_rate(position)
    print(f"{path}: {len(position)} samples of {', '.join(written)} at {rate:.1f} Hz")


def _for_mapping(text: str) -> str:
    """Return a finding with its remedy in the mapping; a delay stays in the signals file, which later programs read."""
    return text if "key delay" in text else text.replace("the signals file", "the mapping")
