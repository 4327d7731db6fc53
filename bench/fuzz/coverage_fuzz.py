"""Coverage-guided fuzzing of the readers by libFuzzer through Atheris (pip install -e .[fuzz]; Python 3.11 to 3.13).

    python -m bench.fuzz.coverage_fuzz model -runs=100000
    python -m bench.fuzz.coverage_fuzz signals -runs=100000

The arguments after the first are libFuzzer's. Inputs that reach new code are kept in out/fuzz/corpus. An input that
breaks a promise of fuzz_targets.py ends the run and is saved in the working directory as crash-..., a file that takes
longer than 10 s as timeout-....
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from random import Random
from tempfile import mkdtemp

import atheris

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent

with atheris.instrument_imports(include=["ces_observer", "ces_identify", "yaml"]):
    from bench.fuzz.fuzz_targets import try_model, try_signals

from bench.fuzz.fuzz_samples import spoil_model  # noqa: E402

TARGETS = {"model": try_model, "signals": try_signals}
LIMITS = ("-timeout=10", "-rss_limit_mb=1024", "-max_len=20000", "-print_final_stats=1")
STRUCTURED = 0.5  # share of model files changed by their structure, the others by libFuzzer's own rules


def feed_target(target: Callable[[Path], str]) -> Callable[[bytes], None]:
    """Return a function that passes bytes to `target` as a file."""
    path = Path(mkdtemp(dir="/dev/shm" if os.access("/dev/shm", os.W_OK) else None)) / "input"

    def one(raw: bytes) -> None:
        path.write_bytes(raw)
        target(path)

    return one


def mutate(raw: bytes, longest: int, seed: int) -> bytes:
    """Change a model file by its structure, or leave it to libFuzzer."""
    random = Random(seed)
    if random.random() < STRUCTURED:
        return spoil_model(raw, random)[:longest]
    return bytes(atheris.Mutate(raw, longest))


def main() -> None:
    name, *rest = sys.argv[1:]
    corpus = ROOT / "out" / "fuzz" / "corpus" / name
    corpus.mkdir(parents=True, exist_ok=True)
    folders = [str(corpus), str(HERE / "seeds" / name)]
    options = {"custom_mutator": mutate} if name == "model" else {}
    atheris.Setup(
        [sys.argv[0], *LIMITS, f"-dict={HERE / name}.dict", *rest, *folders], feed_target(TARGETS[name]), **options
    )
    atheris.Fuzz()


if __name__ == "__main__":
    main()
