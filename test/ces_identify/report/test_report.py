import math
import re
import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pages import assert_self_contained
from report_examples import TERMS, WIDE, damper, model

from ces_identify.polynomial.problem import compute_envelope
from ces_identify.prepare.cost import parse_weighting, weighted_cost
from ces_identify.report.figures import choose_window, make_grid
from ces_identify.report.page import write_report
from ces_identify.structures.polynomial import COSTS_BY_TERMS, format_term
from ces_identify.validation.evaluate import IDENTIFICATION, VALIDATION, evaluate, pooled_cost
from ces_identify.validation.residuals import residual_tests, verdicts
from ces_observer.structures.polynomial import Factor, Polynomial, Term
from ces_report.drawing import PlotAxis, band, line, panel
from ces_report.plot import MAX_NAME, IntervalRow, draw_intervals
from ces_report.shell import PageHead
from ces_report.typesetting import three_figures

XHTML, SVG = "{http://www.w3.org/1999/xhtml}", "{http://www.w3.org/2000/svg}"
COMMAND = "ces identify bags/sine --out model.json"


def unstable():
    return model(body=Polynomial((Term(1.01, (Factor("force", 1),)), *TERMS[1:])), force_envelope_N=(-2000.0, 2000.0))


def page(folder, evaluations, used=None, title="A model"):
    path = folder / "report.html"
    write_report(path, PageHead(title, command=COMMAND), used or model(), evaluations)
    text = path.read_text(encoding="utf-8")
    return text, ET.fromstring(text)


def words(element):
    return " ".join("".join(element.itertext()).split())


def section(root, ident):
    return next(e for e in root.iter(f"{XHTML}section") if e.get("id") == ident)


def cost_cells(root):
    rows = section(root, "costs").iter(f"{XHTML}tr")
    return [[words(cell) for cell in row.iter(f"{XHTML}td")] for row in list(rows)[1:]]


@pytest.fixture(scope="module")
def both():
    first = evaluate(model(), [damper("sine", seed=1)], IDENTIFICATION)
    return first + evaluate(model(), [damper("road", seed=2, gaps=1, ticks=12_000)], VALIDATION)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, both):
    """The page of both recordings, as text and as elements."""
    return page(tmp_path_factory.mktemp("whole"), both)


def test_the_page_is_self_contained(whole):
    assert_self_contained(whole[0])


def test_ids_are_unique_and_every_figure_has_an_accessible_name(whole, both):
    root = whole[1]
    idents = [e.get("id") for e in root.iter() if e.get("id")]
    assert len(idents) == len(set(idents))
    figures = list(root.iter(f"{SVG}svg"))
    assert len(figures) == 3 * len(both) + 4
    for figure in figures:
        assert figure.get("role") == "img"
        assert set((figure.get("aria-labelledby") or "").split()) <= set(idents)
        assert (figure[0].tag, figure[1].tag) == (f"{SVG}title", f"{SVG}desc")
        assert words(figure[0])
    targets = {a.get("href", "")[1:] for a in root.iter(f"{XHTML}a")}
    assert targets <= set(idents) and len(targets) == len(both)


def test_cost_table_tells_each_recording_validation_first(whole, both):
    root = whole[1]
    rows = cost_cells(root)
    assert [row[:2] for row in rows] == [["road", VALIDATION], ["sine", IDENTIFICATION]]
    for row, e in zip(rows, reversed(both), strict=True):
        error = e.series.force[e.series.scored] - e.run.force[e.series.scored]
        assert float(row[3]) == pytest.approx(e.series.scored.sum() / 500.0, abs=0.05)
        low, high = map(float, row[5].split(" to "))
        assert low < e.cost < high and abs(float(row[4]) - e.cost) < 0.2 * (high - low)
        assert float(row[6]) == pytest.approx(np.sqrt(np.mean(error**2)), rel=6e-3)
    assert rows[0][8].startswith("0 / 1") and rows[1][8] == "0 / 0"
    assert words(next(root.iter(f"{XHTML}dd"))) == f"Well. Validation: cost J = {three_figures(both[1].cost)} % (road)."


def test_title_and_command_say_what_was_done(tmp_path, whole, both):
    root = whole[1]
    assert words(next(root.iter(f"{XHTML}title"))) == "A model: road (validation); sine (identification)"
    other = "ces identify bags/sine --out model_auto.json --structure auto"
    assert [words(e) for e in root.iter(f"{XHTML}code")] == [other, COMMAND]
    many = [replace(both[0], name=f"r{n}") for n in range(9)]
    _, root = page(tmp_path, many)
    assert "r0, r1, r2, r3, r4 and 4 more (identification)" in words(next(root.iter(f"{XHTML}title")))


def test_every_term_is_listed_with_its_coefficient(whole):
    root = whole[1]
    rows = [[words(c) for c in r.iter(f"{XHTML}td")] for r in section(root, "terms").iter(f"{XHTML}tr")][1:]
    assert {row[0] for row in rows} == {words(ET.fromstring(f"<t>{format_term(t, WIDE)}</t>")) for t in TERMS}
    assert sorted(float(row[1].replace("−", "-")) for row in rows) == sorted(t.coefficient for t in TERMS)
    assert rows[0][0] == "F(k−1)"
    shares = [float(re.match(r"[\d.]+", row[4])[0]) for row in rows]
    assert shares == sorted(shares, reverse=True)


def test_names_are_escaped(tmp_path, both):
    evil = "<script>alert('x')</script>&\"" + "very_long_" * 40
    text, root = page(tmp_path, [replace(both[1], name=evil + "\udce4")], title=evil)
    assert "<script>alert" not in text
    assert cost_cells(root)[0][0] == evil + "?"  # what is not Unicode
    assert words(next(root.iter(f"{XHTML}h1"))) == evil


def without_force(e):
    return replace(e, run=replace(e.run, force=np.full(len(e.series), np.nan)), cost=math.inf, half_width=None)


def test_a_held_force_is_warned_of_and_counts(tmp_path, both):
    (held,) = evaluate(unstable(), [both[1].series], VALIDATION)
    assert held.held_share > 0.1 and held.cost > 100.0
    _, root = page(tmp_path, [held, both[0]], unstable())
    warning = next(words(e) for e in root.iter(f"{XHTML}p") if e.get("class") == "warning")
    assert warning.startswith("road: the force was held at its envelope (−2000 to 2000 N) for ")
    assert float(cost_cells(root)[0][7]) == pytest.approx(100.0 * held.outside_share, rel=0.01)


def test_diverged_run_is_named_and_drawn(tmp_path, both):
    text, root = page(tmp_path, [without_force(replace(both[1], role=VALIDATION)), both[0]])
    assert cost_cells(root)[0][4:7] == ["diverged", "–", "–"]
    assert not [t for t in root.iter(f"{SVG}title") if words(t).startswith("Correlations") and "road" in words(t)]
    assert "No interval and no RMS error (the simulated force is not finite): road." in text
    assert "the free run diverged on every recording" in text
    assert not re.search(r'="[^"]*\b(nan|inf)\b', text)


def renamed(both):
    return [replace(both[0], role=VALIDATION, name=n, cost=c) for n, c in (("a", 12.3), ("b", 6.91), ("c", 140.2))]


def part_diverged(both):
    return [without_force(replace(both[1], role=VALIDATION)), replace(both[0], role=VALIDATION)]


CERTIFIED = model(certificate={"gain": 0.9})


@pytest.mark.parametrize(
    ("evaluations", "used", "said"),
    [
        (renamed, model(), r"cost J from 6\.91 % \(b\) to 140 % \(c\), 3 recordings"),
        (part_diverged, model(), r"Validation: cost J = [\d.]+ % \(sine\); the free run diverged on 1 more\."),
        (lambda both: both[:1], model(), r"Not validated: fit and selection used all recordings below\."),
        (lambda both: both[:1], model(), r"RMS error on the identification recordings"),
        (lambda both: both[:1], model(), r"None: this model comes without a proof of stability\."),
        (lambda both: both[:1], CERTIFIED, r"^((?!without a proof).)*$"),
    ],
    ids=["costs", "diverged", "not-validated", "map", "no-proof", "proof"],
)
def test_the_page_says(tmp_path, both, evaluations, used, said):
    assert re.search(said, words(page(tmp_path, evaluations(both), used)[1]))


def test_no_recording_at_all_still_shows_the_model(tmp_path):
    _, root = page(tmp_path, [])
    assert len(list(section(root, "terms").iter(f"{XHTML}tr"))) == len(TERMS) + 1


def test_tiny_recording(tmp_path):
    text, _ = page(tmp_path, evaluate(model(), [damper("tiny", ticks=305)], VALIDATION))
    assert "the whole run" in text
    assert not re.search(r"\bnan\b", text)


@pytest.mark.slow
def test_twelve_long_recordings_stay_small(tmp_path):
    ran = [evaluate(model(), [damper("long", ticks=30_000, seed=s)], VALIDATION)[0] for s in (1, 2)]
    four, _ = page(tmp_path, ran * 2)
    twelve, root = page(tmp_path, ran * 6)
    assert len(four) < len(twelve) < 3_000_000
    assert "lowest and highest of every" not in four  # 30,000 samples of 12 lines fit
    assert "Data of this chart: lowest and highest of every" in twelve
    assert len(cost_cells(root)) == 12


def test_of_many_recordings_the_worst_have_charts(tmp_path, both):
    many = [replace(both[n % 2], name=f"r{n}", cost=20.0 - n) for n in range(15)]
    _, root = page(tmp_path, many)
    drawn = [words(next(a.iter(f"{XHTML}h3"))) for a in root.iter(f"{XHTML}article")]
    assert {text.split()[0] for text in drawn} == {f"r{n}" for n in range(10)}
    assert len(cost_cells(root)) == 15
    assert "The 10 recordings with the highest J of 15." in words(section(root, "recordings"))


def test_grey_marks_what_is_outside_the_envelope(tmp_path, whole, both):
    narrow = model(envelope=replace(WIDE, speed_m_s=(-3.0, 0.1)))
    outside, _ = page(tmp_path, evaluate(narrow, [both[1].series], VALIDATION), narrow)
    inside = whole[0]
    assert 'class="outside"' in outside and "is outside the model" in outside
    assert 'class="outside"' not in inside and 'class="warning"' not in inside


def test_window_is_typical():
    e = evaluate(model(), [damper("long", ticks=10_000, gaps=1)], VALIDATION)[0]
    force = e.series.force.copy()
    force[600:700] += 2000.0  # a burst that no typical window holds
    burst = replace(e, series=replace(e.series, force=force))
    window = choose_window(burst)
    assert window.stop - window.start == 750
    assert window.start >= 700 or window.stop <= 600
    assert window.why.startswith("typical")


def test_window_is_where_the_damper_works():
    series = damper("standstill", ticks=10_000)
    still = np.arange(len(series)) < 8000  # most of the recording, and there the error is smaller
    changed = {name: np.where(still, 0.0, getattr(series, name)) for name in ("speed", "force")}
    e = evaluate(model(), [replace(series, **changed)], VALIDATION)[0]
    assert choose_window(e).start > 7000


def test_window_spans_no_gap_and_no_warm_up():
    e = evaluate(model(), [damper("broken", ticks=10_000, gaps=7)], VALIDATION)[0]
    window = choose_window(e)
    assert window.stop - window.start == 750
    assert e.series.scored[window.start : window.stop].all()
    assert np.diff(e.series.time_s[window.start : window.stop]).max() < 0.003


def test_window_of_a_held_run_shows_where_it_was_first_held(both):
    e = evaluate(unstable(), [both[0].series], VALIDATION)[0]
    assert choose_window(e).start <= e.run.held.argmax() < choose_window(e).stop


def test_grid_shares_add_up_and_its_errors_are_the_errors(both):
    envelope = compute_envelope([e.series for e in both])
    grid = make_grid(both, envelope)
    assert grid.share(both).sum() == pytest.approx(100.0)
    rms, e, s = grid.rms(both[:1]), both[0], both[0].series
    a, b = np.unravel_index(np.nanargmax(rms), rms.shape)
    inside = (s.speed >= grid.speed[a]) & (s.speed < grid.speed[a + 1]) & s.scored
    inside &= (s.current >= grid.current[b]) & (s.current < grid.current[b + 1])
    assert rms[a, b] == pytest.approx(np.sqrt(np.mean((s.force - e.run.force)[inside] ** 2)), rel=1e-6)


def test_cells_with_few_ticks_tell_no_error(both):
    grid = make_grid(both, compute_envelope([e.series for e in both]))
    ticks = grid.share(both[:1]) / 100.0 * both[0].series.scored.sum()
    np.testing.assert_array_equal(np.isnan(grid.rms(both[:1])), ticks < 9.5)
    assert ((ticks > 0.5) & (ticks < 9.5)).any()


def test_one_wild_sample_among_many_is_still_drawn():
    x, y = np.arange(30_000.0), np.zeros(30_000)
    y[12_345] = 7.0
    p = panel((0.0, 30_000.0), (-10.0, 10.0), (0.0, 0.0, 600.0, 200.0))
    heights = [float(v) for v in re.findall(r",(-?[\d.]+)", line(p, x, y, "error"))]
    assert min(heights) == pytest.approx(30.0 - 0.5, abs=0.06)
    assert len(heights) < 3000


def test_a_jump_between_two_pixel_columns_of_a_dense_line_is_drawn():
    x = np.arange(30_000.0)
    p = panel((0.0, 30_000.0), (-1.0, 1.0), (0.0, 0.0, 600.0, 100.0))
    path = line(p, x, np.where(x < 15_000.0, -0.5, 0.5), "error")  # the step is at the edge of column 300
    drawn = [(float(a), float(b)) for a, b in re.findall(r"[ML](-?[\d.]+),(-?[\d.]+)", path)]
    heights = {round(b) for a, b in drawn if 299.0 <= a <= 300.0}
    assert min(heights) <= 25 and max(heights) >= 75


def test_band_is_open_where_nothing_was_logged():
    x = np.concatenate([np.arange(0.0, 10_000.0), np.arange(20_000.0, 30_000.0)])
    p = panel((0.0, 30_000.0), (-1.0, 1.0), (0.0, 0.0, 600.0, 100.0))
    path = band(p, x, np.zeros(len(x)), "error")
    assert path.count("M") == 2
    drawn = [float(v) for v in re.findall(r"[ML](-?[\d.]+),", path)]
    assert not [v for v in drawn if 201.0 < v < 399.0]


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.integers(3, 9))
def test_ticks_are_inside_evenly_spaced_and_read_back(low, span, most):
    axis = PlotAxis(low, low + span, 0.0, 100.0)
    ticks = axis.ticks(most)
    values = np.array([v for v, _ in ticks])
    slack = 1e-6 * (abs(low) + span)
    assert 1 <= len(ticks) <= most + 1
    assert values.min() >= low - slack and values.max() <= low + span + slack
    assert np.ptp(np.diff(values)) <= slack if len(values) > 2 else True
    assert [float(text.replace("−", "-")) for _, text in ticks] == pytest.approx(list(values), abs=slack)


def test_correlations_are_drawn_with_their_bands_and_told(whole, both):
    root = whole[1]
    for number, e in enumerate(reversed(both)):
        tests = residual_tests(e)
        article = next(a for a in root.iter(f"{XHTML}article") if a.get("id") == f"recording-{number}")
        figure = next(f for f in article.iter(f"{SVG}svg") if f[0].get("id") == f"rc{number}-t")
        paths = [(p.get("class") or "", p.get("d")) for p in figure.iter(f"{SVG}path")]
        bands = [d for css, d in paths if css == "chance area"]
        lines = [css for css, _ in paths if css in ("simulated", "error")]
        plots = (tests.whiteness, *tests.inputs)
        assert len(bands) == len(lines) == len(plots)
        assert [css == "simulated" for css in lines] == [not c.passed for c in plots]
        edges = [[float(y) for y in re.findall(r",([\d.]+)", band)] for band in bands]
        heights = [(max(ys) - min(ys)) / c.band for ys, c in zip(edges, plots, strict=True)][1:]
        assert heights == pytest.approx([heights[0]] * len(heights), rel=0.02)  # one scale for all inputs
        assert verdicts(tests)[1] in words(article)


def test_weighted_cost_has_a_column_if_asked_for(tmp_path, both):
    path, weighting = tmp_path / "w.html", parse_weighting(["zero_crossing=3"])
    write_report(path, PageHead("A model"), model(), both, weighting=weighting)
    root = ET.fromstring(path.read_text(encoding="utf-8"))
    scored = both[1].series.scored
    expected = weighted_cost(
        both[1].series.force[scored], both[1].run.force[scored], weighting.tick_weights(both[1].series)[scored]
    )
    assert float(cost_cells(root)[0][6]) == pytest.approx(expected, rel=6e-3)
    assert "zero_crossing=3" in words(section(root, "costs"))


def test_the_first_screen_says_fit_place_trust_and_what_to_record(tmp_path, both):
    def answers(evaluations, used=None):
        rows = page(tmp_path, evaluations, used)[1].iter(f"{XHTML}dl")
        return {words(pair[0]): words(pair[1]) for pair in next(rows)}

    fitted, held_out = both
    said = answers(both)
    assert re.match(
        r"At −?[\d.]+ to [\d.]+ m/s.*: \d+ % of the error's energy in \d+ % of the time", said["Where not?"]
    )
    assert "of the time on a class C road at 60 km/h" in said["On the vehicle?"]
    assert said["Another structure?"].endswith("--out model_auto.json --structure auto")
    assert "as --validate BAG" in answers([fitted])["Record next?"]
    slow = model(envelope=replace(WIDE, speed_m_s=(-0.18, 0.18)))
    assert "68.3 % of the time on a class C road" in answers(both, slow)["On the vehicle?"]
    assert answers(both, slow)["Record next?"] == "Faster strokes, up to 0.5 m/s."
    one = model(envelope=replace(WIDE, current_A=(0.5, 0.5)))
    assert answers(both, one)["Record next?"] == "Other currents: it knows 0.5 A only."
    same = [fitted, replace(held_out, name=fitted.name)]
    assert answers(same)["Does it fit?"].startswith("Well, on the rest of its own recording. Validation: cost J")
    assert answers([without_force(held_out), fitted])["Does it fit?"].startswith("No. ")


def test_several_validation_recordings_are_told_together(tmp_path, both):
    held_out = [replace(e, role=VALIDATION) for e in both]
    _, root = page(tmp_path, held_out)
    together = re.search(r"All 2 validation recordings together, [\d.]+ s: J = ([\d.]+) %", words(root))
    assert float(together[1]) == pytest.approx(pooled_cost(held_out), rel=6e-3)


def test_many_recordings_outside_the_envelope_have_one_warning(tmp_path):
    narrow = model(envelope=replace(WIDE, speed_m_s=(-0.001, 0.001)))
    ran = [evaluate(narrow, [damper(f"run_{n}", seed=n)], VALIDATION)[0] for n in range(4)]
    few, _ = page(tmp_path, ran[:3], narrow)
    assert few.count('class="warning"') == 3
    many, _ = page(tmp_path, ran, narrow)
    assert many.count('class="warning"') == 1 and "4 of 4 recordings are outside" in many
    assert re.search("model knows [−-]0.0010* to 0.0010*", many)


def test_a_long_name_beside_intervals_keeps_both_ends():
    rows = [IntervalRow(f"model_of_{'x' * 40}_seed_{n} − other_{'z' * 40}_{n}", 0.0, 1.0, 0.5, "") for n in range(2)]
    names = re.findall(r'class="name"[^>]*>([^<]*)<', draw_intervals("i", "Differences", "J", rows))
    shown = [name for name in names if " − " in name]
    assert len(set(shown)) == 2
    assert all(len(name) <= MAX_NAME and name.startswith("mod") for name in shown)


def test_the_head_has_the_note_and_the_day_and_the_provenance_lists_the_recordings(tmp_path, both):
    known = {"identification": [{"recording": "sine", "share": [0.0, 0.75], "day": "2026-05-03", "sha256": "ab" * 32}]}
    path, head = tmp_path / "r.html", PageHead("Rear damper", "Car 7 <winter oil>", recorded="2026-05-03")
    write_report(path, head, replace(model(), provenance=known), both)
    root = ET.fromstring(path.read_text(encoding="utf-8"))
    header = words(next(root.iter(f"{XHTML}header")))
    for text in ("Rear damper", "Car 7 <winter oil>", "Recorded 2026-05-03; page written "):
        assert text in header
    cells = [words(cell) for cell in section(root, "provenance").iter(f"{XHTML}td")]
    assert cells[:4] == ["sine", "identification, 0 to 75 %", "2026-05-03", "ab" * 8]


def test_a_polynomial_shows_its_cost_over_the_number_of_terms(tmp_path, both):
    search = {"selection": {COSTS_BY_TERMS: [[1, 40.0], [2, 9.0], [len(TERMS), 8.5]]}}
    root = page(tmp_path, both, replace(model(), provenance=search))[1]
    shown = words(section(root, "size"))
    assert "2 terms are within 10 % of the lowest: --terms 2" in shown and "this model" in shown
    assert all(part.get("id") != "size" for part in page(tmp_path, both)[1].iter(f"{XHTML}section"))
