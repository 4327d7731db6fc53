"""Time per step of the exported C estimator, called in a C loop, and of the Python estimator on the same samples.

Usage: python bench/bench_export.py. Needs a C compiler (`cc`, or what CC names). Steady stamps let the C keep the
differentiator's gains from step to step; jittered ones make it compute an exponential and a cosine each time.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from bench_free_run import median_seconds, ten_terms
from numpy.typing import NDArray

from ces_identify.export.export_c import export_c
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, Sampling
from ces_observer.structures.polynomial import Polynomial

N = 30_000
TARGET_US = 0.1
LOOP = """
#include "damper.h"
double steps(int64_t n, const int64_t *stamps, const double *positions, const double *currents)
{
    damper_state state;
    double force, total = 0.0;
    damper_reset(&state);
    for (int64_t i = 0; i < n; i++) {
        if (damper_step(&state, stamps[i], positions[i], currents[i], &force) == DAMPER_OK) {
            total += force;
        }
    }
    return total;
}
double ticks(int64_t n, const double *positions, const double *speeds, const double *currents)
{
    damper_past past;
    double force, total = 0.0;
    damper_past_reset(&past);
    for (int64_t i = 0; i < n; i++) {
        if (damper_tick(&past, positions[i], speeds[i], currents[i], &force) == DAMPER_OK) {
            total += force;
        }
    }
    return total;
}
"""


@dataclass(frozen=True)
class StepInputs:
    """Stamps [ns], positions [m], speeds [m/s] and currents [A], each (N,)."""

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    speed: NDArray[np.float64]
    current: NDArray[np.float64]


def make_inputs(jitter_ns: float) -> StepInputs:
    dice = np.random.default_rng(1)
    stamps = (np.arange(N) * 1_000_000 + dice.uniform(-jitter_ns, jitter_ns, N)).astype(np.int64)
    t = stamps * 1e-9
    return StepInputs(stamps, 0.02 * np.sin(25 * t), 0.5 * np.cos(25 * t), 0.5 + 0.1 * np.sin(3 * t))


def compile_estimator(model: Model, compiler: str, folder: Path) -> ctypes.CDLL:
    """Export `model`, compile it separately from the loop (no inlining across), and load both."""
    source, header = export_c(model, "damper", "damper", model.certify())
    for name, text in (("damper.c", source), ("damper.h", header), ("loop.c", LOOP)):
        (folder / name).write_text(text)
    flags = ["-std=c99", "-O2", "-fPIC", "-shared", "-o", "damper.so", "damper.c", "loop.c", "-lm"]
    subprocess.run([compiler, *flags], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "damper.so"))
    library.steps.restype = library.ticks.restype = ctypes.c_double
    return library


def bind_arrays(function: Callable[..., float], *arrays: NDArray[np.generic]) -> Callable[[], float]:
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
    return lambda: function(ctypes.c_int64(N), *pointers)


def python_steps(model: Model, inputs: StepInputs) -> Callable[[], float]:
    rows = list(zip(inputs.stamps.tolist(), inputs.position.tolist(), inputs.current.tolist(), strict=True))
    estimator = Estimator(model)

    def run() -> float:
        estimator.reset()
        step = estimator.step
        return sum(force for row in rows if (force := step(*row)) is not None)

    return run


def compare(what: str, c: Callable[[], float], python: Callable[[], float]) -> None:
    """Print the mean times per step after checking that both give the same forces."""
    np.testing.assert_allclose(c(), python(), rtol=1e-9)
    fast, slow = 1e6 * median_seconds(c, 41) / N, 1e6 * median_seconds(python, 7) / N
    verdict = "met" if fast <= TARGET_US else "missed"
    print(f"  step, {what:<16} C {fast:7.4f} us   Python {slow:6.2f} us   ratio {slow / fast:4.0f}   {verdict}")


def main() -> int:
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        print("no C compiler: nothing to measure; install one or set CC")
        return 0
    terms, envelope = ten_terms(), Envelope((-1.0, 1.0), (-2.0, 2.0), (0.0, 1.0))
    print(f"exported C, {len(terms)} terms, {N} samples, -O2; target at most {TARGET_US} us a step")
    for order in (2, 3):
        model = Model(Sampling(1000.0, 100.0, 0.01, order=order), Polynomial(terms), envelope, (-1e6, 1e6))
        with tempfile.TemporaryDirectory() as folder:
            library = compile_estimator(model, compiler, Path(folder))
            print(f"differentiator of order {order}")
            for what, jitter_ns in (("steady stamps", 0.0), ("jittered stamps", 2e5)):
                inputs = make_inputs(jitter_ns)
                c = bind_arrays(library.steps, inputs.stamps, inputs.position, inputs.current)
                compare(what, c, python_steps(model, inputs))
            tick = median_seconds(bind_arrays(library.ticks, inputs.position, inputs.speed, inputs.current), 41) / N
            print(f"  tick of the bare polynomial  {1e6 * tick:7.4f} us")
    return 0


if __name__ == "__main__":
    sys.exit(main())
