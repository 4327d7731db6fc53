"""Time per step of the exported C estimator, called in a C loop, and of the Python estimator on the same samples.

Usage: python bench/bench_export.py. Needs a C compiler (`cc`, or what CC names). A step is the bank of the speed, the
tracker and a tick of the model, and with a delay also the smoothing. Ticks alone, in C and at the desk, are also timed
on inputs that jump between the ends of their ranges: structures that solve an equation at each tick then need most
steps.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measurement import median_seconds, processor
from numpy.typing import NDArray

from ces_identify.export.export_model import export_c
from ces_observer.estimator import Estimator
from ces_observer.model import Envelope, Model, Sampling, load_model
from ces_observer.structures.polynomial import Factor, Polynomial, Term

N = 30_000
FITTED = Path(__file__).resolve().parent / "fuzz" / "seeds" / "model"
PHYSICAL = ("hydraulic", "hydraulic_bypass")
TARGET_US = {"polynomial_narx": 0.2, "hydraulic": 0.28}  # of a step without a delay
DELAY_S = 0.003
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


def make_jumps(envelope: Envelope) -> StepInputs:
    """Return inputs that jump between the ends of their ranges, on average every third tick."""
    dice = np.random.default_rng(2)
    columns = []
    for ends in envelope.by_signal.values():
        new = np.where(dice.random(N) < 1 / 3, np.arange(N), 0)
        columns.append(dice.choice(ends, N)[np.maximum.accumulate(new)])
    return StepInputs(np.arange(N, dtype=np.int64), *columns)


def compile_estimator(model: Model, compiler: str, folder: Path) -> ctypes.CDLL:
    """Export `model`, compile it separately from the loop (no inlining across), and load both."""
    for name, text in {**export_c(model, "damper", "damper", model.certify()), "loop.c": LOOP}.items():
        (folder / name).write_text(text)
    flags = ["-std=c99", "-O2", "-fPIC", "-shared", "-o", "damper.so", "damper.c", "ces_core.c", "loop.c", "-lm"]
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


def compare_steps(model: Model, library: ctypes.CDLL) -> None:
    """Print the mean times per step after checking that C and Python give the same forces."""
    for what, jitter_ns in (("steady stamps", 0.0), ("jittered stamps", 2e5)):
        inputs = make_inputs(jitter_ns)
        c = bind_arrays(library.steps, inputs.stamps, inputs.position, inputs.current)
        python = python_steps(model, inputs)
        assert c() == python(), "C and Python give other forces"
        fast, slow = 1e6 * median_seconds(c, 41) / N, 1e6 * median_seconds(python, 7) / N
        verdict = "met" if fast <= TARGET_US[model.structure] else "missed"
        print(f"  step, {what:<16} C {fast:7.4f} us   Python {slow:6.2f} us   ratio {slow / fast:4.0f}   {verdict}")


def print_ticks(model: Model, library: ctypes.CDLL) -> None:
    """Print the mean times of ticks alone."""
    for what, inputs in (("sines", make_inputs(0.0)), ("jumps", make_jumps(model.envelope))):
        ticks = bind_arrays(library.ticks, inputs.position, inputs.speed, inputs.current)
        desk = 1e6 * median_seconds(desk_ticks(model, inputs), 7) / N
        print(f"  tick alone, {what:<10} C {1e6 * median_seconds(ticks, 41) / N:7.4f} us   desk {desk:6.2f} us")


def desk_ticks(model: Model, inputs: StepInputs) -> Callable[[], None]:
    """Return a run of the tick that the desk calls sample by sample."""
    rows = list(zip(*(column.tolist() for column in (inputs.position, inputs.speed, inputs.current)), strict=True))
    tick = model.make_predictor().tick

    def run() -> None:
        for row in rows:
            tick(*row)

    return run


def ten_terms() -> tuple[Term, ...]:
    """Return ten terms like those of a selection: past forces, non-integer powers, current, several lags."""
    v = [
        Factor("speed", lag, power, signed) for lag, power, signed in ((0, 0.5, True), (2, 1.0, True), (0, 0.5, False))
    ]
    i, i2 = Factor("current", 5, 1.0, False), Factor("current", 10, 2.0, False)
    y1, y2 = Factor("force", 1), Factor("force", 2)
    rows = [(1200.0, (v[0],)), (700.0, (v[1], i)), (100.0, (v[2], i2)), (30.0, (Factor("speed", 0, 1.5),)), (-5.0, ())]
    rows += [(0.3, (y1,)), (0.1, (y1, v[2])), (0.05, (y2, i)), (0.02, (y2, v[1])), (-0.02, (y1, v[1], i))]
    return tuple(Term(c, factors) for c, factors in rows)


def make_models() -> dict[str, Model]:
    """Return models without a delay, and the first also with one."""
    terms, envelope = ten_terms(), Envelope((-1.0, 1.0), (-2.0, 2.0), (0.0, 1.0))
    sampling = Sampling(1000.0, 1e-5, 0.35, (-0.1, 0.1), 0.01)
    polynomial = Model(sampling, Polynomial(terms), envelope, (-1e6, 1e6))
    late = replace(polynomial, sampling=replace(sampling, delay_s=DELAY_S))
    physical = [load_model(FITTED / f"{name}.json") for name in PHYSICAL]
    return {
        f"polynomial, {len(terms)} terms": polynomial,
        f"the same {DELAY_S:g} s late": late,
        **{f"{one.structure}, {one.size}": one for one in physical},
    }


def main() -> int:
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        print("no C compiler: nothing to measure; install one or set CC")
        return 0
    targets = ", ".join(f"{target} us ({structure})" for structure, target in TARGET_US.items())
    print(f"exported C, {N} samples, -O2; target at most {targets} a step")
    for what, model in make_models().items():
        with tempfile.TemporaryDirectory() as folder:
            library = compile_estimator(model, compiler, Path(folder))
            print(what)
            compare_steps(model, library)
            print_ticks(model, library)
    version = subprocess.run([compiler, "--version"], check=True, capture_output=True, text=True).stdout
    print(f"{processor()}; {version.splitlines()[0]}; load {os.getloadavg()[0]:.1f} at the end")
    return 0


if __name__ == "__main__":
    sys.exit(main())
