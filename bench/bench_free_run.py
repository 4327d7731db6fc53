"""Speed of the batch free run, of the polynomial's tick, and of the ticks of models with physics inside beside it.

Usage: python bench/bench_free_run.py. Prints medians over repetitions; the free run works on 30,000 samples and 10
terms, once from ready power tables and once with their computation.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from measurement import median_seconds, time_interleaved

from ces_identify.numerics.kernels import free_run
from ces_identify.polynomial.problem import lay_out_terms
from ces_observer.model import Envelope, Model, Sampling, load_model
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Factor, Term

N = 30_000
LIVELY = 10_000
FITTED = Path(__file__).resolve().parent / "fuzz" / "seeds" / "model"
PHYSICAL = ("hydraulic", "hydraulic_bypass")


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


def inputs() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.arange(N) * 1e-3
    return 0.02 * np.sin(25 * t), 0.5 * np.cos(25 * t), 0.5 + 0.1 * np.sin(3 * t)


def main() -> None:
    terms = ten_terms()
    x, v, i = inputs()
    envelope = Envelope((-1.0, 1.0), (-2.0, 2.0), (0.0, 1.0))
    layout = lay_out_terms(terms)
    coefficients = np.array([t.coefficient for t in terms])
    segments = np.array([[0, N]])
    table = layout.power_table(envelope, (x, v, i), segments, 1000.0)

    def batch() -> object:
        return free_run(table, segments, layout.arrays, coefficients, (-1e6, 1e6))

    def batch_with_tables() -> object:
        made = layout.power_table(envelope, (x, v, i), segments, 1000.0)
        return free_run(made, segments, layout.arrays, coefficients, (-1e6, 1e6))

    ready, whole = median_seconds(batch, 200), median_seconds(batch_with_tables, 50)
    print(f"free run, {N} samples, {len(terms)} terms")
    print(f"  kernel                  {1e3 * ready:8.3f} ms   {1e9 * ready / N / len(terms):6.2f} ns a sample and term")
    print(f"  kernel + power tables   {1e3 * whole:8.3f} ms")
    model = Model(Sampling(1000.0, 1e-5, 0.35, (-0.1, 0.1), 0.01), Polynomial(terms), envelope, (-1e6, 1e6))
    bench_tick(model)
    bench_physical_ticks(model)


def bench_tick(model: Model) -> None:
    """Time the polynomial alone."""
    rows = list(zip(*(column.tolist() for column in inputs()), strict=True))
    mean = median_seconds(through(model.make_predictor().tick, rows), 21) / len(rows)
    begin = median_seconds(model.make_predictor, 51)
    print(f"polynomial tick, {len(model.body.terms)} terms, position + speed + current in, force out")
    print(f"  mean                    {1e6 * mean:8.2f} us   (its tables, once at start: {1e3 * begin:.2f} ms)")


def through(tick: Callable[..., object], rows: Sequence[tuple[float, ...]]) -> Callable[[], None]:
    """Return a run of a tick through rows of inputs."""

    def run() -> None:
        for x, v, c in rows:
            tick(x, v, c)

    return run


def bench_physical_ticks(polynomial: Model) -> None:
    """Time the ticks of fitted models with physics inside, in turn with the polynomial's."""
    models = {"polynomial": polynomial, **{name: load_model(FITTED / f"{name}.json") for name in PHYSICAL}}
    runs = {name: through(model.make_predictor().tick, lively_rows(model)) for name, model in models.items()}
    times = time_interleaved(runs, 21)
    print("tick of fitted models, lively speeds and currents over 90 % of the envelope")
    for name in PHYSICAL:
        size, ratio = models[name].size, times[name] / times["polynomial"]
        print(f"  {name:23s} {1e6 * times[name] / LIVELY:6.2f} us   {ratio:.1f} times the polynomial's; {size}")


def lively_rows(model: Model) -> list[tuple[float, ...]]:
    """Return inputs that cross pieces of the curves: a slow and a fast sine in the speed."""
    t = np.arange(LIVELY) * 1e-3
    shapes = 0.9 * np.sin(25 * t), 0.8 * np.cos(25 * t) + 0.1 * np.sin(400 * t), 0.9 * np.sin(30 * t)
    middles, halves = zip(*((0.5 * (a + b), 0.5 * (b - a)) for a, b in model.envelope.by_signal.values()), strict=True)
    columns = ((m + h * s).tolist() for m, h, s in zip(middles, halves, shapes, strict=True))
    return list(zip(*columns, strict=True))


if __name__ == "__main__":
    main()
