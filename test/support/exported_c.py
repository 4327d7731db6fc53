"""Exported C beside the estimator in Python: compilation, runs of both, and rough samples for them."""

import ctypes
import math
import subprocess

import numpy as np
from physical_examples import ENVELOPE

from ces_identify.export.export_c import REASONS, export_c
from ces_observer.estimator import Estimator
from ces_observer.proof.certificate import Contraction

STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-pedantic", "-O1", "-Werror"]
CODES = {reason: code for code, reason in enumerate(REASONS.values())}
UNPROVED = Contraction(2.0, 1.0, 1, "", "")
COUNT = 2000
MS = 1_000_000
HARNESS = """
#include "model.h"
#include <string.h>

#ifdef MOTION
#define STEP(i) model_step(&state, stamps[i], positions[i], currents[i], motions[i], &out[5 * i])
#else
#define STEP(i) ((void)motions, model_step(&state, stamps[i], positions[i], currents[i], &out[5 * i]))
#endif
#ifdef BAND
#define WIDTH model_half_width(&state)
#else
#define WIDTH 0.0
#endif

void steps(int64_t n, const int64_t *stamps, const double *positions, const double *currents, const double *motions,
           double *out, int32_t *reasons)
{
    model_state state;
    memset(&state, 0x01, sizeof state); /* reset has to set everything */
    model_reset(&state);
    for (int64_t i = 0; i < n; i++) {
        reasons[i] = (int32_t)STEP(i);
        out[5 * i + 1] = state.position_m;
        out[5 * i + 2] = state.speed_m_s;
        out[5 * i + 3] = state.past.clamped ? 1.0 : 0.0;
        out[5 * i + 4] = reasons[i] == MODEL_OK ? WIDTH : 0.0;
    }
}

void ticks(int64_t n, const double *positions, const double *speeds, const double *currents, double *forces)
{
    model_past past;
    memset(&past, 0x01, sizeof past);
    model_past_reset(&past);
    for (int64_t i = 0; i < n; i++) {
        if (model_tick(&past, positions[i], speeds[i], currents[i], &forces[i]) != MODEL_OK) {
            model_past_reset(&past);
        }
    }
}
"""


# ---------------------------------------------------------------------------------------------------------- inputs


def stroke(stamps):
    t = (stamps - stamps[0]) * 1e-9
    return 0.012 * np.sin(25.0 * t) + 0.004 * np.sin(90.0 * t + 1.0)


def steady(dice, interval_ns=MS, jitter_ns=0.0):
    stamps = 10**18 + np.arange(COUNT) * interval_ns + np.rint(dice.uniform(-jitter_ns, jitter_ns, COUNT)).astype(int)
    position = stroke(stamps) + dice.normal(0, 15e-6, COUNT)
    return stamps, position, 0.5 + 0.3 * np.sin(stamps * 4e-9)


def jittered(dice):
    return steady(dice, jitter_ns=0.45 * MS)


def gapped(dice):
    stamps, _, current = jittered(dice)
    for at, gap_ms in ((400, 49), (900, 60), (1000, 5), (1300, 20_000)):
        stamps[at:] += gap_ms * MS
    kept = dice.random(COUNT) > 0.1
    return stamps[kept], stroke(stamps)[kept], current[kept]


def not_finite(dice):
    stamps, position, current = jittered(dice)
    for values in (position, current):
        values[dice.choice(COUNT, 100, replace=False)] = dice.choice([np.nan, np.inf, -np.inf], 100)
    position[:5] = np.nan
    position[1000:1080] = np.nan
    return stamps, position, current


def outliers(dice):
    stamps, position, current = jittered(dice)
    position[dice.choice(COUNT, 60, replace=False)] += 0.05
    position[700:709] -= 0.1
    position[950:960] += 0.2
    position[1150:1161] += 0.2
    position[1400:] += 0.03
    position[1800] = 1e308
    return stamps, position, current


def late(dice):
    stamps, position, current = jittered(dice)
    for at in dice.choice(np.arange(10, COUNT), 80, replace=False):
        stamps[at] = stamps[at - dice.integers(1, 9)]
    stamps[800] -= 2_000 * MS
    stamps[1400:] -= 5_000 * MS
    return stamps, position, current


def slow(dice):
    return steady(dice, interval_ns=4_100_000)


def fast(dice):
    return steady(dice, interval_ns=301_000, jitter_ns=100_000)


def wide(dice):
    stamps, position, current = jittered(dice)
    return stamps, 2.0 * position, 3.0 * (current - 0.3)


def at_rest(dice):
    stamps, position, current = steady(dice)
    position[:] = 0.0
    position[1000:] = -0.0
    return stamps, position, current


def half_ticks(dice):
    """Samples exactly between two ticks of the model that ticks every 2^20 ns, where rounding decides."""
    return steady(dice, interval_ns=2**19)


def edges(dice):
    """A clock that starts at zero, a position just not an outlier, a gap just not too long and one that is."""
    stamps, position, current = steady(dice)
    stamps -= stamps[0]
    position[:2] = [0.0, 0.004]
    stamps[1000:] += 49 * MS
    stamps[1200:] += 49 * MS + 1
    return stamps, position, current


def lost_rows(dice):
    """A fast stroke of which rows of up to 60 samples are lost, with wrong positions straight after some."""
    stamps, _, current = jittered(dice)
    position, kept, at = 6.0 * stroke(stamps), np.ones(COUNT, bool), 150
    while at < COUNT - 100:
        lost = dice.integers(1, 61)
        kept[at : at + lost] = False
        position[at + lost] += dice.choice([0.0, 0.0, 0.01, 0.05, 0.4, -0.2])
        at += lost + dice.integers(2, 60)
    return stamps[kept], position[kept], current[kept]


def ends_of_time(dice):
    stamps, position, current = steady(dice)
    first, last = np.iinfo(np.int64).min, np.iinfo(np.int64).max
    stamps[:1000] = first + np.arange(1000) * MS
    stamps[1000:1010] = [first, last, 0, first, -1, 0, 1, last, last - 1, first]
    stamps[1400:] = last - np.arange(COUNT - 1400)[::-1] * MS
    return stamps, position, current


def all_at_once(dice):
    stamps, position, current = outliers(dice)
    stamps[600:] += 70 * MS
    stamps[1200:] -= 400 * MS
    current[dice.choice(COUNT, 50, replace=False)] = np.nan
    kept = dice.random(COUNT) > 0.05
    return stamps[kept], position[kept], 2.0 * current[kept]


INPUTS = [
    *(steady, jittered, gapped, not_finite, outliers, late, slow, fast),
    *(wide, at_rest, half_ticks, edges, lost_rows, ends_of_time, all_at_once),
]


# ------------------------------------------------------------------------------------------------------------ twins


def compile_c(folder, model, certificate=UNPROVED):
    """Return the loaded library of a model's C and the harness."""
    source, header = export_c(model, "model", "model", certificate)
    for name, text in (("model.c", source), ("model.h", header), ("harness.c", HARNESS)):
        (folder / name).write_text(text, encoding="ascii")
    defined = ["-DMOTION"] * bool(model.sampling.motion_signal) + ["-DBAND"] * bool(model.band)
    run = ["cc", *STRICT, *defined, "-fPIC", "-shared", "-o", "model.so", "model.c", "harness.c", "-lm"]
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(folder / "model.so"))


def pointers(*arrays):
    return [ctypes.c_void_p(a.ctypes.data) for a in arrays]


def motion_of(stamps, position):
    """Return a rough speed or acceleration: some are missing, as where none was recent enough."""
    motion = 40.0 * np.clip(np.nan_to_num(position), -1.0, 1.0) + 1e-9 * (stamps % 1_000_003)
    return np.where(stamps % 97 == 0, np.nan, motion)


def c_steps(library, stamps, position, current):
    """Return rows (n, 5) of force, position, speed, clamped and half width of the band, and reasons (n,)."""
    motion = motion_of(stamps, position)
    kinds = (np.int64, float, float, float)
    arrays = [np.ascontiguousarray(a, k) for a, k in zip((stamps, position, current, motion), kinds, strict=True)]
    rows, reasons = np.full((len(stamps), 5), 1e9), np.full(len(stamps), -1, np.int32)
    library.steps(ctypes.c_int64(len(stamps)), *pointers(*arrays, rows, reasons))
    return rows, reasons


def python_steps(model, stamps, position, current):
    e, rows, reasons = Estimator(model), [], []
    motion = motion_of(stamps, position) if model.sampling.motion_signal else np.zeros(len(stamps))
    for sample in zip(stamps.tolist(), position.tolist(), current.tolist(), motion.tolist(), strict=True):
        force = e.step(*sample)
        width = e.half_width() if model.band and force is not None else 0.0
        rows.append((math.nan if force is None else force, e.position, e.speed, e.clamped, width))
        reasons.append(CODES[e.reason])
    return np.array(rows, float), np.array(reasons)


def c_ticks(library, position, speed, current):
    """Return the forces (n,) of ticks, NaN where there is none; the past is then cleared."""
    arrays = [np.ascontiguousarray(values, float) for values in (position, speed, current)]
    forces = np.empty(len(arrays[0]))
    library.ticks(ctypes.c_int64(len(forces)), *pointers(*arrays, forces))
    return forces


def python_ticks(model, position, speed, current):
    run, forces = model.make_predictor(), []
    for row in zip(position.tolist(), speed.tolist(), current.tolist(), strict=True):
        forces.append(run.tick(*row))
        if math.isinf(forces[-1]):
            forces[-1] = math.nan
            run.reset()
    return np.array(forces)


def undefined_and_defined(folder):
    """Return the names that model.c needs, and kinds by name of those it has, of a model that `compile_c` put there."""
    subprocess.run(["cc", *STRICT, "-c", "model.c"], cwd=folder, check=True)
    listing = subprocess.run(["nm", "model.o"], cwd=folder, capture_output=True, text=True, check=True).stdout
    kinds = {line.split()[-1]: line.split()[-2] for line in listing.splitlines()}
    return {name for name, kind in kinds.items() if kind == "U"}, kinds


def seeded(shape):
    return shape(np.random.default_rng(INPUTS.index(shape)))


def hostile(count, seed):
    """Return inputs that jump between and beyond the ends of their ranges, each held for random times."""
    dice, inputs = np.random.default_rng(seed), []
    for low, high in ENVELOPE.by_signal.values():
        width = high - low
        ends = dice.choice([low, high, low - 1.5 * width, high + 1.5 * width, high + 0.4 * width, 0.0], count)
        drawn = np.where(dice.random(count) < 0.7, ends, dice.uniform(low - 1.5 * width, high + 1.5 * width, count))
        new = dice.random(count) < dice.choice([0.02, 0.3, 1.0])
        inputs.append(drawn[np.maximum.accumulate(np.where(new, np.arange(count), 0))])
    return inputs
