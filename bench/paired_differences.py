"""How often `ces compare` calls a difference significant: two models of known true cost, on made errors.

    python -m bench.paired_differences [--runs 200]

Both errors share a common part and have one of their own, each an autoregressive process of first order (`tau_s`), as
the errors of two models of one damper do. The own parts are modulated: not at all, periodically by the stroke, or by a
slow random excitation (`slow_s`, its correlation time). With equal sizes every significant difference is a false one;
with `ratio` above 1 the first model's own part is that much larger, and the share is the power. Differences of the
cost are then about a twentieth (ratio 1.1) and a quarter (1.5) of it.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from ces_identify.comparison import paired_bootstrap
from ces_identify.comparison.aligned_recording import AlignedRecording
from ces_identify.numerics.arrays import F

RATE_HZ = 500.0
REPLICATES = 400
ALPHA = 0.05
RATIOS = (1.1, 1.5)


@dataclass(frozen=True)
class MadeErrors:
    """How the errors of two models are made."""

    seconds: float
    tau_s: float
    modulation: str = "none"
    slow_s: float = 0.3
    ratio: float = 1.0
    recordings: int = 1


def make_recording(kind: MadeErrors, random: np.random.Generator) -> AlignedRecording:
    """Return a recording with the errors of two models."""
    n = round(kind.seconds * RATE_HZ)
    time_s = np.arange(n) / RATE_HZ
    common, first, second = (draw_correlated(n, kind.tau_s, random) for _ in range(3))
    sizes = MODULATIONS[kind.modulation](time_s, kind.slow_s, random)
    measured = 20.0 * draw_correlated(n, 0.1, random)
    forces = measured - np.stack([common + kind.ratio * sizes[0] * first, common + sizes[1] * second])
    still, all_scored = np.zeros(n), np.ones(n, bool)
    return AlignedRecording(
        "made", "", "", RATE_HZ, time_s, still, still, measured, forces, all_scored, (False, False), ((), ()), {}
    )


def draw_correlated(n: int, tau_s: float, random: np.random.Generator) -> F:
    """Return an autoregressive process (n,) of variance 1 and correlation time `tau_s`."""
    pole = float(np.exp(-1.0 / (tau_s * RATE_HZ)))
    settling = round(10.0 * tau_s * RATE_HZ)
    noise = random.normal(size=n + settling)
    return np.asarray(lfilter([np.sqrt(1.0 - pole**2)], [1.0, -pole], noise)[settling:])


def _steady(time_s: F, slow_s: float, random: np.random.Generator) -> tuple[F, F]:
    return np.ones(len(time_s)), np.ones(len(time_s))


def _periodic(time_s: F, slow_s: float, random: np.random.Generator) -> tuple[F, F]:
    return 1.0 + np.sin(4.0 * np.pi * time_s), 1.0 + np.cos(4.0 * np.pi * time_s)


def _slow(time_s: F, slow_s: float, random: np.random.Generator) -> tuple[F, F]:
    first, second = (np.exp(0.5 * draw_correlated(len(time_s), slow_s, random)) for _ in range(2))
    return first, second


MODULATIONS: dict[str, Callable[[F, float, np.random.Generator], tuple[F, F]]] = {
    "none": _steady,
    "periodic": _periodic,
    "slow": _slow,
}


def count_outcomes(kind: MadeErrors, runs: int, seed: int = 0) -> tuple[float, float]:
    """Return the share of significant differences, and that of recordings that are too short to know."""
    random = np.random.default_rng(seed)
    significant = short = 0
    for _ in range(runs):
        recordings = [make_recording(kind, random) for _ in range(kind.recordings)]
        (found,) = paired_bootstrap.find_differences(recordings, [(0, 1)], int(random.integers(1 << 30)))
        short += not found.enough
        significant += found.enough and found.p_value() < ALPHA
    return significant / runs, short / runs


KINDS = [
    *(MadeErrors(25.0, tau_s, modulation, 0.0) for modulation in ("none", "periodic") for tau_s in (0.002, 0.1)),
    *(MadeErrors(seconds, 0.1, "slow", 0.3) for seconds in (10.0, 25.0, 60.0)),
    *(MadeErrors(seconds, 0.1, "slow", 1.0) for seconds in (25.0, 60.0)),
    *(MadeErrors(seconds, 0.1, "slow", 3.0) for seconds in (10.0, 60.0)),
    MadeErrors(25.0, 0.02, "slow", 1.0, recordings=4),
]


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--only", type=int, nargs="*", default=range(len(KINDS)), help="numbers of rows")
    options = parser.parse_args()
    paired_bootstrap.REPLICATES = REPLICATES
    print("| modulation | seconds | tau s | slow s | recordings | false % | too short % | power % at 1.1 | at 1.5 |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for kind in (KINDS[i] for i in options.only):
        false, short = count_outcomes(kind, options.runs)
        powers = [count_outcomes(replace(kind, ratio=ratio), options.runs)[0] for ratio in RATIOS]
        row = (kind.modulation, kind.seconds, kind.tau_s, kind.slow_s, kind.recordings)
        shares = [f"{100 * share:.1f}" for share in (false, short, *powers)]
        print(f"| {' | '.join([*map(str, row), *shares])} |", flush=True)


if __name__ == "__main__":
    main()
