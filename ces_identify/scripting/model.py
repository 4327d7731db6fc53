"""A model as scripts and notebooks use it: simulate, predict, draw, report, and the table of its parameters."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ces_data import recording
from ces_data.arrays import F
from ces_data.checks.check import check_together, require_sound
from ces_data.checks.content import require_distinct
from ces_data.frames import import_pandas
from ces_data.reading import SIGNALS, PathInput, RecordingInput, RecordingInputs, as_path, as_recordings
from ces_data.recording import join_days
from ces_identify.identification import identify
from ces_identify.numerics.least_squares import one_blas_thread
from ces_identify.numerics.search import SearchResult
from ces_identify.options import IdentifyRequest
from ces_identify.prepare.series import Series, prepare
from ces_identify.report.page import write_report
from ces_identify.report.steady import steady_forces
from ces_identify.scripting.progress import Progress
from ces_identify.scripting.recording import Recording
from ces_identify.simulations.prediction import predict_series
from ces_identify.simulations.simulate import sample_run, simulate_series
from ces_identify.structures import model_section
from ces_identify.structures.polynomial import coefficient_unit, format_term
from ces_identify.validation.cost_table import Evaluations, cost_table
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, describe_size, evaluate
from ces_identify.validation.standard_errors import standard_errors
from ces_observer import model
from ces_observer.errors import CesError
from ces_observer.records import in_files
from ces_observer.structures.polynomial import Polynomial
from ces_report.shell import PageHead

MAX_STEPS = 100_000  # ticks ahead


@dataclass(frozen=True, repr=False)
class Model(model.Model):
    """A force model with what can be done with it; `evaluations` are its costs where it was identified.

    Recordings are paths of bags and logs, DataFrames, mappings of arrays, or `Recording` objects.

        model = ces.identify("rig/noise", structure="auto")
        force_N = model.simulate(time_s, position_m, 0.5)
        model.report("report.html", "rig/road")
    """

    evaluations: tuple[Evaluation, ...] = field(default=(), metadata=in_files(None), compare=False)
    search_results: tuple[SearchResult, ...] = field(default=(), metadata=in_files(None), compare=False)

    @classmethod
    def load(cls, path: PathInput) -> Self:
        """Read a model file. Raises CesError."""
        return cls.of(model.load_model(as_path(path, "model")))

    @classmethod
    def of(cls, given: object) -> Self:
        """Return a model, or that in a file, with these methods. Raises CesError for anything else."""
        if isinstance(given, cls):
            return given
        if not isinstance(given, model.Model):
            return cls.load(given)  # type: ignore[arg-type]  # which says what it is
        return cls(**{f.name: getattr(given, f.name) for f in fields(model.Model)})

    @classmethod
    def identify(
        cls,
        request: IdentifyRequest,
        given: Sequence[recording.Recording],
        held_out: Sequence[recording.Recording],
        progress: Progress = lambda step, share: None,
    ) -> Self:
        """Return the model that is asked for, identified on recordings that would make no wrong one.

        Warns of what looks wrong; raises CesError for what is, unless the request ignores it.
        """
        how, fitter, ignored = request.options(), request.fitter(), request.ignore_findings
        require_distinct(given, held_out)
        findings = check_together([*given, *held_out])
        require_sound(findings, ignored)
        for finding in findings:
            warnings.warn(finding.text, stacklevel=3)

        def listen(news: SearchResult | str) -> None:
            text = news if isinstance(news, str) else f"selection cost J = {news.cost:.2f} %, size {len(news.chosen)}"
            progress(f"identifying: {text}", 0.0)

        with one_blas_thread():
            result = identify(given, held_out, how, listen, fitter).require_explained(findings, ignored)
        return replace(cls.of(result.model), evaluations=result.evaluations, search_results=result.search_results)

    def simulate(
        self, given: RecordingInput | ArrayLike, position_m: ArrayLike | None = None, current_A: ArrayLike = 0.0
    ) -> F:
        """Return the force [N] at every position sample (n,), as the observer would; NaN where it would withhold it.

        Either of a recording, or of arrays (n,) of times [s], positions [m] and currents [A], which may be one number.
        """
        if position_m is not None:
            return sample_run(self, Recording.from_arrays(given, position_m, current_A)).force  # type: ignore[arg-type]
        return sample_run(self, _only(as_recordings(given, need=SIGNALS[:2]))).force  # type: ignore[arg-type]

    def predict(self, given: RecordingInput, steps: int = 1) -> F:
        """Return the force [N] at every position sample (n,), predicted `steps` ticks ahead from the measured ones.

        A model without its own past force in it, such as a hydraulic network, predicts what it simulates. NaN where
        `simulate` has none. Raises CesError without a measured force.
        """
        if not isinstance(steps, int) or not 1 <= steps <= MAX_STEPS:
            raise CesError(f"steps: is {steps!r}; expected a whole number of ticks from 1 to {MAX_STEPS}")
        run = sample_run(self, _only(as_recordings(given)))
        force = predict_series(self, run.series, steps)[run.newest]
        return np.where(np.isfinite(run.force), force, np.nan)

    def validate(self, recordings: RecordingInputs) -> Sequence[Evaluation]:
        """Return the free run on each recording with its cost J [%] (`cost`) and RMS error (`rms_N`)."""
        series = [prepare(one, self.sampling) for one in as_recordings(recordings)]
        return Evaluations(evaluate(self, series, VALIDATION))

    def force_speed(self, currents: ArrayLike, speeds: ArrayLike) -> F:
        """Return the force [N] (currents, speeds) at mid-stroke, at the end of a stroke at constant speed and current.

        Raises CesError for speeds [m/s] or currents [A] outside the model's envelope.
        """
        at, v = _as_numbers("currents", currents), _as_numbers("speeds", speeds)
        for name, values, unit in (("current", at, "A"), ("speed", v, "m/s")):
            low, high = self.envelope.by_signal[name]
            if not ((low <= values) & (values <= high)).all():
                raise CesError(
                    f"{name}s: {values.min():g} to {values.max():g} {unit}; the model knows {low:g} to {high:g}"
                )
        return steady_forces(self, at, v)

    def plot(self, given: RecordingInput) -> Any:
        """Return a matplotlib figure: measured and simulated force over time and over speed. Raises CesError."""
        pyplot = _import_pyplot()
        one = _only(as_recordings(given, need=SIGNALS[:2]))
        series = prepare(one, self.sampling)
        run, is_measured = simulate_series(self, series), bool(np.isfinite(series.force).any())
        figure, (over_time, over_speed) = pyplot.subplots(
            1, 2, figsize=(11, 4), width_ratios=(2, 1), sharey=True, layout="constrained"
        )
        for axes, x in ((over_time, series.time_s), (over_speed, series.speed)):
            style = "-" if axes is over_time else "."
            if is_measured:
                axes.plot(x, series.force, style, label="measured", color="0.3", linewidth=1.0, markersize=1.5)
            axes.plot(x, run.force, style, label="simulated", color="C1", linewidth=1.0, markersize=1.5)
            axes.grid(alpha=0.3)
        over_time.set(xlabel="Time [s]", ylabel="Force [N]", title=self._title(one.name, series, run.force))
        over_speed.set(xlabel="Speed [m/s], positive in compression")
        over_time.legend(loc="upper right")
        return figure

    def _title(self, name: str, series: Series, force: F) -> str:
        if not series.scored.any():
            return name
        error = (series.force - force)[series.scored]
        return f"{name}: J = {100.0 * np.sqrt(np.mean(error**2)) / series.force[series.scored].std():.1f} %"

    def report(self, path: PathInput, recordings: RecordingInputs = (), *, title: str = "", note: str = "") -> Path:
        """Write the page about the model on the recordings where it was identified, and on others; return its path."""
        given = as_recordings(recordings, required=False)
        added, days = self.validate(given) if given else [], [one.day for one in given]
        evaluations = [*self.evaluations, *added]
        if not evaluations:
            raise CesError("report: no recording; give some, since the model comes from a file")
        known = [one.get("day", "") for role in (IDENTIFICATION, VALIDATION) for one in self.provenance.get(role, ())]
        head = PageHead(title or f"{self.structure} model", note, recorded=join_days([*known, *days]))
        target = as_path(path, "path")
        write_report(target, head, self, evaluations)
        return target

    def to_frame(self, recordings: RecordingInputs = ()) -> Any:
        """Return the model's parameters as a pandas DataFrame.

        Those of a polynomial have standard errors from the recordings where it was identified, or from those given.
        Raises CesError without pandas.
        """
        pandas = import_pandas()
        used = list(self.evaluations if _is_empty(recordings) else self.validate(recordings))
        used = [e for e in used if e.role == IDENTIFICATION] or used
        if isinstance(self.body, Polynomial):
            errors = standard_errors(self, self.body, used)
            pairs = zip(self.body.terms, errors, strict=True)
            rows = [
                [_plain(format_term(t, self.envelope)), t.coefficient, _plain(coefficient_unit(t)), e] for t, e in pairs
            ]
            return pandas.DataFrame(rows, columns=["Regressor", "Coefficient", "Unit", "Standard error"])
        table = model_section(self, used, IDENTIFICATION).table
        rows = [[_plain(Markup(column.text(row))) for column in table.columns] for row in table.rows]
        return pandas.DataFrame(rows, columns=[_plain(Markup(column.heading)) for column in table.columns])

    def __repr__(self) -> str:
        return self._describe() + (f"\n{cost_table(self.evaluations)}" if self.evaluations else "")

    def _repr_html_(self) -> str:
        table = cost_table(self.evaluations).to_html() if self.evaluations else ""
        return f"<p>{self._describe().replace(chr(10), '<br>')}</p>{table}"

    def _describe(self) -> str:
        proof = "stability not proved" if self.certificate is None else "proved stable"
        knows = "; ".join(
            f"{name} {low:.3g} to {high:.3g} {unit}"
            for (name, (low, high)), unit in zip(self.envelope.by_signal.items(), ("m", "m/s", "A"), strict=True)
        )
        return f"{self.structure}: {describe_size(self)} at {self.sampling.rate_Hz:g} Hz, {proof}\nknows {knows}"


def _as_numbers(name: str, given: ArrayLike) -> F:
    """Return numbers (n,), at least one; raises CesError."""
    try:
        values = np.atleast_1d(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.ndim != 1 or not len(values):
        raise CesError(f"{name}: expected numbers; got {given!r}")
    return values


def _only(recordings: Sequence[recording.Recording]) -> recording.Recording:
    if len(recordings) != 1:
        raise CesError(f"{len(recordings)} recordings given; expected one")
    return recordings[0]


def _is_empty(given: object) -> bool:
    return isinstance(given, list | tuple) and not given


def _plain(cell: Markup) -> str | float:
    """Return a cell of a page as a number if it is one, else as text."""
    text = cell.striptags().replace("\N{MINUS SIGN}", "-")
    try:
        return float(text)
    except ValueError:
        return text


def _import_pyplot() -> Any:
    """Return matplotlib's pyplot; raises CesError that says how to install it."""
    try:
        from matplotlib import pyplot
    except ImportError:
        raise CesError("a plot needs matplotlib: pip install 'ces_observer[notebook]'") from None
    return pyplot
