"""The sentences of a diagnosis: each verdict in one, none contradicts another, numbers add up as they are rounded."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from io import StringIO
from typing import Any

import numpy as np
import pytest
from diagnoses import named, pair
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from ces_cli.diagnose.diagnosis import print_diagnosis
from ces_cli.terminal import terminal
from ces_gap.baseline.learner import LearnedCorrection
from ces_gap.baseline.wrappers import InputTiming
from ces_gap.diagnosis import AMBIGUOUS, NAMED, NO_GAP, UNKNOWN, Diagnosis, find_closest
from ces_gap.effects.effect import Composition, Setting
from ces_gap.effects.simulation_errors import SpeedCurve
from ces_gap.inference.explanation import share_probabilities
from ces_gap.inference.judgement import TIMING, Doubt, Within
from ces_gap.inference.rare import RareDeviation
from ces_gap.inputs.probe_result import HELD, SimulationProbe
from ces_gap.report.formatting import join_effect_names
from ces_gap.report.gap_json import gap_content
from ces_gap.report.page import build_gap_steps, report_page
from ces_gap.report.sentences import describe_rare, describe_timing, format_verdict
from ces_gap.report.tables import cause_table

RARE = RareDeviation(80.0, 20.0, "road", 12.34, 0.03, 0.031, 0.2, 0.6)
LATE = SimulationProbe(HELD, 0.0, 1e-3, (0.0012, 0.0013), calls=5, corrected=InputTiming(0.0, 0.0012))
LEARNED = object.__new__(LearnedCorrection)  # only that there is one matters
FORCES = st.floats(1e-3, 5e3)


@st.composite
def diagnoses(draw: st.DrawFn) -> Diagnosis:
    """Return a diagnosis of any numbers that the stages before could have found."""
    base, shares = draw(st.sampled_from([named(), pair()])), st.floats(0.0, 1.0)
    before_N, verdict = draw(FORCES), draw(st.sampled_from([NAMED, AMBIGUOUS, UNKNOWN, NO_GAP]))
    referenced, late = draw(st.booleans()), draw(st.booleans())
    corrected_N = before_N * draw(st.floats(0.001, 1.3)) if referenced or late else before_N
    gap = replace(base.gap, rms_N=before_N, corrected_N=corrected_N, noise_floor_N=draw(FORCES))
    narrow = {"ci95_N": before_N, "corrected_ci95_N": corrected_N}
    gap = replace(gap, **{name: (0.998 * force_N, 1.002 * force_N) for name, force_N in narrow.items()})
    gap = replace(gap, noise_in_band_N=gap.noise_floor_N * draw(shares))
    closed = [draw(st.floats(0.0, 0.999)) for _ in range(len(base.causes) + 1)]
    weights = np.array([draw(shares) + 1e-6 for _ in range(len(base.causes) + 2)])
    odds = (weights / weights.sum()).tolist()
    causes = [
        replace(c, gap_after_N=(1.0 - share) * corrected_N, shrink=share, shrink_ci95=(share, share), probability=p)
        for c, share, p in zip(base.causes, closed[1:], odds[2:], strict=True)
    ]
    together, first = base.composition, closed[0]
    together = replace(together, gap_after_N=(1.0 - first) * corrected_N, shrink=first, shrink_ci95=(first, first))
    if verdict == NO_GAP:
        together = replace(together, effects=(), forms=(), estimates=(), without_N=(), shrink=0.0)
    return replace(
        base,
        verdict=verdict,
        gap=gap,
        causes=tuple(sorted(causes, key=lambda c: -c.probability)),
        composition=together,
        doubt=draw(st.sampled_from([Doubt.SIMULATION_ERROR, Doubt.REMAINS, Doubt.LEAVES_MORE, Doubt.UNCERTAIN]))
        if verdict == AMBIGUOUS
        else "",
        no_gap_reason=draw(st.sampled_from([Within.BASELINE_ERROR, Within.NOISE, Within.TOLERANCE])),
        ceiling_after_N=corrected_N * draw(st.floats(0.0, 1.5)),
        correction=LEARNED if referenced else None,
        probe=LATE if late else base.probe,
        rare=draw(st.sampled_from([None, RARE])) if verdict != NO_GAP else None,
        probability_none=odds[0],
        probability_unknown=odds[1],
        next_experiment=None,
        by_region=(),
        timed_N=corrected_N,
        held_out=(),
    )


def sentences(d: Diagnosis) -> str:
    return format_verdict(d) + describe_rare(d) + describe_timing(d)


def said(text: str) -> float:
    """Return a number as a reader takes it."""
    return float(re.sub(r"[\u202f ]", "", text).replace("\u2212", "-"))


NUMBER = r"([\d.\u202f]+)"


def contradictions(d: Diagnosis, text: str) -> Iterator[str]:
    """Yield what a reader of the texts would object to."""
    for part, whole in re.findall(rf"(?:all but|corrected,) {NUMBER} N of (?:the )?{NUMBER} N", text):
        if said(part) >= said(whole):
            yield f"all but {part} of {whole}"
    for before, after in re.findall(rf"shrinks from {NUMBER} N to {NUMBER} N", text):
        if said(after) >= said(before):
            yield f"shrinks from {before} to {after}"
    if d.correction is not None and re.search("ecord references|and references", text):
        yield "asks for references that were given"
    closest = find_closest(d)
    for names in re.findall(r"the closest, ([^,;]*), leaves", text):
        shown = [bar.label for bar in build_gap_steps(d).steps if bar.css.startswith("after")]
        if closest is None or shown != [f"With {' and '.join(e.replace('_', ' ') for e in closest.effects)}"]:
            yield f"the closest, {names}, and {shown}"


@given(diagnoses())
@settings(max_examples=100, deadline=None, derandomize=True)
def test_no_sentence_contradicts_another(d: Diagnosis) -> None:
    d = replace(d, sentence=sentences(d))
    page = re.sub(r"<svg.*?</svg>|<[^>]*>", " ", report_page(d), flags=re.DOTALL)
    text = f"{d.sentence} {page}"
    assert list(contradictions(d, text)) == [], text
    steps = {bar.css.split()[0]: bar for bar in build_gap_steps(d).steps}
    if "after" in steps and (share := re.search(r"closes (\d+)", steps["after"].remark)):
        base = said(steps["corrected" if "corrected" in steps else "before"].value)
        told, rounding_N = base * (1.0 - 0.01 * float(share[1])), 0.01 * base + 0.01
        assert said(steps["after"].value) == pytest.approx(told, abs=rounding_N)


@given(diagnoses())
@settings(max_examples=300, deadline=None, derandomize=True)
def test_print_frame_and_file_say_the_same(d: Diagnosis) -> None:
    causes, together = share_probabilities({c.effects[0]: c.probability for c in d.causes}, d.causes, d.composition)
    d = replace(d, causes=causes, composition=together)
    frame, rows = pytest.importorskip("pandas") and d.to_frame(), cause_table(d).rows
    assert [row.effect for row in rows] == [join_effect_names(names.split(" + ")) for names in frame["effect"]]
    assert [100.0 * row.probability for row in rows] == pytest.approx([*frame["probability_percent"]])
    shrinks = [100.0 * row.cause.shrink if row.cause else np.nan for row in rows]
    assert shrinks == pytest.approx([*frame["shrink_percent"]], nan_ok=True)
    document = gap_content(d)
    apart = [c["probability"] for c in document["causes"] if c["effect"] not in together.effects]
    assert sum((*apart, together.probability, *document["probabilities"].values())) == pytest.approx(1.0)
    assert {c.probability for c in causes if c.effects[0] in together.effects} <= {together.probability}


def test_what_users_objected_to() -> None:
    """Sentences that stood in reports, each of which contradicted itself."""
    d = replace(named(), correction=LEARNED)
    assert repr(d.gap) == "<Gap of 40 N RMS (37.6 to 42.6), J 5.31 %>"
    gap = replace(d.gap, rms_N=9.04, corrected_N=8.98)
    alike = replace(d, verdict=NO_GAP, no_gap_reason=Within.BASELINE_ERROR, gap=gap, held_out=())
    assert "all but 9 N of the 9 N" not in format_verdict(alike) and "9 N RMS are left" in format_verdict(alike)
    enlarged = replace(d, correction=None, gap=replace(d.gap, rms_N=68.6, corrected_N=69.6), probe=LATE)
    assert "lie beyond" not in describe_timing(enlarged) and "69.6" not in describe_timing(enlarged)
    late = replace(enlarged, gap=replace(d.gap, rms_N=14.9, corrected_N=0.176))
    assert "(position 1.2 ms late) is a cause, too: corrected, 0.176 N of 14.9 N RMS are left." in describe_timing(late)
    smoothed = replace(d.composition, effects=(TIMING,))
    assert "caused by the simulation's timing" in format_verdict(replace(d, composition=smoothed))
    worse = replace(pair(), verdict=AMBIGUOUS, composition=replace(pair().composition, gap_after_N=40.0))
    assert "grows from 36.1 N to 40 N" in format_verdict(worse) and "shrinks" not in format_verdict(worse)
    assert "80 N over 30 ms at 12.34 s of road (stroke 31 mm" in describe_rare(replace(d, rare=RARE))
    never = replace(d, verdict=AMBIGUOUS, doubt=Doubt.ALTERNATIVES, alternatives=("valve_lag",), next_experiment=None)
    assert "references that are free" not in report_page(never)
    assert "references that are free" in report_page(replace(never, correction=None))


def test_fewer_effects_that_leave_less_are_named() -> None:
    """Four effects left 129 N where one of them alone left 94.6 N, which only the table said."""
    doubtful = replace(pair(), verdict=AMBIGUOUS, doubt=Doubt.NOT_CONFIRMED)
    four = replace(doubtful, composition=replace(pair().composition, gap_after_N=20.0, without_N=(28.0, 3.0)))
    assert format_verdict(doubtful).endswith(" to 1.2 N RMS.")
    assert format_verdict(four).endswith(
        " to 20 N RMS, but fewer effects leave less on held-out recordings: those without valve lag 3 N."
    )
    alone = replace(four, composition=replace(four.composition, without_N=()))
    assert format_verdict(alone).endswith(": friction alone 4.5 N.")


def test_the_terminal_shows_both_steps(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    out = StringIO()
    monkeypatch.setattr(terminal, "out", Console(file=out, width=160))
    print_diagnosis(pair(), tmp_path, ())  # type: ignore[arg-type]
    assert "friction and valve lag" in out.getvalue()


def format_text(effects: tuple[str, ...] | None = None, **changed: object) -> str:
    """Return the sentence of a diagnosis with other values, those of the composition's effects as well."""
    composition = named().composition if effects is None else replace(named().composition, effects=effects)
    return format_verdict(replace(named(), **{"correction": LEARNED, "composition": composition, **changed}))  # type: ignore[arg-type]


DOUBTFUL = {"verdict": AMBIGUOUS, "doubt": Doubt.ALTERNATIVES}
GROUPS = (("inertia", "gas_spring"), ("friction", "current_hysteresis", "backlash"))


@pytest.mark.parametrize("verdict", [NAMED, AMBIGUOUS, UNKNOWN, NO_GAP])
def test_the_verdict_is_one_sentence(verdict: str) -> None:
    reason, alike = Within.NOISE if verdict == NO_GAP else "", {}
    if verdict == AMBIGUOUS:
        alike = {
            "indistinguishable": (("friction", "valve_lag"),),
            "doubt": Doubt.ALTERNATIVES,
            "alternatives": ("valve_lag",),
        }
    text = format_text(verdict=verdict, no_gap_reason=reason, **alike)
    assert text.endswith(".") and text.count(". ") == 0 and "\n" not in text
    assert "_" not in text and "None of" not in text.replace("None of the known effects", "")


@pytest.mark.parametrize(
    ("changed", "says", "not_says"),
    [
        ({}, "the simulation's own error shrinks from 36.1 N to 4.5 N", "recalibration"),
        ({"not_separable": ("friction",)}, "a recalibration of the simulation would explain it, too.", "_"),
        ({"not_separable": ("leakage",)}, "friction", "recalibration"),
        ({"effects": ("friction", "position_delay")}, "friction and position delay", "_"),
        ({"effects": ("valve_lag", "friction")}, "friction and valve lag", "_"),  # what closes most comes first
        (
            {**DOUBTFUL, "alternatives": ("current_hysteresis",), "indistinguishable": GROUPS},
            "between friction and current hysteresis;",
            "inertia",
        ),
        ({**DOUBTFUL, "alternatives": ("valve_lag",)}, "do not rule out valve lag; with friction", "_"),
    ],
    ids=["named", "map alike", "map of another", "several", "ranked", "indistinguishable", "not ruled out"],
)
def test_a_sentence_names_causes_and_what_else_is_possible(changed: Any, says: str, not_says: str) -> None:
    text = format_text(**changed)
    assert says in text and not_says not in text


def test_the_closest_effect_is_the_one_that_leaves_least() -> None:
    first, second, *others = named().causes
    less = replace(second, gap_after_N=0.5 * named().composition.gap_after_N)
    text = format_text(verdict=UNKNOWN, causes=(first, less, *others))
    assert f"closest, {second.effects[0].replace('_', ' ')}, leaves {less.gap_after_N:.3g} N" in text


def test_an_unknown_cause_comes_with_the_closest_effect() -> None:
    assert "closest" in format_text(verdict=UNKNOWN) and "friction" in format_text(verdict=UNKNOWN)
    nothing = replace(named().composition, effects=(), gap_after_N=36.1)
    assert "closest, friction" in format_text(verdict=UNKNOWN, composition=nothing)
    assert "closest" not in format_text(verdict=UNKNOWN, composition=nothing, causes=())
    assert "a learner without physics 4 N" in format_text(verdict=UNKNOWN)
    noisy_gap = replace(named().gap, noise_known=False, noise_source="high frequencies, not limited by any source")
    assert "noise not known: high frequencies" in format_text(verdict=UNKNOWN, gap=noisy_gap)


@pytest.mark.parametrize(
    ("doubt", "text"),
    [
        (Doubt.SIMULATION_ERROR, "Friction may be an error of the simulation itself; with friction, the gap beyond"),
        (Doubt.UNDETERMINED, "The interval of an effect's size includes no effect"),
        (Doubt.NOT_CONFIRMED, "The held-out recordings do not confirm"),
        (Doubt.LEAVES_MORE, "leaves more of the gap's energy than it closes"),
        (
            Doubt.REMAINS,
            "Something else remains beside friction, as a learner without physics leaves 4 N; with friction, the",
        ),
        (Doubt.UNCERTAIN, "not certain enough to be named"),
    ],
)
def test_an_ambiguous_verdict_says_what_speaks_against_the_cause(doubt: str, text: str) -> None:
    assert text in format_text(verdict=AMBIGUOUS, doubt=doubt)
    withdrawn = replace(named().composition, effects=())
    assert "; what was fitted enlarges" in format_text(verdict=AMBIGUOUS, doubt=doubt, composition=withdrawn)


def no_gap(reason: str, rms_N: float, corrected_N: float) -> str:
    gap = replace(named().gap, rms_N=rms_N, corrected_N=corrected_N)
    found: Diagnosis = replace(named(), verdict=NO_GAP, no_gap_reason=reason, visible_from_N=57.0, gap=gap, timed_N=2.5)
    return format_verdict(found)


def test_no_gap_comes_with_what_it_lies_within() -> None:
    assert "within the measurement noise of 8.0 N" in no_gap("noise", 3.0, 3.0)
    assert "above the tolerance of 5.0 N: 3.0 N" in no_gap("tolerance", 3.0, 3.0)
    assert "timing" in no_gap("timing", 9.0, 9.0) and "2.5 of 9.0 N RMS remain" in no_gap("timing", 9.0, 9.0)


def test_behind_a_poor_simulation_the_smallest_visible_effect_is_stated() -> None:
    text = no_gap("baseline_error", 60.0, 3.0)
    assert "all but 3 N of the 60 N" in text and "below about 57 N RMS cannot be seen" in text


def test_a_model_that_knows_its_own_error_states_its_range_over_the_recordings() -> None:
    series = named().held_out[0]
    ranged = tuple(replace(series, trace=replace(series.trace, own_error_N=error_N)) for error_N in (45.0, 20.0))
    found = replace(named(), verdict=NO_GAP, no_gap_reason="baseline_error", held_out=ranged)
    assert "within the model's own error of 20 to 45 N" in format_verdict(replace(found, visible_from_N=35.0))


def test_a_calibration_comes_with_the_size_of_its_map() -> None:
    curve = Composition((Setting(SpeedCurve(), (10.0, 0.0, 0.0, 0.0, 20.0)),))
    text = format_text(composition=replace(named().composition, effects=("calibration",), composition=curve))
    assert "calibration is off, most at" in text and "(+30 N)" in text and "m/s" in text and "recalibrated" in text
