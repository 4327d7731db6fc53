"""Planted faults: one for each kind of defect that the tests have caught; each must still be caught.

    python -m bench.planted_faults              # all; some ten minutes of processor time
    python -m bench.planted_faults NAME...      # some
    python -m bench.planted_faults --check      # only look for the snippets: at once, for use while code is moved
    python -m bench.planted_faults --clean      # the same tests without a fault: all must pass

faults.yaml has the table. A fault replaces the snippet `find` by `put` in the file `in`; if the snippet is no longer
there, it is looked for in all packages, where it must occur exactly once. The tests named in `tests` (in test/) then
run on a copy of the tree, and one must fail. Exit status 1 if a fault is not caught or its snippet is not found.
After a refactoring, correct `in`, `find` and `put` so that the same defect is planted.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
TABLE = Path(__file__).with_name("faults.yaml")
LEFT_OUT = (".git", ".venv*", "out", "docs", "*.egg-info", ".mypy_cache", ".ruff_cache", ".pytest_cache")
TESTS_FAILED, TESTS_PASSED = 1, 0  # exit statuses of pytest; any other is a mistake in the table


class FaultError(Exception):
    """A fault that cannot be planted."""


@dataclass(frozen=True)
class PlantedFault:
    """A row of the table."""

    name: str
    file: str
    find: str
    put: str
    tests: tuple[str, ...]
    why: str

    def locate(self, tree: Path) -> Path:
        """Return the file that holds the snippet exactly once; raises FaultError."""
        named = tree / self.file
        if named.is_file() and named.read_text(encoding="utf-8").count(self.find) == 1:
            return named
        counts = {path: path.read_text(encoding="utf-8").count(self.find) for path in tree.glob("ces_*/**/*.py")}
        found = [path for path, count in counts.items() if count]
        if len(found) != 1 or counts[found[0]] != 1:
            raise FaultError(f"snippet found {sum(counts.values())} times; expected once")
        return found[0]

    def missing_tests(self, tree: Path) -> list[str]:
        return [test for test in self.tests if not (tree / "test" / test.partition("::")[0]).exists()]


def load_faults(names: list[str]) -> list[PlantedFault]:
    rows = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    faults = [
        PlantedFault(name, row["in"], row["find"], row["put"], tuple(row["tests"].split()), row["why"])
        for name, row in rows.items()
        if not names or name in names
    ]
    if unknown := set(names) - rows.keys():
        sys.exit(f"unknown fault {sorted(unknown)[0]}; known are {', '.join(rows)}")
    return faults


def copy_tree(to: Path) -> None:
    """Copy the tree with hard links where possible; times stay, so that compiled code is used again."""
    shutil.copytree(ROOT, to, ignore=shutil.ignore_patterns(*LEFT_OUT), copy_function=_link, dirs_exist_ok=True)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # another file system
        shutil.copy2(source, target)


def run_tests(tree: Path, tests: tuple[str, ...]) -> int:
    """Return pytest's exit status of the tests on the tree."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *(f"test/{one}" for one in tests)]
    env = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(words, cwd=tree, env=env, capture_output=True, check=False).returncode


def plant(fault: PlantedFault, tree: Path) -> str:
    """Plant the fault, run its tests and take it out; return what happened."""
    path = fault.locate(tree)
    kept = path.with_suffix(".kept")
    path.rename(kept)  # the file itself may be a link to the original
    try:
        text = kept.read_text(encoding="utf-8").replace(fault.find, fault.put)
        path.write_text(text, encoding="utf-8")
        status = run_tests(tree, fault.tests)
    finally:
        kept.replace(path)
    return {TESTS_FAILED: "caught", TESTS_PASSED: "NOT CAUGHT"}.get(status, f"PYTEST ENDED WITH {status}")


def check(fault: PlantedFault) -> str:
    """Return whether the fault can be planted."""
    try:
        path = fault.locate(ROOT).relative_to(ROOT)
    except FaultError as error:
        return str(error).upper()
    if missing := fault.missing_tests(ROOT):
        return f"NO TEST {missing[0]}"
    return "found" if str(path) == fault.file else f"found in {path}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--check", action="store_true", help="only look for the snippets and the tests")
    parser.add_argument("--clean", action="store_true", help="run the tests without a fault")
    options = parser.parse_args()
    faults, bad = load_faults(options.names), 0
    with tempfile.TemporaryDirectory(prefix="faults_", dir=ROOT.parent) as folder:
        tree = Path(folder)
        if not options.check:
            copy_tree(tree)
        if options.clean:
            status = run_tests(tree, tuple(dict.fromkeys(test for fault in faults for test in fault.tests)))
            print("all tests pass without a fault" if status == TESTS_PASSED else f"pytest ended with {status}")
            return int(status != TESTS_PASSED)
        for fault in faults:
            began, outcome = time.monotonic(), check(fault)
            if not options.check and outcome.startswith("found"):
                outcome = plant(fault, tree)
            bad += not outcome.startswith(("found", "caught"))
            print(f"{fault.name:34} {outcome:12} {time.monotonic() - began:5.1f} s  {fault.why}", flush=True)
    print(f"{len(faults)} faults, {bad} not {'found' if options.check else 'caught'}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
