"""What a better speed is worth in force: adaptive and Wiener filters, and the true speed.

Two tables, printed as Markdown: the rig's own plant driven by each speed, at three levels of sensor noise; and models
with the same terms, fitted again for each speed. Parameters of all filters come from noise and sweep, the recordings
for identification, except for the rows that say so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import blas_one_thread  # noqa: F401 - before NumPy
import numpy as np
from bench_differentiators import (
    RATE,
    RIG,
    RigRun,
    markdown,
    own_estimate,
    plant_cost,
    rig_run,
    with_speed,
)
from differentiator_peers import F, kalman
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from ces_identify.polynomial.gauss_newton import fit_free_run
from ces_identify.polynomial.problem import assemble_problem
from ces_identify.polynomial.search_limits import Limits
from ces_identify.prepare.cost import EQUAL, series_cost
from ces_identify.prepare.sampling import (
    EXTRA_HZ,
    Spectrum,
    choose_sampling,
    position_spectrum,
    split_spectrum,
)
from ces_identify.prepare.series import Series, prepare
from ces_identify.simulations.simulate import simulate_series
from ces_identify.structures.kit import IdentifyOptions
from ces_identify.structures.polynomial import fit_polynomial
from ces_observer.model import ADAPTIVE, KALMAN, Model, Sampling
from ces_observer.structures.polynomial import Polynomial
from ces_observer.structures.terms import Term
from ces_rig.sensors import measure_signals

TAPS = 60  # of a Wiener filter
NOISE_SCALES = (0.3, 1.0, 3.0)


def wiener_taps(spectra: Sequence[Spectrum], extra: float) -> F:
    """Return the causal FIR filter (TAPS,) of least mean relative speed error, exact for a constant speed.

    The stroke's spectrum gets `extra` times its speed power up to EXTRA_HZ, as the rule for the bandwidth adds it.
    """
    frequency, rate = spectra[0].frequency, spectra[0].rate_Hz
    omega = 2.0 * np.pi * frequency
    stroke, noise = np.zeros(len(omega)), np.zeros(len(omega))
    for spectrum in spectra:
        own, other = split_spectrum(spectrum)
        speed = omega**2 * own
        shape = (own > 0.0) / (1.0 + (frequency / EXTRA_HZ) ** 4)
        stroke += (speed / speed.sum() + extra * shape / shape.sum()) / omega**2
        noise += other / speed.sum()
    return _solve(toeplitz(_correlation(stroke + noise)), _correlation(1j * omega * stroke), rate)


def best_taps(runs: Sequence[RigRun]) -> F:
    """Return the causal FIR filter of least mean relative speed error on these recordings, knowing the true speed."""
    matrix, vector = np.zeros((TAPS, TAPS)), np.zeros(TAPS)
    for run in runs:
        x = run.positions - run.positions[0]
        past = np.stack([np.concatenate([np.zeros(k), x[: len(x) - k]]) for k in range(TAPS)], axis=1)[500:]
        matrix += past.T @ past / run.speed.var()
        vector += past.T @ run.speed[500:] / run.speed.var()
    return _solve(matrix, vector, RATE)


def _correlation(density: np.ndarray) -> F:
    """Return the correlation at lags 0 to TAPS - 1 of a one-sided density without its value at 0 Hz."""
    both = np.concatenate([[0.0], density, np.conj(density[-2::-1])])
    return np.asarray(np.fft.ifft(both).real[:TAPS])


def _solve(matrix: F, vector: F, rate: float) -> F:
    """Return the taps of least squares that give 0 at rest and the speed of a constant motion."""
    scale, exact = matrix[0, 0], np.stack([np.ones(TAPS), -np.arange(TAPS) / rate])
    system = np.block([[matrix / scale, exact.T], [exact, np.zeros((2, 2))]])
    return np.asarray(np.linalg.lstsq(system, np.concatenate([vector / scale, [0.0, 1.0]]), rcond=1e-15)[0][:TAPS])


def apply_filter(taps: F, x: F) -> F:
    return np.asarray(lfilter(taps, 1.0, x - x[0]))


def with_noise(run: RigRun, scale: float) -> RigRun:
    """Return the same experiment with `scale` times the noise and resolution of its position sensor."""
    sensors, settings = run.experiment.sensors, run.experiment.settings
    position = replace(sensors.position, noise=scale * sensors.position.noise, quantum=scale * sensors.position.quantum)
    noisy = replace(sensors, position=position)
    return replace(run, recording=measure_signals(run.true, noisy, settings.seed, settings.name))


def plant_table(runs: Mapping[str, RigRun]) -> list[str]:
    rows = [["position noise", "speed", *RIG]]
    for scale in NOISE_SCALES:
        noisy = {name: with_noise(run, scale) for name, run in runs.items()}
        for name, speeds in rig_speeds(noisy, everything=scale == 1.0).items():
            rows.append([f"x {scale:g}", name, *(f"{plant_cost(speeds[n], noisy[n]):.2f}" for n in RIG)])
    return markdown(rows)


def rig_speeds(runs: Mapping[str, RigRun], everything: bool) -> dict[str, dict[str, F]]:
    """Return the speeds at the position samples by kind of filter and experiment."""
    training = [runs["noise"].recording, runs["sweep"].recording]
    out = {}
    for kind in (KALMAN, ADAPTIVE):
        sampling = choose_sampling(training, differentiator=kind)
        out[f"`{kind}`"] = {n: own_estimate(sampling, run.recording) for n, run in runs.items()}
    if everything:
        spectra = [position_spectrum(r, 0.05) for r in training]
        for extra in (0.02, 0.005):
            taps = wiener_taps(spectra, extra)
            out[f"Wiener, {100 * extra:g} % added"] = {n: apply_filter(taps, r.positions) for n, r in runs.items()}
        for bandwidth in (90.0, 150.0, 190.0):
            wider = {n: kalman(3)(run.positions, RATE, bandwidth) for n, run in runs.items()}
            out[f"Kalman of order 3, {bandwidth:g} Hz"] = wider
        taps = best_taps(list(runs.values()))
        out["best linear filter for all five, knowing the true speed"] = {
            n: apply_filter(taps, r.positions) for n, r in runs.items()
        }
    return out


def refit(model: Model, training: Sequence[Series]) -> Model:
    """Return the model with its coefficients fitted to the free run on these series."""
    terms = model.body.terms  # type: ignore[attr-defined]
    problem = assemble_problem(training, list(terms), True, EQUAL)
    start = np.array([term.coefficient for term in terms])
    fit = fit_free_run(problem, np.arange(len(terms)), start, problem.everything, 150)
    body = Polynomial(tuple(Term(float(c), t.factors) for c, t in zip(fit.coefficients, terms, strict=True)))
    return Model(model.sampling, body, problem.envelope, problem.force_envelope)


def search(training: Sequence[Series], sampling: Sampling) -> Model:
    limits = Limits(25, 120.0, starts=1, threads=1, method="gauss-newton")
    return fit_polynomial(training, sampling, IdentifyOptions(limits=limits), lambda result: None).model


def cost(model: Model, series: Series) -> float:
    return series_cost(series, simulate_series(model, series).force)


def refit_table(runs: Mapping[str, RigRun]) -> list[str]:
    """Return the mean cost over several sets of terms, each fitted again for every speed."""
    speeds = rig_speeds(runs, everything=True) | {"true speed": {n: run.speed for n, run in runs.items()}}
    sampling = choose_sampling([runs["noise"].recording, runs["sweep"].recording], differentiator=KALMAN)
    prepared = {n: prepare(run.recording, sampling) for n, run in runs.items()}
    recordings = [run.recording for run in runs.values()]
    sets = {}
    for kind, speed in speeds.items():
        series = with_speed(list(prepared.values()), recordings, list(speed.values()))
        sets[kind] = dict(zip(RIG, series, strict=True))
    origins = [*list(sets.values())[:2], sets["true speed"]]
    seeds = [search([s["noise"], s["sweep"]], sampling) for s in origins]
    rows = [["speed", *RIG]]
    for kind, series in sets.items():
        models = [refit(model, [series["noise"], series["sweep"]]) for model in seeds]
        rows.append([kind, *(f"{np.mean([cost(m, series[n]) for m in models]):.2f}" for n in RIG)])
    return markdown(rows)


def main() -> None:
    runs = {name: rig_run(name) for name in RIG}
    print("\n## The rig's plant driven by each speed, J [%]\n")
    print("\n".join(plant_table(runs)))
    print("\n## The same terms, fitted again for each speed: noise + sweep -> all, J [%]\n")
    print("\n".join(refit_table(runs)))


if __name__ == "__main__":
    main()
