"""The page of a diagnosis: sound, to scale, complete, in words."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from diagnoses import ALL, ambiguous, experiment, explained, named, no_gap, pair, unknown
from example_effects import Friction
from pages import assert_self_contained

from ces_gap.diagnosis import Diagnosis, Estimate, GapRegion, HeldOutSeries, Where
from ces_gap.effects.effect import Setting
from ces_gap.effects.library import library
from ces_gap.effects.simulation_errors import simulation_errors
from ces_gap.report.charts import draw_share_charts, find_largest_errors, shares_ci95
from ces_gap.report.formatting import join_effect_names, parameter_text, percent, region_name
from ces_gap.report.page import build_gap_steps, report_page
from ces_gap.report.sentences import format_verdict
from ces_gap.report.tables import cause_rows, effects_without_row
from ces_gap.result_files import result_files
from ces_report.shell import PageHead
from ces_report.typesetting import format_number

XHTML = "{http://www.w3.org/1999/xhtml}"

SVG = "{http://www.w3.org/2000/svg}"

COMMAND = "ces diagnose --sim model.json --real bags/*"

EVERY = {**ALL, "pair": pair}


def page_of(d: Diagnosis) -> ET.Element:
    return ET.fromstring(report_page(d, PageHead("Rear damper", command=COMMAND)))


@cache
def page(which: str) -> ET.Element:
    return page_of(EVERY[which]())


def words(element: ET.Element) -> str:
    return " ".join(" ".join(element.itertext()).split())


def sections(root: ET.Element) -> dict[str, ET.Element]:
    return {str(e.get("id")): e for e in root.iter(f"{XHTML}section")}


def classed(root: ET.Element, css: str) -> list[ET.Element]:
    return [e for e in root.iter() if css in (e.get("class") or "").split()]


def length(element: ET.Element) -> float:
    match = re.search(r"width:([\d.]+)%", str(element.get("style")))
    assert match
    return float(match.group(1))


@pytest.mark.parametrize("which", EVERY)
def test_the_page_is_sound_and_begins_with_the_verdict(which: str) -> None:
    assert_self_contained(report_page(EVERY[which](), PageHead("Rear damper", command=COMMAND)))
    root, d = page(which), EVERY[which]()
    idents = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(idents) == len(set(idents))
    figures = list(root.iter(f"{SVG}svg"))
    assert figures and all(f.find(f"{SVG}title") is not None and f.find(f"{SVG}desc") is not None for f in figures)
    css = words(next(iter(root.iter(f"{XHTML}style"))))
    plain = {"named", "ambiguous", "unknown", "no_gap", "nothing"}
    used = {name for e in root.iter() for name in (e.get("class") or "").split()} - plain
    assert {name for name in used if f".{name}" not in css} == set()
    header = words(next(iter(root.iter(f"{XHTML}header"))))
    assert d.sentence in header and "Next" in header
    notes = next(words(e) for e in root.iter(f"{XHTML}section") if e.get("id") == "notes")
    assert d.simulation in notes and COMMAND in notes
    heading = {"named": "cause named", "ambiguous": "several causes fit"}.get(d.verdict, d.verdict.split("_")[-1])
    assert heading in header


def test_gap_steps_are_to_scale() -> None:
    bars = {str(e.get("class")).split()[-1]: length(e) for e in classed(page("named"), "length")}
    gap = named().gap
    assert list(bars) == ["before", "corrected", "after", "noise", "wrong", "ceiling"]
    for css, value in (("corrected", gap.corrected_N), ("after", 4.5), ("noise", gap.noise_floor_N), ("wrong", 28.4)):
        assert bars[css] / bars["before"] == pytest.approx(value / gap.rms_N, rel=2e-3)
    gap_steps = build_gap_steps(named())
    for bar in (*gap_steps.steps, *gap_steps.controls):
        if bar.whisker is not None:
            start, width = bar.whisker
            assert 0.0 <= start <= bar.length <= start + width <= 100.0


@pytest.mark.parametrize(
    ("which", "section", "texts"),
    [
        ("named", "shrink", ["Baseline error removed"]),
        ("ambiguous", "shrink", ["No baseline error was learned"]),
        ("unknown", "causes", ["rise 0.100 s (0.094 to 0.100) at its bound"]),
        ("unknown", "causes", ["width 0.11 A (0.07 to 0.16) differs between folds"]),
        ("pair", "causes", ["Fitted together", "Coulomb 35.2 N (33.0 to 37.1)", "rise 11 ms (8 to 14)"]),
        ("ambiguous", "open-questions", ["Valve lag and current hysteresis give the same force"]),
        ("ambiguous", "open-questions", ["leakage: a recalibration of the simulation would have the same effect"]),
        ("ambiguous", "open-questions", ["Bump stop: the stroke never comes within 10 mm of its ends."]),
        ("ambiguous", "next", [experiment().purpose[1:], "next_experiment.csv", "kind triangle", "0.3, 1.2"]),
        ("ambiguous", "next", ["valve lag and current hysteresis differ by 31.0 N RMS"]),
        ("unknown", "rest", ["The rest is most concentrated"]),
    ],
)
def test_a_section_says_what_the_diagnosis_found(which: str, section: str, texts: list[str]) -> None:
    text = words(sections(page(which))[section]).replace("\N{NO-BREAK SPACE}", " ")
    assert [part for part in texts if part not in text] == []


def test_what_was_not_found_is_not_on_the_page() -> None:
    assert "Baseline error removed" not in words(sections(page("ambiguous"))["shrink"])
    assert "Fitted together" not in words(page("named"))
    assert "friction and valve lag" in words(classed(page("pair"), "closed")[0])
    assert "its cost J is 2.70 %" in words(page("ambiguous"))


def test_causes_are_ranked_with_what_their_probabilities_leave() -> None:
    table = next(iter(sections(page("ambiguous"))["causes"].iter(f"{XHTML}table")))
    rows = [words(r) for r in table.iter(f"{XHTML}tr")][1:]
    assert [r.split(" ")[0] for r in rows] == ["valve", "current", "friction", "none", "no"]
    shares = [length(e) for e in classed(table, "bar")]
    assert shares == pytest.approx([46.0, 41.0, 3.0, 6.0, 4.0]) and sum(shares) == pytest.approx(100.0)
    assert [r.effect for r in cause_rows(ambiguous()) if r.css == "named"] == ["valve lag", "current hysteresis"]
    assert [r.effect for r in cause_rows(named()) if r.css == "named"] == ["friction"]
    assert "rise 21 ms (17 to 26)" in rows[0] and "85 79 to 90 %" in rows[0]


def test_improbable_effects_are_only_listed() -> None:
    d = named()
    extra = [replace(d.causes[1], effects=(f"effect_{i}",), probability=0.0) for i in range(5)]
    many = replace(d, causes=(*d.causes, *extra))
    rows = cause_rows(many)
    assert [r.effect for r in rows[:-2]] == ["friction", "valve lag", "current hysteresis"]
    assert effects_without_row(many) == [f"effect {i}" for i in range(5)]
    assert "Less probable: effect 0, effect 1" in words(page_of(many))


def test_where_has_a_chart_for_each_axis_to_scale_and_its_maps() -> None:
    root, regions = page("named"), named().where.regions
    where = sections(root)["where"]
    charts, maps = (next(e for e in where.iter(f"{XHTML}div") if e.get("class") == c) for c in ("share-charts", "maps"))
    assert len(list(charts)) == len({r.axis for r in regions}) == 8
    assert len(list(maps)) == len(named().where.maps)
    figure = next(e for e in root.iter(f"{SVG}svg") if "where-direction-t" in str(e.get("aria-labelledby")))
    heights = [float(str(e.get("height"))) for e in classed(figure, "energy")]
    shares = [r.share_of_energy for r in sorted(regions, key=lambda r: r.low) if r.axis == "direction"]
    assert heights[0] / heights[1] == pytest.approx(shares[0] / shares[1], rel=5e-3)


def test_region_without_evidence_does_not_stand_out() -> None:
    d = named()
    assert "No region stands out" in words(page_of(replace(d, where=replace(d.where, max_p_value=0.3))))
    assert "No region stands out" in words(page_of(replace(d, where=replace(d.where, strongest=None))))


@pytest.mark.parametrize("axis", ["speed_m_s", "frequency_hz"])
def test_intervals_of_shares_are_those_of_the_rms(axis: str) -> None:
    samples = (0.5, 0.3, 0.2)
    rms = (10.0, 30.0, 20.0)
    energy = np.array([r**2 * (1.0 if axis == "frequency_hz" else s) for r, s in zip(rms, samples, strict=True)])
    share = energy / energy.sum()
    regions = [
        GapRegion(axis, float(k), k + 1.0, float(share[k]), samples[k], rms[k], (rms[k], 2.0 * rms[k]), 1.0)
        for k in range(3)
    ]
    assert shares_ci95(regions) == pytest.approx(np.c_[share, 4.0 * share])


def test_the_rest_is_located_for_unknown_only() -> None:
    order = list(sections(page("unknown")))
    assert order.index("rest") < order.index("where")
    assert all("rest" not in sections(page(which)) for which in EVERY if which != "unknown")
    assert "a generic learner explains 79 %" in words(classed(page("unknown"), "closed")[0])


def test_no_gap_is_a_short_page() -> None:
    short = sections(page("no_gap"))
    assert list(short) == ["shrink", "before-after", "open-questions", "notes", "meaning"]
    assert not classed(page("no_gap"), "after") and not classed(page("no_gap"), "augmented")
    assert len(report_page(no_gap())) < 0.6 * len(report_page(named()))


def test_worst_second_holds_the_burst() -> None:
    first = named().held_out[0]
    force = first.trace.force.copy()
    force[1234:1300] += 900.0
    burst = HeldOutSeries(replace(first.trace, force=force), first.corrected, first.augmented)
    worst = find_largest_errors([first, burst, first])
    assert worst is not None and worst.series is burst
    assert worst.start <= 1234 and worst.stop >= 1300 and worst.stop - worst.start == 500


def test_regions_before_and_after() -> None:
    table = next(t for t in page("named").iter(f"{XHTML}table") if t.get("class") == "regions")
    rows = list(table.iter(f"{XHTML}tr"))[1:]
    clear = [pair for pair in named().by_region if pair[0].q_value <= 0.05][:10]
    assert 0 < len(rows) == len(clear) < len(named().by_region)
    region, after = clear[0]
    assert words(rows[0]).startswith(region_name(region))
    was, now = length(classed(rows[0], "was")[0]), length(classed(rows[0], "is")[0])
    assert now / was == pytest.approx(after / region.rms_N, rel=0.01)


def test_edges_that_lie_close_have_different_labels() -> None:
    edges = (0.2, 1.598, 1.604)
    regions = [GapRegion("current_A", *ends, 0.5, 0.5, 9.0, (8.0, 10.0), 1.0) for ends in pairwise(edges)]
    (figure,) = draw_share_charts("shares", regions)
    ticks = classed(ET.fromstring(f"<p>{figure}</p>"), "mid")
    assert [words(tick) for tick in ticks] == ["0.2", "1.598", "1.604"]


def test_the_title_says_which_simulation_and_recordings() -> None:
    d = replace(named(), simulation="/runs/7/model.json", next_experiment=None)
    first, second = (one.trace.recording for one in d.held_out)
    sources = [("real", [first]), ("held_out", [second]), ("reference", [replace(first, name="new")])]
    text = result_files(d, {"spec": "model.json", "sha256": None}, sources)["report.html"]
    title = next(ET.fromstring(text).iter(f"{XHTML}title")).text
    assert title == f"Gap of model.json against {first.name}, {second.name} (reference new)"
    only = result_files(d, {"spec": "model.json", "sha256": None}, sources[:1])["report.html"]
    assert f"<title>Gap of model.json against {first.name}</title>" in only


def test_texts_of_others_are_shown_as_they_are_and_warnings_come_before_the_result() -> None:
    seen = "road: model.json was identified on seconds of this recording: it has learned part of the gap"
    d = replace(named(), sentence="a <b> & 'c'", simulation="<script>x</script>", notes=("1 < 2 \udcff", seen))
    root = page_of(replace(d, seen_notes=(seen,)))
    assert "a <b> & 'c'" in words(root) and "<script>x</script>" in words(root) and "1 < 2" in words(root)
    assert [words(e) for e in classed(root, "warning")] == [f"R{seen[1:]}."]


def test_unknown_values_leave_a_page() -> None:
    nan = math.nan
    lost = Estimate("coulomb_N", nan, (nan, nan))
    blind = explained(Setting(Friction(), (0.0, 0.01)), (lost, lost), named().held_out, 0.2)
    blind = replace(blind, gap_after_N=nan, shrink=nan, shrink_ci95=(nan, nan))
    gap = replace(named().gap, ci95_N=(nan, nan), corrected_N=nan, corrected_ci95_N=(nan, nan), noise_floor_N=nan)
    dark = replace(named().held_out[0].trace, usable=np.zeros(len(named().held_out[0].trace), bool))
    d = replace(
        unknown(),
        gap=gap,
        causes=(blind,),
        composition=blind,
        ceiling_after_N=nan,
        where=Where((), None, nan, ()),
        rest=Where((), None, nan, ()),
        held_out=(replace(named().held_out[0], trace=dark),),
        next_experiment=replace(experiment(), time_s=np.zeros(0), position_m=np.zeros(0), current_A=np.zeros(0)),
    )
    text = words(page_of(d))
    assert (
        not re.search(r"\bnan\b", text)
        and "No region stands out" in text
        and "before-after" not in sections(page_of(d))
    )
    assert not re.search(r"\bnan\b", words(page_of(replace(d, verdict="named"))))


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("coulomb_N", 36.86, ("Coulomb", "37", "N", "33 to 41")),
        ("stiffness_N_m", 800.0, ("stiffness", "800", "N/m", "720 to 880")),
        ("hardening_N_m2", 5.0, ("hardening", "5.0", "N/m²", "4.5 to 5.5")),
        ("stiffness_N_m", 1.84e6, ("stiffness", "1840", "N/mm", "1660 to 2020")),
        ("bubbles_m", 0.0004, ("bubbles", "0.40", "mm", "0.36 to 0.44")),
        ("stribeck_m_s", 0.02, ("Stribeck", "0.0200", "m/s", "0.0180 to 0.0220")),
        ("leak_m_sN", 2e-5, ("leak", "2·10⁻⁵", "m/(s·N)", "1.8·10⁻⁵ to 2.2·10⁻⁵")),
        ("compliance_m_N", 2e-7, ("compliance", "0.200", "mm/kN", "0.180 to 0.220")),
        ("fade_per_K", -0.004, ("fade", "−0.004", "1/K", "−0.0036 to −0.0044")),
        ("gain", 1.05, ("gain", "1.05", "", "0.95 to 1.16")),
    ],
)
def test_parameters_have_convenient_units(name: str, value: float, expected: tuple[str, ...]) -> None:
    parts = parameter_text(Estimate(name, value, (0.9 * value, 1.1 * value)))
    assert tuple(t.replace("\N{NARROW NO-BREAK SPACE}", " ") for t in parts) == expected


def test_every_effect_of_the_library_has_a_description() -> None:
    forms = (*library(), *simulation_errors())
    assert all(e.summary for e in forms)
    for parameter in (p for form in forms for p in form.parameters):
        name, *_ = parameter_text(Estimate(parameter.name, parameter.low, (parameter.low, parameter.high)))
        assert not re.search(r" (m\d?|s|s?N|A|K|J|kg|Pa|Hz|rad|rtN)$", name), parameter.name


def test_words_of_numbers_and_regions() -> None:
    assert (percent(0.004), percent(0.0), percent(-0.05), percent(-0.004), percent(math.nan)) == (
        "<1",
        "0",
        "−5",
        "0",
        "–",
    )
    assert (format_number(math.inf), format_number(math.nan), format_number(0.0)) == ("∞", "–", "0")
    assert (join_effect_names(["a_b"]), join_effect_names(["a", "b"]), join_effect_names(["a", "b", "c"])) == (
        "a b",
        "a and b",
        "a, b and c",
    )
    rows = (
        (("stroke_m", -0.02, 0.0), "stroke −20 to 0 mm"),
        (("heat_J", 500.0, math.inf), "dissipated heat above 0.5 kJ"),
        (("stroke_m", -math.inf, -0.0279), "stroke below −27.9 mm"),
        (("direction", -1.0, 0.0), "rebound"),
        (("direction", 0.0, 1.0), "compression"),
    )
    for (axis, low, high), name in rows:
        assert region_name(GapRegion(axis, low, high, 0.1, 0.1, 1.0, (0.0, 2.0), 0.5)) == name


def test_a_control_longer_than_the_gap_is_shown_as_such() -> None:
    d = named()

    def with_other(gap_after_N: float) -> Diagnosis:
        return replace(d, causes=(d.causes[0], replace(d.causes[1], gap_after_N=gap_after_N)))

    longer, far = (build_gap_steps(with_other(times * d.gap.rms_N)) for times in (1.5, 10.0))
    control, first = longer.controls[0], longer.steps[0]
    assert control.length == pytest.approx(1.5 * first.length) and not longer.cut
    assert far.cut and far.controls[0].css == "wrong cut" and far.steps[0].length > 40.0
    page = report_page(with_other(10.0 * d.gap.rms_N))
    assert "ends in an arrow" in page and "ends in an arrow" not in report_page(d)


def test_a_learner_that_makes_held_out_recordings_worse_is_said() -> None:
    d = unknown()
    assert "explains nothing of it." in report_page(replace(d, ceiling_after_N=1.3 * d.gap.rms_N))


def test_the_closest_effect_is_the_same_in_the_sentence_the_bars_and_the_key_figure() -> None:
    d = unknown()
    less = replace(d.causes[1], gap_after_N=20.0, shrink=0.5)
    for causes, left in ((d.causes, "80"), ((d.causes[0], less), "55")):
        told = replace(d, causes=causes)
        text, page, gap_steps = format_verdict(told), page_of(told), build_gap_steps(told)
        closest = [bar for bar in gap_steps.steps if bar.remark == "the closest of the known effects"]
        assert [bar.css for bar in closest] == ["after"]
        name = closest[0].label.removeprefix("With ")
        assert f"the closest, {name}," in text and not any(name in bar.label for bar in gap_steps.controls)
        assert words(classed(page, "closed")[0]).startswith(f"{left} %")
        assert not [row for row in cause_rows(told) if row.css == "named"]


def test_the_parts_of_a_diagnosis_print_a_few_lines_and_a_table():
    """They printed up to 20 kB of records within records."""
    for d in (named(), pair(), ambiguous(), unknown(), no_gap()):
        assert ("augmented.json" in repr(d)) == ('augmented.json (written by out="FOLDER"; ces.simulate' in repr(d))
        for part in (d.causes, d.composition, d.next_experiment):
            assert part is None or (0 < len(repr(part).splitlines()) < 12 and len(repr(part)) < 1500)
            assert part is None or part._repr_html_().startswith("<p>")
    d = ambiguous()
    assert "friction (Coulomb)" in repr(d.causes) and "rise 21 ms [17 to 26]" in repr(d.composition)
    assert repr(d.next_experiment).splitlines()[-2:] == [
        "separates valve lag and current hysteresis by 31.0 N RMS", "20 s, -20 to 20 mm, 0.3 to 1.2 A"
    ]  # fmt: skip
    assert repr(no_gap().composition) == "no effect" and repr(d.causes[:1]).startswith("each effect in its best form")
    assert max(len(line) for d in (pair(), ambiguous(), unknown()) for line in repr(d).splitlines()) <= 100
