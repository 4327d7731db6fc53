"""Any simulation over a recording or arrays, as scripts and notebooks run it: its force, and its cost."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from ces_data import recording
from ces_data.arrays import F
from ces_data.checks.check import check_each
from ces_data.checks.content import require_once
from ces_data.checks.units import explain_simulation
from ces_data.findings import warn
from ces_data.logs.frame import is_frame
from ces_data.reading import SIGNALS, RecordingInputs, as_recordings, describe_finding, import_pandas
from ces_identify.comparison.compared_models import align, make_compared_model
from ces_identify.comparison.comparison import ROLES
from ces_identify.limits import ComparisonLimits, TickLimits
from ces_identify.prepare.cost import series_cost
from ces_identify.prepare.series import FreeRun, Series, hold_current
from ces_identify.scripting.recording import Recording
from ces_identify.simulations.simulation import Simulation
from ces_identify.validation.checked import simulate_checked
from ces_identify.validation.cost_table import Evaluations
from ces_identify.validation.evaluate import Evaluation
from ces_observer.errors import CesError

FLAG, CHOSEN = re.compile(r"(?<!\S)--([a-z][a-z-]*)"), re.compile(r"--structure ([a-z]+)")  # options in a text


def simulate(simulation: Simulation, given: Any, position_m: Any, current_A: Any, time_s: Any) -> Any:
    """Return the force [N] at every position sample (n,), NaN where there is none; of a DataFrame, a Series.

    `given` is a recording, or times; with `position_m`, `current_A` or `time_s`, arrays are given. Warns of what
    makes the force of a model doubtful. Raises CesError.
    """
    if position_m is None and current_A is None and time_s is None:
        one = only(as_recordings(given, need=SIGNALS[:2], called="recording"))
    else:
        one = _recording_of(given if time_s is None else time_s, position_m, current_A)
    force, _, texts = simulate_checked(simulation, one)
    warn_all(texts)
    return like(given, one, force)


def validate(simulation: Simulation, recordings: RecordingInputs) -> Evaluations:
    """Return the cost J [%] of a simulation that is no model, on each recording, as a comparison has it."""
    given = as_recordings(recordings)
    require_once(given)
    warn_all(describe_finding(finding.text, given) for finding in check_each(given))
    evaluations = Evaluations([_evaluate(simulation, one) for one in given])
    warn_all(text for evaluation in evaluations for text in (*evaluation.warnings, *_doubts(evaluation)))
    return evaluations


def _doubts(e: Evaluation) -> Iterator[str]:
    """Yield what is wrong with the sign or the unit of a simulated force."""
    if text := explain_simulation(e.series.force[e.series.scored], e.run.force[e.series.scored]):
        yield f"{e.name}: {text}"


def _evaluate(simulation: Simulation, one: recording.Recording) -> Evaluation:
    """Return the evaluation at the position samples, which are the ticks; there is no envelope to leave."""
    compared = make_compared_model(one.name, simulation)
    aligned, stamps = align([compared], one), one.channel("position").stamps_ns
    starts = np.flatnonzero(np.diff(aligned.time_s, prepend=-np.inf) > TickLimits.MIN_GAP_S)
    series = Series(
        name=one.name,
        rate_Hz=aligned.rate_Hz,
        time_s=aligned.time_s,
        position=aligned.position,
        speed=aligned.speed,
        current=hold_current(one, stamps, 1e6),
        force=aligned.measured,
        segments=np.stack([starts, np.append(starts[1:], len(stamps))], axis=1),
        scored=aligned.scored,
        warm_up=round(ComparisonLimits.WARM_UP_S * aligned.rate_Hz),
        dropped={},
    )
    nowhere = np.zeros(len(stamps), bool)
    run = FreeRun(aligned.forces[0], nowhere, nowhere, (-np.inf, np.inf))
    return Evaluation(one.name, ROLES[compared.use_of(one)], series, run, series_cost(series, run.force))


def _recording_of(time_s: Any, position_m: Any, current_A: Any) -> Recording:
    """Return the recording of arrays; raises CesError if one is missing."""
    for name, values in (("time_s", time_s), ("position_m", position_m), ("current_A", current_A)):
        if values is None:
            raise CesError(f"{name}: is missing; expected a recording, or all of time_s, position_m, current_A")
    return Recording.from_arrays(time_s, position_m, current_A)


def like(given: object, recording: recording.Recording, force: F) -> Any:
    """Return the force as a Series with the index of a DataFrame, or as it is."""
    if not is_frame(given):
        return force
    pandas, index = import_pandas(), given.index  # type: ignore[attr-defined]
    if len(force) != len(index):  # rows without a position have no sample
        stamps = recording.channel("position").stamps_ns
        every = np.unique(np.concatenate([channel.stamps_ns for channel in recording.channels.values()]))
        at = np.searchsorted(every, stamps)
        if len(every) == len(index):
            whole = np.full(len(index), np.nan)
            whole[at] = force
            force = whole
        else:
            index = pandas.Index(1e-9 * (stamps - stamps[0]), name="time_s")
    return pandas.Series(force, index=index, name="force_N")


def warn_all(texts: Iterable[str]) -> None:
    """Warn of each; options have the names of keywords."""
    for text in texts:
        warn(FLAG.sub(lambda flag: flag[1].replace("-", "_"), CHOSEN.sub(r'structure="\1"', text)))


def only(recordings: Sequence[recording.Recording]) -> recording.Recording:
    """Return the one recording; raises CesError if there are several."""
    if len(recordings) != 1:
        raise CesError(f"{len(recordings)} recordings given; expected one")
    return recordings[0]
