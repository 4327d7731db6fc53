"""The forms of the estimator: source in CPython and in Numba, compiled extension, printed core, exported C, FMU.

Each takes a model and samples (stamps, positions, currents, motions) and gives `Steps`, which equal bit for bit.
"""

from __future__ import annotations

import ctypes
import inspect
import subprocess
from array import array
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import numpy as np
import tick_loop
from numpy.typing import NDArray

from ces_identify.export.c_printer import Core
from ces_identify.export.export_model import export_c, list_variables, sources
from ces_identify.numerics.core import compile_tick
from ces_observer import tick
from ces_observer.estimator import lay_out_estimator
from ces_observer.model import Model
from ces_observer.proof.certificate import Contraction

UNPROVED = Contraction(2.0, 1.0, 1, "", "")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
USER = """
#include "model.h"
#include <math.h>
#include <string.h>

#ifdef MOTION
#define STEP(i) model_step(&state, stamps[i], inputs[3 * i], inputs[3 * i + 1], inputs[3 * i + 2], &rows[5 * i])
#else
#define STEP(i) model_step(&state, stamps[i], inputs[3 * i], inputs[3 * i + 1], &rows[5 * i])
#endif
#ifdef BAND
#define WIDTH model_half_width(&state)
#else
#define WIDTH ((double)NAN)
#endif

int64_t run_samples(int64_t count, const int64_t *stamps, const double *inputs, double *rows, int64_t *reasons,
    int64_t *later_stamps, double *later)
{
    static model_state state;
    int64_t known = 0;
    (void)later_stamps;
    (void)later;
    memset(&state, 0x01, sizeof state); /* reset has to set everything */
    model_reset(&state);
    for (int64_t i = 0; i < count; i++) {
        reasons[i] = (int64_t)STEP(i);
        rows[5 * i + 1] = state.position_m;
        rows[5 * i + 2] = state.speed_m_s;
        rows[5 * i + 3] = WIDTH;
        rows[5 * i + 4] = state.clamped ? 1.0 : 0.0;
#ifdef MODEL_DELAY_TICKS
        for (uint32_t j = 0; j < state.late_count; j++) {
            const model_estimate *one = &state.late[j];
            const double row[4] = {one->position_m, one->speed_m_s, one->force_N, one->half_width_N};
            later_stamps[known] = one->stamp_ns;
            memcpy(&later[4 * known++], row, sizeof row);
        }
#endif
    }
    return known;
}

void run_ticks(int64_t count, const double *inputs, double *forces)
{
    model_past past;
    memset(&past, 0x01, sizeof past);
    model_past_reset(&past);
    for (int64_t i = 0; i < count; i++) {
        if (model_tick(&past, inputs[3 * i], inputs[3 * i + 1], inputs[3 * i + 2], &forces[i]) != MODEL_OK) {
            model_past_reset(&past);
        }
    }
}
"""
MASTER = """
#include "fmi2_model.c"

/* Outputs after each step, reals before Booleans and the reason: one row of WIDTH for each sample but the last. */
int run_samples(long count, const double *times, const double *inputs, double *rows)
{
    static const fmi2CallbackFunctions callbacks;
    static const unsigned int which[64] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  10, 11, 12, 13, 14, 15};
    const size_t booleans = REASON - REALS;
    fmi2Component c = fmi2Instantiate("one", fmi2CoSimulation, GUID, "", &callbacks, 0, 0);
    int bad = (c == NULL) || fmi2SetupExperiment(c, 0, 0.0, times[0], 0, 0.0) || fmi2ExitInitializationMode(c);
    for (long i = 0; !bad && i + 1 < count; i++) {
        int values[16];
        double *row = &rows[i * (REASON + 1)];
        bad = fmi2SetReal(c, which, 2, &inputs[3 * i]) || fmi2DoStep(c, times[i], times[i + 1] - times[i], 1)
            || fmi2GetReal(c, which, REALS, row) || fmi2GetBoolean(c, which + REALS, booleans, values)
            || fmi2GetInteger(c, which + REASON, 1, values + booleans);
        for (size_t j = 0; j <= booleans; j++) {
            row[REALS + j] = values[j];
        }
    }
    fmi2FreeInstance(c);
    return bad;
}
"""


class Samples(NamedTuple):
    """Stamps (n,) [ns], and inputs (n, 3): position [m], current [A] and motion."""

    stamps: NDArray[np.int64]
    inputs: NDArray[np.float64]


class Steps(NamedTuple):
    """Rows (n, 5) of `tick_loop`, reasons (n,), and late estimates (m,) and (m, 4)."""

    rows: NDArray[np.float64]
    reasons: NDArray[np.int64]
    later_stamps: NDArray[np.int64]
    later: NDArray[np.float64]


def assert_equal_bits(found: Steps, expected: Steps, what: str) -> None:
    """Check that all numbers are the same bit for bit; one NaN is like another."""
    for name, ours, theirs in zip(Steps._fields, found, expected, strict=True):
        assert len(ours) == len(theirs), f"{what}: {name}"
        one, other = ((x if x.dtype != float else np.where(np.isnan(x), np.nan, x)).ravel() for x in (ours, theirs))
        places = np.flatnonzero(one.view(np.int64) != other.view(np.int64))
        first = f"{places[0]}: {one[places[0]]!r}, {other[places[0]]!r}" if len(places) else ""
        assert not first, f"{what}: {name} at {first}"


def _outputs(count: int) -> tuple[NDArray, ...]:
    return np.full((count, 5), 1e9), np.full(count, -1), np.zeros(count, np.int64), np.zeros((count, 4))


def _steps(outputs: tuple[NDArray, ...], known: int) -> Steps:
    rows, reasons, later_stamps, later = outputs
    return Steps(rows, reasons, later_stamps[:known], later[:known])


def arrays_of(model: Model) -> list[NDArray]:
    """Return the eight arrays of the estimator."""
    kinds = (float, np.int64, float, np.int64)
    return [np.array(a, kind) for part in lay_out_estimator(model) for a, kind in zip(part, kinds, strict=True)]


def run_source(model: Model, samples: Samples) -> Steps:
    """Run the source in CPython."""
    return _run_lists(tick_loop.run_samples, [part.tolist() for part in arrays_of(model)], samples)


def run_extension(core: Any, model: Model, samples: Samples) -> Steps:
    """Run the same loop around functions of a compiled extension of CPython."""
    arrays = [array("q" if part.dtype == np.int64 else "d", part.tobytes()) for part in arrays_of(model)]
    calls = {}
    for name, which in (("estimator_reset", range(8)), ("estimator_step", range(8)), ("run_half_width", (4, 5, 6))):
        bound, skipped = core.bind(name, *(arrays[i] for i in which)), len(which)
        calls[name] = lambda *arguments, bound=bound, skipped=skipped: bound(*arguments[skipped:])
    loop = FunctionType(tick_loop.run_samples.__code__, {**vars(tick_loop), **calls})
    return _run_lists(loop, arrays, samples)


def _run_lists(loop: Callable[..., int], arrays: Sequence[Any], samples: Samples) -> Steps:
    count = len(samples.stamps)
    shapes = [output.shape for output in _outputs(count)]
    outputs = [output.ravel().tolist() for output in _outputs(count)]
    known = loop(*arrays, count, samples.stamps.tolist(), samples.inputs.ravel().tolist(), *outputs)
    return _steps(tuple(np.array(out).reshape(shape) for out, shape in zip(outputs, shapes, strict=True)), known)


def run_numba(model: Model, samples: Samples) -> Steps:
    """Run the source, compiled by Numba."""
    outputs = _outputs(len(samples.stamps))
    flat = [output.ravel() for output in outputs]
    known = compile_tick(tick_loop.run_samples)(
        *arrays_of(model), len(samples.stamps), samples.stamps, samples.inputs.ravel(), *flat
    )
    return _steps(outputs, known)


@cache
def core_texts() -> tuple[str, str]:
    """Return header and source of the core with the loop in it."""
    folder = Path(tick.__path__[0])
    texts = {name: (folder / f"{name}.py").read_text() for name in tick.MODULES}
    core = Core({**texts, "tick_loop": inspect.getsource(tick_loop)}, ["run_samples", "check_model"])
    return core.header, core.source


def compile_library(folder: Path, files: dict[str, str], *words: str) -> ctypes.CDLL:
    """Compile files of C strictly, and load them."""
    for name, text in files.items():
        (folder / name).write_text(text)
    listed = [name for name in files if name.endswith(".c")]
    command = ["cc", *STRICT, "-O2", *words, "-fPIC", "-shared", "-o", "library.so", *listed, "-lm"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(folder / "library.so"))


def compile_core(folder: Path) -> ctypes.CDLL:
    """Compile the core with the loop in it."""
    return compile_library(folder, dict(zip(("ces_core.h", "ces_core.c"), core_texts(), strict=True)))


def pointers(*arrays: NDArray) -> list[ctypes.c_void_p]:
    """Return the addresses of arrays for a function of C."""
    return [ctypes.c_void_p(array.ctypes.data) for array in arrays]


def run_core(library: ctypes.CDLL, model: Model, samples: Samples) -> Steps:
    """Run the printed core."""
    outputs, arrays, count = _outputs(len(samples.stamps)), arrays_of(model), ctypes.c_int64(len(samples.stamps))
    library.ces_run_samples.restype = ctypes.c_int64
    return _steps(outputs, library.ces_run_samples(*pointers(*arrays), count, *pointers(*samples, *outputs)))


def compile_export(folder: Path, model: Model) -> ctypes.CDLL:
    """Compile a model's C, and a user's loop around it."""
    facts = {"MOTION": model.sampling.motion, "BAND": model.band and not model.sampling.delay_s}
    words = [f"-D{name}" for name, holds in facts.items() if holds]
    return compile_library(folder, {**export_c(model, "model", "model", UNPROVED), "user.c": USER}, *words)


def run_export(library: ctypes.CDLL, samples: Samples) -> Steps:
    """Run a model's exported C."""
    outputs = _outputs(len(samples.stamps))
    library.run_samples.restype = ctypes.c_int64
    return _steps(outputs, library.run_samples(ctypes.c_int64(len(samples.stamps)), *pointers(*samples, *outputs)))


def run_fmu(folder: Path, model: Model, samples: Samples) -> dict[str, NDArray]:
    """Run the sources of a model's FMU; return its outputs by name, after each step but the last."""
    files = sources(model, "model", UNPROVED)
    names = [variable.name for variable in list_variables(model)]
    folder /= "fmu"
    folder.mkdir()
    included = files.pop("fmi2_model.c")
    (folder / "fmi2_model.c").write_text(included)
    library = compile_library(folder, {**files, "master.c": MASTER})
    rows, times = np.zeros((len(samples.stamps) - 1, len(names))), samples.stamps * 1e-9
    count = ctypes.c_long(len(samples.stamps))
    assert library.run_samples(count, *pointers(times, samples.inputs, rows)) == 0
    return dict(zip(names, rows.T, strict=True))


def run_ticks(library: ctypes.CDLL, inputs: NDArray) -> NDArray:
    """Return the forces (n,) of a model's exported tick at positions, speeds and currents (n, 3)."""
    forces = np.empty(len(inputs))
    library.run_ticks(ctypes.c_int64(len(inputs)), *pointers(np.ascontiguousarray(inputs), forces))
    return forces


def python_ticks(model: Model, inputs: NDArray) -> NDArray:
    """Return the same of the free run in Python, with a reset after each force that is not finite."""
    run, forces = model.make_predictor(), []
    for row in inputs.tolist():
        forces.append(run.tick(*row))
        if not np.isfinite(forces[-1]):
            forces[-1] = np.nan
            run.reset()
    return np.array(forces)
