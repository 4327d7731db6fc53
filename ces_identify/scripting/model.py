"""A model as scripts and notebooks use it: simulate, predict, draw, report, and the table of its parameters."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike

from ces_data import recording
from ces_data.arrays import F
from ces_data.checks.check import check_each, check_together, require_sound
from ces_data.checks.content import require_distinct, require_once, select_new
from ces_data.findings import Finding, warn
from ces_data.outputs import REPORT, require_model_name, require_outputs
from ces_data.reading import (
    SIGNALS,
    PathInput,
    RecordingInput,
    RecordingInputs,
    as_path,
    as_recordings,
    describe_finding,
    import_pandas,
    import_pyplot,
)
from ces_data.recording import join_days
from ces_identify.identification import identify
from ces_identify.limits import MisfitLimits
from ces_identify.numerics.least_squares import one_blas_thread
from ces_identify.numerics.search import SearchResult
from ces_identify.options import IdentifyRequest
from ces_identify.physical.quantities import curve_speeds
from ces_identify.prepare.series import Series, prepare
from ces_identify.report.page import write_report
from ces_identify.report.steady import CURVE_SPEEDS, recorded_currents, steady_forces
from ces_identify.scripting.progress import Progress
from ces_identify.scripting.search_results import SearchResults
from ces_identify.scripting.simulating import like, only, simulate, warn_all
from ces_identify.simulations.simulate import (
    force_at_samples,
    is_outside,
    predict_series,
    sample_run,
    simulate_series,
)
from ces_identify.simulations.simulation import ModelSimulation
from ces_identify.structures import model_section
from ces_identify.structures.hydraulic import FoundQuantity, explain_missing_errors, list_quantities
from ces_identify.structures.polynomial import coefficient_unit, format_term
from ces_identify.validation.band import band_half_width
from ces_identify.validation.checked import evaluate_checked, warnings_on
from ces_identify.validation.cost_table import Evaluations, KnownCosts
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, Evaluation, describe_size
from ces_identify.validation.lacks import describe_gap, head_lines
from ces_identify.validation.standard_errors import standard_errors
from ces_observer import model
from ces_observer.errors import CesError, Suggesting
from ces_observer.records import in_files
from ces_observer.structures.hydraulic import Hydraulic
from ces_observer.structures.polynomial import Polynomial
from ces_report.shell import PageHead
from ces_report.typesetting import UNITS, format_alike, join_with

MAX_BEYOND = 0.01  # of the span that a model knows: a rounded number counts as the end of it


SHOWN = (
    "band", "certificate", "envelope", "evaluations", "force_speed", "load", "plot", "predict", "provenance", "report",
    "sampling", "save", "search_results", "simulate", "size", "structure", "to_frame", "validate", "warm_up_s",
)  # fmt: skip  # what docs/api.md says, and plain facts; the rest is the runtime's


OF_COSTS = ("J", "cost", "costs", "coverage", "error", "fit_percent", "interval", "residuals", "rms_N")


@dataclass(frozen=True, repr=False)
class Model(Suggesting, model.Model):
    """A force model with what can be done with it.

    Recordings are paths of bags and logs, DataFrames, mappings of arrays, or `Recording` objects.

        model = ces.identify("rig/noise", structure="auto")
        force_N = model.simulate(time_s, position_m, 0.5)
        model.report("report.html", "rig/road")
    """

    evaluated: Evaluations = field(default=Evaluations(), metadata=in_files(None), compare=False)
    search_results: SearchResults = field(default=SearchResults(), metadata=in_files(None), compare=False)
    recorded: tuple[recording.Recording, ...] = field(default=(), metadata=in_files(None), compare=False)

    def __new__(cls, *args: Any, **fields: Any) -> Self:
        """Return a new one; raises CesError for a path alone."""
        if len(args) + len(fields) == 1 and args:
            raise CesError("a Model is read by Model.load(path), or made by ces.identify(recordings)")
        return super().__new__(cls)

    def __hash__(self) -> int:
        return hash(self.to_json())

    @property
    def evaluations(self) -> Evaluations | KnownCosts:
        """The free runs of the identification with their costs; of a model from a file, the costs that it names."""
        return self.evaluated or KnownCosts.of(self)

    def __dir__(self) -> list[str]:
        return [*SHOWN, *(name for name in super().__dir__() if name.startswith("_"))]

    def _suggest(self, name: str) -> str:
        if name in OF_COSTS:
            return "; model.evaluations has it for each recording of the identification, model.validate(...) for others"
        return super()._suggest(name)

    @classmethod
    def load(cls, path: PathInput) -> Model:
        """Read a model file. Raises CesError."""
        return as_model(path)

    def simulate(
        self,
        recording: RecordingInput | ArrayLike | None = None,
        position_m: ArrayLike | None = None,
        current_A: ArrayLike | None = None,
        *,
        time_s: ArrayLike | None = None,
    ) -> Any:
        """Return the force [N] at every position sample (n,), as the observer would; NaN where it would withhold it.

        `simulate(recording)`, or `simulate(time_s, position_m, current_A)` of arrays (n,), of which all but the times
        may be one number. A DataFrame's force is a Series with its index. Warns of inputs outside `envelope`, which
        are clamped.
        """
        return simulate(ModelSimulation(self), recording, position_m, current_A, time_s)

    def predict(self, recording: RecordingInput, steps: int = 1) -> Any:
        """Return the force [N] at every position sample (n,), predicted `steps` ticks ahead from the measured ones.

        A model without its own past force in it, such as a hydraulic network, predicts what it simulates, as does a
        prediction over more ticks than a stretch has, and each after ticks without a measured force. NaN where
        `simulate` has none; a DataFrame's force is a Series with its index. Raises CesError without a measured force.
        """
        if not isinstance(steps, int | np.integer) or steps < 1:
            raise CesError(f"steps: is {steps!r}; expected a whole number of ticks, at least 1")
        given = only(as_recordings(recording, called="recording"))
        run = sample_run(self, given)
        warn_all(warnings_on(run, given.name))
        if steps >= (longest := int(np.diff(run.series.segments).max())):
            warn(f"steps: {steps} ticks are longer than any stretch of {given.name} ({longest} ticks): it is simulated")
            return like(recording, given, run.force)
        predicted = predict_series(self, run.series, int(steps))
        if np.array_equal(predicted, run.run.force, equal_nan=True):
            warn(f"steps: '{self.structure}' has no past force in it: what it predicts is what it simulates")
        elif (share := float(np.isnan(run.series.force).mean())) > MisfitLimits.MAX_OUTSIDE:
            warn(f"{given.name}: no force was measured for {share:.1%} of the time: there it is simulated")
        force = force_at_samples(predicted, run.newest, run.ahead, self.force_envelope_N)
        return like(recording, given, np.where(np.isfinite(run.force), force, np.nan))

    def validate(self, recordings: RecordingInputs) -> Evaluations:
        """Return the free run on each recording with its cost J [%] (`cost`) and RMS error (`rms_N`).

        Warns of what `ces validate` warns of: recordings that look wrong, or that the model was identified on, inputs
        and forces outside its envelopes, and what the error depends on.
        """
        evaluations, findings = self._evaluate(given := as_recordings(recordings))
        warn_all(dict.fromkeys(describe_finding(finding.text, given) for finding in findings))
        warn_all([*(text for e in evaluations for text in e.warnings), *head_lines(self, evaluations)])
        return evaluations

    def _evaluate(self, given: Sequence[recording.Recording]) -> tuple[Evaluations, list[Finding]]:
        require_once(given)
        findings = list(check_each(given))
        evaluations = list[Evaluation]()
        for one in given:
            evaluation, added = evaluate_checked(self, one, findings)
            evaluations.append(evaluation)
            findings += added
        return Evaluations(evaluations), findings

    def force_speed(self, currents: ArrayLike | None = None, speeds: ArrayLike | None = None) -> Any:
        """Return steady forces [N] at mid-stroke as a DataFrame: a row for each speed [m/s], a column for each current.

        Each is the force at the end of a stroke at constant speed and current [A]; by default those of the page, with
        four currents between those recorded. A speed or current outside `envelope` by up to 1 % of its span counts as
        the end of it, with a warning. Raises CesError for others, and without pandas.
        """
        pandas, (slow, fast) = import_pandas(), self.envelope.speed_m_s
        default_speeds = np.clip(curve_speeds(slow, fast, CURVE_SPEEDS), slow, fast)
        at = self._within("current", recorded_currents(self) if currents is None else currents, "A")
        v = self._within("speed", default_speeds if speeds is None else speeds, "m/s")
        index, columns = pandas.Index(v, name="speed_m_s"), pandas.Index(at, name="current_A")
        return pandas.DataFrame(steady_forces(self, at, v).T, index=index, columns=columns)

    def _within(self, name: str, given: ArrayLike, unit: str) -> F:
        """Return numbers (n,) within the envelope of a signal; raises CesError."""
        values, (low, high) = _as_numbers(f"{name}s", given), self.envelope.by_signal[name]
        inside = np.clip(values, low, high)
        if not (np.abs(values - inside) <= MAX_BEYOND * (high - low)).all():
            text = (
                f"{name}s: {' to '.join(dict.fromkeys((f'{values.min():g}', f'{values.max():g}')))} {unit}; the model "
                f"knows {low:g} to {high:g} (envelope); give others, or record more"
            )
            raise CesError(text)
        for value, end in dict(zip(values[values != inside], inside[values != inside], strict=True)).items():
            warn(f"{name} {value:g} {unit} is outside what the model knows; {end:g} {unit} is taken")
        if name in self.used_ranges and (unknown := inside[is_outside(self, name, inside)]).size:
            warn(f"{name}s {', '.join(f'{value:g}' for value in unknown[:3])} {unit}: {describe_gap(self)}")
        return inside

    def plot(self, recording: RecordingInput) -> Any:
        """Return a matplotlib figure: measured and simulated force, with the band, over time and over speed.

        Times with inputs outside `envelope` are shaded. Raises CesError.
        """
        pyplot = import_pyplot()
        one = only(as_recordings(recording, need=SIGNALS[:2], called="recording"))
        series = prepare(one, self.sampling)
        run, is_measured = simulate_series(self, series), bool(np.isfinite(series.force).any())
        force = _without_warm_up(run.force, series)
        figure, (over_time, over_speed) = pyplot.subplots(
            1, 2, figsize=(11, 4), width_ratios=(2, 1), sharey=True, layout="constrained"
        )
        for axes, x in ((over_time, series.time_s), (over_speed, series.speed)):
            style = "-" if axes is over_time else "."
            if is_measured:
                axes.plot(x, series.force, style, label="measured", color="0.3", linewidth=1.0, markersize=1.5)
            axes.plot(x, force, style, label="simulated", color="C1", linewidth=1.0, markersize=1.5)
            axes.grid(alpha=0.3)
        if self.band is not None:
            half = band_half_width(self.band, series, run.force, self.used_gap_A)
            low, high, name = force - half, force + half, f"band ({100 * self.band.level:.0f} %)"
            over_time.fill_between(series.time_s, low, high, color="C1", alpha=0.25, linewidth=0.0, label=name)
        if run.clamped.any():
            ends, whole = over_time.get_xaxis_transform(), {"color": "0.5", "alpha": 0.2, "linewidth": 0.0}
            where = {"where": run.clamped, "transform": ends, "label": "outside the envelope"}
            over_time.fill_between(series.time_s, 0.0, 1.0, **where, **whole)
        over_time.set(
            xlabel="Time [s]",
            ylabel="Force [N], positive in compression",
            title=self._title(one.name, series, run.force),
        )
        over_speed.set(xlabel="Speed [m/s], positive in compression")
        over_time.legend(loc="upper right")
        return figure

    def _title(self, name: str, series: Series, force: F) -> str:
        if not series.scored.any():
            return name
        error = (series.force - force)[series.scored]
        return f"{name}: J = {100.0 * np.sqrt(np.mean(error**2)) / series.force[series.scored].std():.1f} %"

    def save(self, path: PathInput, *, overwrite: bool = False) -> None:
        """Write the model file. Raises CesError, also for one that exists, unless `overwrite`."""
        require_model_name(target := as_path(path, "path"))
        require_outputs(overwrite, {"model": target})
        super().save(target)

    def report(
        self,
        path: PathInput,
        recordings: RecordingInputs = (),
        *,
        title: str = "",
        note: str = "",
        overwrite: bool = False,
    ) -> Path:
        """Write the page about the model on the recordings where it was identified, and on others; return its path.

        Those of the identification are on it once, also if they are given. Raises CesError for others that have seconds
        of them, and for a file that exists, unless `overwrite`.
        """
        require_outputs(overwrite, {REPORT: (target := as_path(path, "path"))})
        given = select_new(as_recordings(recordings, required=False), self.recorded)
        added, days = self.validate(given) if given else [], [one.day for one in given]
        evaluations = [*self.evaluated, *added]
        if not evaluations:
            raise CesError("report: no recording; give some, since the model comes from a file")
        known = [one.get("day", "") for role in (IDENTIFICATION, VALIDATION) for one in self.provenance.get(role, ())]
        head = PageHead(title or f"{self.structure} model", note, recorded=join_days([*known, *days]))
        write_report(target, head, self, evaluations)
        return target

    def to_frame(self, recordings: RecordingInputs = ()) -> Any:
        """Return the model's parameters as a pandas DataFrame.

        Those of a polynomial have standard errors from the recordings where it was identified, or from those given;
        those of a hydraulic network are NaN if the identification found none. Raises CesError without pandas.
        """
        pandas = import_pandas()
        used = list(self.evaluated if _is_empty(recordings) else self._evaluate(as_recordings(recordings))[0])
        used = [e for e in used if e.role == IDENTIFICATION] or used
        if isinstance(self.body, Polynomial):
            errors = standard_errors(self, self.body, used)
            pairs = zip(self.body.terms, errors, strict=True)
            rows = [
                [_plain(format_term(t, self.envelope)), t.coefficient, _plain(coefficient_unit(t)), e] for t, e in pairs
            ]
            return pandas.DataFrame(rows, columns=["regressor", "coefficient", "unit", "standard_error"])
        if isinstance(self.body, Hydraulic):
            warn_all(filter(None, [explain_missing_errors(self)]))
            return pandas.DataFrame(list_quantities(self.body, self), columns=FoundQuantity._fields)
        table = model_section(self, used, IDENTIFICATION).table
        rows = [[_plain(Markup(column.text(row))) for column in table.columns] for row in table.rows]
        return pandas.DataFrame(rows, columns=[_snake(_plain(Markup(column.heading))) for column in table.columns])

    def __repr__(self) -> str:
        return self._describe() + (f"\n{costs}" if (costs := self.evaluations) else "")

    def _repr_html_(self) -> str:
        costs = self.evaluations._repr_html_() if self.evaluations else ""
        return f"<p>{self._describe().replace(chr(10), '<br>')}</p>{costs}"

    def _describe(self) -> str:
        proof = "stability not proved" if self.certificate is None else "proved stable"
        knows = "; ".join(
            f"{name} {' to '.join(format_alike(ends, 3))} {UNITS[name]}{self.envelope.gap_text * (name == 'current')}"
            for name, ends in self.used_ranges.items()
        )
        others = [name for name in self.envelope.by_signal if name not in self.used_ranges]
        knows += f"; {join_with(others)} not used" if others else ""
        size = f"{self.structure}: {describe_size(self)} at {self.sampling.rate_Hz:g} Hz, {proof}"
        return f"{size}; force positive in compression\nknows {knows}"


def _without_warm_up(force: F, series: Series) -> F:
    """Return a force [N] on ticks (n,), NaN in the warm-up of each stretch, where the vehicle has none."""
    shown = force.copy()
    for start, stop in series.segments:
        shown[start : min(start + series.warm_up, stop)] = np.nan
    return shown


def _as_numbers(name: str, given: ArrayLike) -> F:
    """Return numbers (n,), at least one; raises CesError."""
    values = np.atleast_1d(np.asarray(given))
    values = values.astype(np.float64) if values.dtype.kind in "iuf" else np.empty(0)
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise CesError(f"{name}: expected numbers; got {given!r}")
    return values


def as_model(given: object) -> Model:
    """Return a model, or that in a file, with the methods of scripts. Raises CesError for anything else."""
    if isinstance(given, Model):
        return given
    plain = given if isinstance(given, model.Model) else model.load_model(as_path(given, "model"))  # type: ignore[arg-type]
    return Model(**{f.name: getattr(plain, f.name) for f in fields(model.Model)})


def identify_model(
    request: IdentifyRequest,
    given: Sequence[recording.Recording],
    held_out: Sequence[recording.Recording],
    progress: Progress = lambda step, share: None,
) -> Model:
    """Return the model that is asked for, identified on recordings that would make no wrong one.

    Warns of what looks wrong; raises CesError for what is, unless the request ignores it.
    """
    how, fitter, ignored = request.options(), request.fitter(), request.ignore_findings
    require_distinct(given, held_out)
    findings = check_together([*given, *held_out])
    findings = tuple(replace(f, text=describe_finding(f.text, [*given, *held_out])) for f in findings)
    require_sound(findings, ignored)
    warn_all(finding.text for finding in findings)

    def listen(news: SearchResult | str) -> None:
        text = news if isinstance(news, str) else f"selection cost J = {news.cost:.2f} %, size {len(news.chosen)}"
        progress(f"identifying: {text}", 0.0)

    with one_blas_thread():
        result = identify(given, held_out, how, listen, fitter).require_explained(findings, ignored)
    warn_all(text for evaluation in result.evaluations for text in evaluation.warnings)
    warn_all(head_lines(result.model, result.evaluations))
    starts = SearchResults(result.search_results)
    used, evaluated = (*given, *held_out), Evaluations(result.evaluations)
    return replace(as_model(result.model), evaluated=evaluated, search_results=starts, recorded=used)


def _is_empty(given: object) -> bool:
    return isinstance(given, list | tuple) and not given


def _plain(cell: Markup) -> str | float:
    """Return a cell of a page as a number if it is one, else as text."""
    text = Markup(cell.replace("<sup>", "^")).striptags().replace("\N{MINUS SIGN}", "-")
    try:
        return float(text)
    except ValueError:
        return text


def _snake(heading: str | float) -> str:
    """Return the heading of a table as the name of a column: `Standard error [N]` is `standard_error_N`."""
    words = re.sub(r"\[(.*)\]", r"\1", str(heading)).replace("%", "percent").split()
    return "_".join(word if k and word[:1].isupper() else word.lower() for k, word in enumerate(words))
