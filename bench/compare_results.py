"""Shows that two versions of the project compute the same: runs commands with both and compares what they write.

Usage: python bench/compare_results.py [--before REVISION|TREE | --before-results DIR] [--after TREE] [--only CASE ...]

--before is a revision of this repository (default HEAD) or a folder with a source tree, --after such a folder (default:
this working tree). With --results DIR the results are kept: DIR/before can be the --before-results of later runs. Exit
status 1 if a number or a name differs or a command fails; different wording is listed, but allowed.

compare_cases.py has the cases; all of them take some five minutes of one core for each tree. Exported C is compared as
text, and by the forces of the FMU that holds it.
"""

from __future__ import annotations

import argparse
import os
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from compare_cases import CASES, INPUTS, write_inputs
from compare_files import SUFFIXES, FileComparison, compare_files, without_provenance
from measurement import print_note, print_table, time_call

ROOT = Path(__file__).resolve().parent.parent
HEADER = ("file", "values compared", "values that differ", "largest relative difference", "texts that differ")
LEFT_OUT = frozenset(("seal.json", "results.md", "models"))  # hold or are named by salts and hashes
SHOWN = 8  # differences of a file
STARTUP = """\
import sys, time

# Modules that the tree lacks must not come from an editable install of another one.
sys.meta_path[:] = [f for f in sys.meta_path if not getattr(f, "__module__", "").startswith("__editable__")]


def slowed(clock):  # no search or choice ends by time however loaded the computer is; elapsed times print as 0
    return lambda: 1e-6 * clock()


time.monotonic, time.perf_counter = slowed(time.monotonic), slowed(time.perf_counter)
"""


@dataclass(frozen=True)
class Tree:
    """A source tree, and the folder for its results."""

    source: Path
    results: Path

    def run(self, cases: Sequence[str], inputs: Path | None) -> None:
        """Run cases on the inputs of another tree, or on its own; raises SystemExit if other code than its own runs."""
        for folder in ("startup", "numba", "inputs", *cases):
            shutil.rmtree(self.results / folder, ignore_errors=True)
        (self.results / "startup").mkdir(parents=True)
        (self.results / "startup" / "sitecustomize.py").write_text(STARTUP, encoding="utf-8")
        code = self._python(["-c", "import ces_cli; print(ces_cli.__file__)"], self.results).stdout.strip()
        if not Path(code).is_relative_to(self.source):
            sys.exit(f"{self.source}: runs the code in {code}")
        if inputs is not None:
            shutil.copytree(inputs, self.results / "inputs")
        for name in (*(["inputs"] if inputs is None else []), *cases):
            _, spent = time_call(lambda name=name: self._case(self.results / name))
            print_note(f"{self.results.name}: {name}: {spent.wall:.0f} s, {spent.cpu:.0f} s of one core")

    def _case(self, folder: Path) -> None:
        """Run the commands of a case; what each prints becomes a result file, too."""
        folder.mkdir()
        if folder.name == "inputs":
            write_inputs(self.source, folder)
        for number, command in enumerate(CASES.get(folder.name, INPUTS), start=1):
            ran = self._python(["-m", "ces_cli.main", *shlex.split(command)], folder)
            (folder / f"{number}_{command.split()[0]}.txt").write_text(ran.stdout, encoding="utf-8")
            if ran.returncode:
                sys.exit(f"{self.source}: ces {command}: status {ran.returncode}\n{ran.stderr[-2000:]}")

    def _python(self, words: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
        settings = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        settings |= {"NUMBA_CACHE_DIR": str(self.results / "numba"), "PYTHONDONTWRITEBYTECODE": "1"}
        settings |= {"PYTHONPATH": f"{self.results / 'startup'}{os.pathsep}{self.source}"}
        env = {**os.environ, **settings, "COLUMNS": "160", "NO_COLOR": "1"}
        return subprocess.run(
            [sys.executable, *words], cwd=folder, env=env, capture_output=True, text=True, check=False
        )


def find_source(given: str, folder: Path) -> Path:
    """Return a folder with a source tree; that of a revision is written to `folder`."""
    if Path(given).is_dir():
        return Path(given).resolve()
    archive = subprocess.run(["git", "-C", str(ROOT), "archive", given], capture_output=True, check=True).stdout
    with tarfile.open(fileobj=BytesIO(archive)) as files:
        files.extractall(folder, filter="data")
    return folder.resolve()


def compare_results(before: Path, after: Path, cases: Sequence[str]) -> dict[str, FileComparison]:
    """Return the comparison of every file that either tree wrote, by its name without hashes."""
    old, new = (_files(results, cases) for results in (before, after))
    return {
        name: compare_files(old.get(name, before / name), new.get(name, after / name)) for name in sorted(old | new)
    }


def _files(results: Path, cases: Sequence[str]) -> dict[str, Path]:
    found = (p for case in cases for p in (results / case).rglob("*.*") if p.suffix in SUFFIXES)
    kept = (p for p in found if LEFT_OUT.isdisjoint(p.relative_to(results).parts))
    return {without_provenance(str(p.relative_to(results))): p for p in kept}


def print_comparisons(comparisons: Mapping[str, FileComparison]) -> None:
    """Print the table, and below it what differs."""
    rows = [
        (name, f"{c.compared:,}", str(len(c.values)), f"{c.largest:.2g}", str(len(c.wording)))
        for name, c in comparisons.items()
    ]
    print_table(HEADER, rows)
    for name, c in comparisons.items():
        for place, before, after in c.values[:SHOWN]:
            print(f"{name}: {place}: {before!r} -> {after!r}")
        for old, new in c.wording[:SHOWN]:
            print(f"{name}: wording\n  before: {old[:400]}\n  after:  {new[:400]}")
    compared, differ = sum(c.compared for c in comparisons.values()), sum(len(c.values) for c in comparisons.values())
    print(f"{len(comparisons)} files, {compared:,} values, {differ:,} differ")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", default="HEAD", metavar="REVISION|TREE", help="default HEAD")
    parser.add_argument("--before-results", type=Path, metavar="DIR", help="results of an earlier run instead")
    parser.add_argument("--after", type=Path, default=ROOT, metavar="TREE", help="default: this working tree")
    parser.add_argument("--results", type=Path, metavar="DIR", help="keep the results here, in before and after")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="CASE", help=", ".join(CASES))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        results = (options.results or Path(temporary)).resolve()
        before, after = options.before_results or results / "before", results / "after"
        if options.before_results is None:
            Tree(find_source(options.before, Path(temporary) / "tree"), before).run(options.only, None)
        Tree(options.after.resolve(), after).run(options.only, before / "inputs")
        comparisons = compare_results(before, after, options.only)
    print_comparisons(comparisons)
    return int(any(c.values for c in comparisons.values()))


if __name__ == "__main__":
    sys.exit(main())
