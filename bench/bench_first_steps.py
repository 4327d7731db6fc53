"""Wall time and longest silence of what a new user runs first, on a quiet machine and beside four busy processes.

Each step runs as the user runs it, in a process of its own whose output is a pipe. Kernels are compiled before; the row
`import ces` is a new Python. Beside busy processes a step has a share of the cores: of two, a third or less.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from bench.markdown import markdown

ROOT = Path(__file__).resolve().parents[1]
BUSY = 4  # processes
CES = "import sys; from ces_cli.main import main; sys.exit(main())"
FITTED = "bags/noise bags/sweep --validate bags/sine_4hz bags/road --overwrite --out {out}/model.json"
STEPS: Mapping[str, str] = {  # name: words after `ces`, or a Python statement
    "import ces": "",
    "info": "info bags/road",
    "characterise": "characterise bags/sine_4hz --overwrite --out {out}/characterised",
    "identify": f"identify {FITTED} --report {{out}}/report.html",
    "identify --structure auto": f"identify {FITTED} --structure auto --report {{out}}/report.html",
    "identify --time 15": f"identify {FITTED} --time 15",
    "validate": "validate config/models/sample.json bags/road",
    "compare": "compare config/models/sample.json {out}/model.json bags/road --overwrite --report {out}/compared.html",
    "diagnose": "diagnose --sim config/models/sample.json --real bags/road --overwrite --out {out}/gap",
}


class Run(NamedTuple):
    """A step that ended: its wall time and its longest silence [s]."""

    seconds: float
    silence_s: float


def run(words: str, out: str) -> Run:
    """Run a step to its end; raises CalledProcessError if it fails."""
    given = words.format(out=out).split()
    command = [sys.executable, "-c", CES, *given] if given else [sys.executable, "-c", "import ces"]
    clean = {name: text for name, text in os.environ.items() if not name.endswith("_NUM_THREADS")}
    began = last = time.perf_counter()
    silence = 0.0
    with subprocess.Popen(command, cwd=ROOT, env=clean, stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as process:
        assert process.stdout is not None
        while process.stdout.read1():
            last, before = time.perf_counter(), last
            silence = max(silence, last - before)
    ended = time.perf_counter()
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return Run(ended - began, max(silence, ended - last))


@contextmanager
def busy(processes: int) -> Iterator[None]:
    """Keep so many processes busy."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(processes)]
    try:
        yield
    finally:
        for process in spinning:
            process.kill()
            process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", nargs="+", choices=STEPS, default=list(STEPS), help="default: all")
    steps: Sequence[str] = parser.parse_args().steps
    rows = [["step", "quiet s", "longest silence s", f"beside {BUSY} busy s", "longest silence s"]]
    with tempfile.TemporaryDirectory() as out:
        for step in steps:
            runs = [run(STEPS[step], out)]
            with busy(BUSY):
                runs.append(run(STEPS[step], out))
            rows.append([step, *(f"{figure:.1f}" for figures in runs for figure in figures)])
            print(*rows[-1], sep="  ", flush=True)
    print(markdown(rows))


if __name__ == "__main__":
    main()
