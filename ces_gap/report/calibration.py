"""The words, the table and the page of a calibration, and its file `calibrated.json`, again a simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

from ces_data.recording import Recording
from ces_gap.augmented import MAX_BYTES, NamedSimulation, has_schema, open_named
from ces_gap.calibrate.calibration import Alternative, Calibration, FittedParameter
from ces_gap.effects.effect import Setting
from ces_gap.errors import GapError
from ces_gap.inference.fit import Estimate
from ces_gap.report.charts import find_largest_errors, speed_force, time_plot
from ces_gap.report.formatting import effect_name, newtons, parameter_text, sentence_case
from ces_gap.report.gap_json import (
    FLAG,
    INTERVAL,
    NUMBER,
    PARAMETERS,
    POSITIVE,
    TEXT,
    by_name,
    format_document,
    itself,
    many,
    or_null,
    to_plain_json,
)
from ces_identify.simulations.simulation import Simulation
from ces_observer import __version__
from ces_observer.fields import Field, Schema
from ces_observer.json_text import parse_json, read_bounded
from ces_observer.records import Of, Record, document_schema, read_document, record_of
from ces_report.shell import PageHead, page_template, replace_unencodable
from ces_report.table import Column, Table, summarize_result
from ces_report.typesetting import format_number, format_within, join_names, join_with, minus

SCHEMA = "ces-calibrated/1"
FILE, REPORT = "calibrated.json", "report.html"


def describe(c: Calibration) -> str:
    """Return what was found, for a user: the values that matter, the gap, what is missing, and what is not known."""
    changed = [p for p in _found(c) if p.matters]
    parts = _describe_changes(c, changed), _describe_missing(c, changed), _describe_alternatives(c), _describe_doubts(c)
    return " ".join(filter(None, parts))


def _found(c: Calibration) -> tuple[FittedParameter, ...]:
    """Return the parameters with the values that the best explanation has, also where the defaults are kept."""
    return (c.missing and c.missing.beside) or c.parameters


def _describe_changes(c: Calibration, changed: Sequence[FittedParameter]) -> str:
    before, after = newtons(c.before_N), newtons(c.after_N)
    if not changed and c.before_N <= c.noise_N:
        return f"No parameter is off: the gap of {before} RMS lies within the noise of {newtons(c.noise_N)}."
    if c.missing and c.missing.beside:
        found = f"{describe_values(changed)}, beside an effect that is missing in the"
        found = found if changed else "No parameter is a part of the best explanation of the"
        kept = f"the fitted values alone leave {newtons(c.missing.alone_N)}, so the defaults are kept"
        return f"{found} gap of {before} RMS; {kept}."
    if not changed:
        if before == after:
            return f"No parameter is surely off: the gap of {before} RMS remains."
        return (
            f"No parameter is a part of the best explanation; fitted, they shrink the gap of {before} to {after} RMS."
        )
    both = {1: "it", 2: "both"}.get(len(changed), "them")
    if beside := [p.name for p in c.parameters if p.is_beside]:
        both += f" and the fitted {join_with(beside)}"
    return (
        f"{describe_values(changed)}. With {both} the gap shrinks from {before} to {after} RMS on held-out recordings."
    )


def describe_values(changed: Sequence[FittedParameter]) -> str:
    """Return the values as `knee_m_s is 0.104, not 0.12 (0.102 to 0.106) and gas_N_m 2990, not 1500 (...)`."""
    return join_with([f"{p.name} {'is ' * (k == 0)}{_value_of(p)}" for k, p in enumerate(changed)])


def _value_of(p: FittedParameter) -> str:
    value, interval = format_within(p.value, *p.ci95)
    if not p.determined:
        return f"{interval}, not {format_default(p)}"
    return f"{value}, not {format_default(p)}" + (f" ({interval})" if p.ci95[0] < p.ci95[1] else "")


def format_default(p: FittedParameter) -> str:
    """Return the default as a user writes it."""
    return minus(f"{p.default:g}")


def _describe_missing(c: Calibration, changed: Sequence[FittedParameter]) -> str:
    if c.missing is None:
        return ""
    beside = "beside them" if len(changed) > 1 else "beside it" if changed else "in the simulation"
    what = sentence_case(describe_setting(c.missing.setting))
    return f"{what} is missing {beside}: with it {newtons(c.missing.gap_after_N)} are left."


def _describe_alternatives(c: Calibration) -> str:
    """Return what would explain the gap as well in place of the best explanation."""
    texts = [describe_alternative(alternative) for alternative in c.alternatives]
    return f"As much would be explained by {'; or by '.join(texts)}." if texts else ""


def describe_alternative(alternative: Alternative) -> str:
    """Return other values of parameters, and an effect, as `seal_N of 43 instead of 25 and friction of 20 N`."""
    values = [f"{p.name} of {format_number(p.value)} instead of {format_default(p)}" for p in alternative.parameters]
    effects = [] if alternative.effect is None else [describe_setting(alternative.effect)]
    return join_with([*values, *effects])


def describe_setting(setting: Setting) -> str:
    """Return an effect with its magnitude if it has one, as `friction of 20 N`."""
    pairs = zip(setting.effect.parameters, setting.values, strict=True)
    sizes = [parameter_text(Estimate(p.name, value, (value, value))) for p, value in pairs if p.magnitude]
    size = f" of {sizes[0][1]} {sizes[0][2]}".rstrip() if sizes else ""
    return effect_name(setting.name) + size


def _describe_doubts(c: Calibration) -> str:
    """Return sentences about the parameters that are not determined, and those that are found where they cannot be."""
    others = "" if len(c.parameters) == 1 else " beside the others"
    others = others if c.missing is None else f" beside {effect_name(c.missing.setting.name)}"
    texts = []
    for p in (p for p in _found(c) if not p.determined and p.value == p.default):
        near = next((group[1:] for group in c.moves_with if group[0] == p.name), ())
        why = f"it moves with {join_with(near)}" if near else f"it hardly shows here{others}"
        texts.append(f"{p.name} cannot be determined: {why}; it is held at its default.")
    return " ".join([*texts, *describe_doubtful([p for p in _found(c) if p.matters])])


def describe_doubtful(parameters: Sequence[FittedParameter]) -> list[str]:
    """Return a sentence on the values at the end of their range or far from their defaults; none without them."""
    doubtful = [p.name for p in parameters if p.is_doubtful]
    where = f"{join_with(doubtful)} {'lies' if len(doubtful) == 1 else 'lie'} at the end of the range or far from the"
    return [f"{where} default: rather a sign that the simulation lacks something than a value."] * bool(doubtful)


def _remark(p: FittedParameter) -> str:
    if not p.determined:
        return f"not determined, {'at the end of its range' if p.at_bound else 'held at its default'}"
    if p.is_doubtful:
        return "far from its default"
    return "" if p.matters else "changed, too" if p.is_beside else "no change needed"


COLUMNS: tuple[Column[FittedParameter], ...] = (
    Column("Parameter", lambda p: f"{p.name} [{p.unit}]" if p.unit else p.name),
    Column("Default", format_default, figure=True),
    Column("Value", lambda p: format_within(p.value, *p.ci95)[0], figure=True),
    Column("95\N{NO-BREAK SPACE}% interval", lambda p: format_within(p.value, *p.ci95)[1], figure=True),
    Column("Remark", _remark),
)


def parameter_table(c: Calibration) -> Table[FittedParameter]:
    """Return the parameters, those that matter first."""
    rows = sorted(_found(c), key=lambda p: not p.matters)
    if not (c.missing and c.missing.beside):
        return Table(COLUMNS, rows, "parameters of the simulation")
    beside = f"beside {effect_name(c.missing.setting.name)}"
    columns = [replace(one, heading=f"Value {beside}") if one.heading == "Value" else one for one in COLUMNS]
    return Table(columns, rows, f"parameters of the simulation {beside}; the defaults are kept")


@summarize_result.register
def _(calibration: Calibration) -> tuple[Sequence[str], Table[FittedParameter]]:
    return [describe(calibration), *calibration.notes], parameter_table(calibration)


def calibration_page(c: Calibration, head: PageHead) -> str:
    """Return the page as text that is both HTML and well-formed XML."""
    worst = find_largest_errors(c.held_out)
    page = page_template("calibration.html.j2", __package__, ("gap.css",)).render(
        head=head,
        c=c,
        sentence=describe(c),
        table=parameter_table(c),
        groups=[join_with(group) for group in c.moves_with],
        plots=speed_force("sf", c.held_out, "the fitted parameters"),
        time=time_plot("worst", worst, "the fitted parameters") if worst else None,
        worst=worst.series.trace.name if worst else "",
        facts={"Simulation": c.spec},
    )
    return replace_unencodable(page)


FITTED = record_of(value=Field(kind=float), ci95=INTERVAL, default=NUMBER, determined=FLAG, at_bound=FLAG, matters=FLAG)
GAP = record_of(
    before_N=POSITIVE.about("on held-out recordings, the noise subtracted"),
    after_N=POSITIVE,
    noise_floor_N=(POSITIVE, "noise_N"),
)
MISSING = record_of(
    effect=(TEXT, "setting.name"),
    form=(TEXT, "setting.effect.form"),
    parameters=(PARAMETERS, lambda missing: {one.name: one for one in missing.estimates}),
    gap_after_N=POSITIVE,
    beside=(
        replace(by_name(FITTED), default={}, optional=True).about(
            "the values beside the effect; alone they leave more, so the parameters keep their defaults"
        ),
        lambda missing: {p.name: p for p in missing.beside},
    ),
    alone_N=(
        replace(POSITIVE, default=None, optional=True).about("the gap that these values leave alone"),
        lambda missing: missing.alone_N if missing.beside else None,
    ),
)
CONTENT: Mapping[str, Field | tuple[Field, Of]] = {
    "parameters": (by_name(FITTED), lambda c: {p.name: p for p in c.parameters}),
    "moves_with": many(many(TEXT, 2)).about("parameters whose changes look alike on these recordings"),
    "gap": (GAP, itself),
    "alternatives": (
        many(TEXT).about("what would explain the gap as well"),
        lambda c: list(map(describe_alternative, c.alternatives)),
    ),
    "missing": or_null(MISSING).about(
        "the effect that explains most beside the parameters; null if none is worthwhile"
    ),
    "sentence": (TEXT, describe),
    "notes": many(TEXT),
}
DOCUMENT = record_of(simulation=Field(kind=Record(NamedSimulation)), **CONTENT, provenance=Field(kind=Mapping))


def calibrated_schema() -> Schema:
    """Return the JSON Schema of `calibrated.json`."""
    return document_schema(DOCUMENT, SCHEMA)


def calibration_content(c: Calibration) -> dict[str, Any]:
    """Return what `calibrated.json` says beside the simulation and the provenance, its numbers as computed."""
    content: dict[str, Any] = record_of(**CONTENT).write(c)
    return content


def calibration_files(
    c: Calibration,
    sim: Mapping[str, str | None],
    sources: Mapping[str, Sequence[Recording]],
    head: PageHead,
) -> dict[str, str]:
    """Return the texts of `calibrated.json` and `report.html`; `sim` comes from `name_simulation`."""
    used = {
        role: [{"recording": r.name, "sha256": r.sha256} for r in recordings] for role, recordings in sources.items()
    }
    provenance = {"tool": f"ces_observer {__version__}", **used}
    document = {"schema": SCHEMA, "simulation": dict(sim), **calibration_content(c), "provenance": provenance}
    real = join_names([r.name for recordings in sources.values() for r in recordings])
    page = calibration_page(c, head.titled(f"Parameters of {PurePath(c.spec).name} from {real}"))
    return {FILE: format_document(to_plain_json(document, FILE)), REPORT: page}


def is_calibrated(path: Path) -> bool:
    """Return whether the file is that of a calibrated simulation."""
    return has_schema(path, "ces-calibrated")


def load_calibrated(path: Path, open_simulation: Callable[[str], Simulation]) -> Simulation:
    """Return the simulation that the file names, with its values; `open_simulation` opens it. Raises CesError."""
    values = parse_json(read_bounded(path, MAX_BYTES), str(path))
    file = read_document(DOCUMENT, values, str(path), SCHEMA, "run `ces calibrate` again", GapError)
    simulation = open_named(path, file["simulation"], open_simulation, "calibrate")
    fitted = {name: parameter["value"] for name, parameter in file["parameters"].items()}
    if unknown := set(fitted) - {p.name for p in simulation.parameters}:
        raise GapError(f"{path}: {file['simulation'].spec} has no parameter {join_with(sorted(unknown))} now")
    return simulation.with_values(fitted)
