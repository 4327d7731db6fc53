"""Exported C beside the estimator in Python: compilation, runs of both, and rough samples for them."""

import ctypes
import math
import subprocess
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from hydraulic_models import ENVELOPE
from numpy.typing import NDArray

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
#ifdef ONLY_LATE
#define OWN state.delayed
#else
#define OWN state.now
#endif

/* Rows of force, position, speed, half-width and clamped; the first four of the late ones, whose number is returned. */
int64_t steps(int64_t n, const int64_t *stamps, const double *positions, const double *currents, const double *motions,
              double *out, int32_t *reasons, int64_t *late_stamps, double *late)
{
    model_state state;
    int64_t known = 0;
    (void)late_stamps;
    (void)late;
    memset(&state, 0x01, sizeof state); /* reset has to set everything */
    model_reset(&state);
    for (int64_t i = 0; i < n; i++) {
        reasons[i] = (int32_t)STEP(i);
        out[5 * i + 1] = state.position_m;
        out[5 * i + 2] = state.speed_m_s;
        out[5 * i + 3] = reasons[i] == MODEL_OK ? WIDTH : 0.0;
        out[5 * i + 4] = OWN.past.clamped ? 1.0 : 0.0;
#ifdef MODEL_DELAY_TICKS
        for (uint32_t j = 0; j < state.late_count; j++) {
            const model_estimate *one = &state.late[j];
            const double row[4] = {one->force_N, one->position_m, one->speed_m_s, one->half_width_N};
            late_stamps[known] = one->stamp_ns;
            memcpy(&late[4 * known++], row, sizeof row);
        }
#endif
    }
    return known;
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


def a_million_samples():
    """Jitter, lost rows, gaps, jumps, spikes, wild positions, and stamps that repeat, run back or leap by years."""
    dice, n = np.random.default_rng(9), 1_000_000
    intervals = dice.uniform(0.6, 1.4, n) * MS
    rows = dice.random(n) < 4e-3  # lost, mostly shorter than a gap that restarts
    intervals[rows] += dice.exponential(15.0 * MS, rows.sum())
    intervals[dice.random(n) < 0.02] = 0.2 * MS  # several samples in a tick
    stamps = 10**18 + np.cumsum(np.rint(intervals).astype(np.int64))
    position = stroke(stamps) * dice.choice([0.5, 1.0, 2.0], n // 1000).repeat(1000) + dice.normal(0, 15e-6, n)
    position += 0.03 * (np.cumsum(dice.random(n) < 2e-5) % 2)  # jumps that last
    wild = dice.random(n) < 3e-3
    position[wild] += dice.choice([0.01, -0.05, 0.3, 1e3, -1e308, np.nan, np.inf], wild.sum())
    wrong = dice.random(n) < 2e-3
    stamps[wrong] += dice.choice([0, -1, -MS, -3 * MS, 40 * MS, -60 * MS, 10**17, -(10**18)], wrong.sum())
    current = np.where(dice.random(n) < 1e-3, np.nan, 0.5 + 0.3 * np.sin(stamps * 4e-9))
    return stamps, position, current


# ------------------------------------------------------------------------------------------------------------ twins


def with_delay(model, delay_s):
    """Return a model whose estimates come late."""
    return replace(model, sampling=replace(model.sampling, delay_s=delay_s))


def two_models(model, other, delay_s):
    """Return a model with another one, for the same samples, whose estimates come late."""
    return replace(model, delayed=with_delay(replace(other, sampling=model.sampling), delay_s))


def compile_c(folder, model, certificate=UNPROVED):
    """Return the loaded library of a model's C and the harness."""
    source, header = export_c(model, "model", "model", certificate)
    for name, text in (("model.c", source), ("model.h", header), ("harness.c", HARNESS)):
        (folder / name).write_text(text, encoding="ascii")
    now = not model.sampling.delay_s
    facts = {"MOTION": model.sampling.motion, "BAND": model.band and now, "ONLY_LATE": not now}
    defined = [f"-D{name}" for name, holds in facts.items() if holds]
    run = ["cc", *STRICT, *defined, "-fPIC", "-shared", "-o", "model.so", "model.c", "harness.c", "-lm"]
    done = subprocess.run(run, cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(folder / "model.so"))


def pointers(*arrays):
    return [ctypes.c_void_p(a.ctypes.data) for a in arrays]


def motion_of(stamps, position):
    """Return a rough speed or acceleration: some are missing, as where none was recent enough."""
    motion = 40.0 * np.clip(np.nan_to_num(position), -1.0, 1.0) + 1e-9 * (stamps % 1_000_003)
    motion[stamps % 89 == 0], motion[stamps % 83 == 0] = 1e6, -1e300
    return np.where(stamps % 97 == 0, np.nan, motion)


class Steps(NamedTuple):
    """Rows (n, 5) of force, position, speed, half-width and clamped; reasons (n,); late rows (m, 4) and stamps (m,)."""

    rows: NDArray[np.float64]
    reasons: NDArray[np.int32]
    late_stamps: NDArray[np.int64]
    late: NDArray[np.float64]


def c_steps(library, stamps, position, current, motion=None):
    """Return what the C gives; without a motion, a rough one."""
    motion = motion_of(stamps, position) if motion is None else motion
    kinds, n = (np.int64, float, float, float), len(stamps)
    arrays = [np.ascontiguousarray(a, k) for a, k in zip((stamps, position, current, motion), kinds, strict=True)]
    rows, late = np.full((n, 5), 1e9), np.full((n, 4), 1e9)
    reasons, late_stamps = np.full(n, -1, np.int32), np.zeros(n, np.int64)
    library.steps.restype = ctypes.c_int64
    known = library.steps(ctypes.c_int64(n), *pointers(*arrays, rows, reasons, late_stamps, late))
    return Steps(rows, reasons, late_stamps[:known], late[:known])


def python_steps(model, stamps, position, current, motion=None):
    """Return the same of the estimator."""
    e, rows, reasons, late = Estimator(model), [], [], []
    motion = motion_of(stamps, position) if motion is None else motion
    for *sample, signal in zip(stamps.tolist(), position.tolist(), current.tolist(), motion.tolist(), strict=True):
        force = e.step(*sample, signal if model.sampling.motion else 0.0)
        width = e.half_width() if model.band and force is not None else 0.0
        rows.append((math.nan if force is None else force, e.position, e.speed, width, e.clamped))
        reasons.append(CODES[e.reason])
        late += [(one.stamp_ns, one.force, one.position, one.speed, one.half_width) for one in e.late]
    late_rows = np.array([row[1:] for row in late], float).reshape(-1, 4)
    return Steps(np.array(rows, float), np.array(reasons), np.array([row[0] for row in late], np.int64), late_rows)


def assert_same(found, expected, atol, what=""):
    """Check that two results of steps are equal to 1e-9, forces also to `atol` [N]."""
    np.testing.assert_array_equal(found.reasons, expected.reasons, what)
    np.testing.assert_array_equal(found.late_stamps, expected.late_stamps, what)
    np.testing.assert_array_equal(found.rows[:, 4], expected.rows[:, 4], what)
    for rows, others in ((found.rows, expected.rows), (found.late, expected.late)):
        np.testing.assert_allclose(rows[:, 0], others[:, 0], rtol=1e-9, atol=atol, err_msg=what)
        np.testing.assert_allclose(rows[:, 1:3], others[:, 1:3], rtol=1e-9, atol=1e-14, err_msg=what)
        np.testing.assert_allclose(rows[:, 3], others[:, 3], rtol=1e-9, err_msg=what)


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
