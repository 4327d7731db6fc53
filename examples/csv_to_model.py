"""From raw logs to a verdict: import, identify, test on what the fit has not seen, report.

    python examples/csv_to_model.py LOG... --out FOLDER [--validate LOG...] [--mapping MAP.yaml] [IDENTIFY OPTIONS]

FOLDER gets `recordings/`, `model.json` and `report.html`. Without a mapping, the columns are found, or refused.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from ces_cli.main import main as ces


def main(words: Sequence[str]) -> int:
    """Return the exit status: 2 after a line that says what is wrong."""
    how = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=how, allow_abbrev=False)
    parser.add_argument("logs", nargs="+", metavar="LOG", type=Path)
    parser.add_argument("--validate", nargs="+", metavar="LOG", type=Path, default=[])
    parser.add_argument("--mapping")
    parser.add_argument("--out", metavar="FOLDER", type=Path, required=True)
    parser.add_argument("--overwrite", action="store_true")
    options, more = parser.parse_known_args(words)
    overwrite = ["--overwrite"] if options.overwrite else []
    bags = options.out / "recordings"
    mapping = ["--mapping", options.mapping] if options.mapping else []
    for log in (*options.logs, *options.validate):
        if status := ces(["import", str(log), *mapping, "--out", str(bags / log.stem), *overwrite]):
            return status
    learned, held_out = ([str(bags / log.stem) for log in logs] for logs in (options.logs, options.validate))
    more += ["--validate", *held_out] if held_out else []
    files = ["--out", str(options.out / "model.json"), "--report", str(options.out / "report.html")]
    return ces(["identify", *learned, *more, *files, *overwrite])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
