"""The page and the tables: every table is there with units, charts read well in a real browser, prints and scales."""

import csv
from dataclasses import fields, replace

import numpy as np
import pytest
from browser import find_faults
from dyno_recordings import recording_of, sine_motion, triangle_motion

from ces_identify.characteristics.characterise import characterise
from ces_identify.characteristics.page import (
    MAX_ROWS,
    choose_rows,
    format_page,
    make_plots,
    missing_packages,
    peak_table,
    write_characteristics,
    write_figures,
    write_workbook,
)
from ces_identify.characteristics.rows import TABLES
from ces_identify.simulations.simulation import FunctionSimulation
from ces_report.shell import PageHead
from ces_report.typesetting import format_spread

UNITS = {"_N": "N", "_J": "J", "_m": "m", "_s": "s", "_A": "A", "_Hz": "Hz", "_W": "W", "_m_s": "m/s", "_Ns_m": "Ns/m"}


@pytest.fixture(scope="module")
def results():
    """Sines at two currents and steps during a triangle, measured and by one simulation."""
    recordings = []
    for seed, current in enumerate((0.3, 0.6)):
        for amplitude, frequency in ((0.005, 1.0), (0.01, 2.0), (0.02, 2.0)):
            t, x, v = sine_motion(amplitude, frequency)
            force = 2000.0 * current * np.tanh(v / 0.1)
            recordings.append(recording_of(t, x, current, force, 5.0, seed=seed, name=f"s{amplitude}_{current}"))
    t, x, v = triangle_motion()
    current = np.array([0.3, 0.6, 0.3, 0.3, 0.6, 0.3])[np.floor(t / 0.3 + 1e-9).astype(int) % 6]
    recordings.append(recording_of(t, x, current, 2000.0 * current * np.tanh(v / 0.1), 5.0, name="steps"))
    law = FunctionSimulation("law", lambda t, x, i: 1900.0 * i * np.tanh(np.gradient(x, t) / 0.1))
    return characterise(recordings, simulations={"law": law})


def test_tables_have_documented_columns_in_si_units(results, tmp_path):
    files = write_characteristics(tmp_path / "out", results, PageHead(command="ces characterise dyno"))
    names = ["characteristics.html", *(f"{table}.csv" for table in TABLES), "columns.csv", "rules.csv"]
    assert [f.name for f in files][: len(names)] == names
    with (tmp_path / "out/columns.csv").open(encoding="utf-8", newline="") as file:
        described = list(csv.DictReader(file))
    for name, row in TABLES.items():
        with (tmp_path / f"out/{name}.csv").open(encoding="utf-8", newline="") as file:
            lines = list(csv.reader(file))
        assert lines[0] == [f.name for f in fields(row)] == [d["column"] for d in described if d["table"] == name]
        assert len(lines) - 1 == len(getattr(results, name))
        assert not {"nan", "inf"} & {cell for line in lines for cell in line}
    for one in described:
        assert one["meaning"]
        ending = max((e for e in UNITS if one["column"].endswith(e)), key=len, default=None)
        if ending and one["column"] != "note":
            assert one["unit"] == UNITS[ending], one


def test_the_workbook_has_a_sheet_for_each_table_with_settings_and_sources(results, tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    named = replace(results, recordings=(replace(results.recordings[0], name="=1+1"), *results.recordings[1:]))
    write_workbook(tmp_path, named, PageHead(command="ces characterise dyno"))
    book = openpyxl.load_workbook(tmp_path / "characteristics.xlsx")
    assert book.sheetnames == ["settings", "sources", *TABLES]
    settings = {row[0]: row[1:3] for row in book["settings"].iter_rows(values_only=True)}
    assert settings["window"] == ("0.1", "1") and settings["command"][0] == "ces characterise dyno"
    assert book["sources"]["A3"].value == "=1+1" and book["sources"]["A3"].data_type == "s"  # no formula
    rule, heads, units, first = book["peak_velocity"].iter_rows(values_only=True, max_row=4)
    assert rule[0] == results.rules.force_sentence
    row = dict(zip(heads, first, strict=True))
    assert (row["force_N"], row["difference_N"]) == (results.peak_velocity[0].force_N, None)
    assert units[heads.index("force_N")] == "N"


def test_figures_have_the_size_and_resolution_of_print(results, tmp_path):
    image = pytest.importorskip("matplotlib.image")
    for path in write_figures(tmp_path, make_plots(results)["currents"]):
        height, width, _ = image.imread(path).shape
        assert width == 2700 and height > 1000


def test_without_the_packages_one_line_says_what_is_missing(results, tmp_path, monkeypatch):
    monkeypatch.setattr("ces_identify.characteristics.page.find_spec", lambda name: None)
    files = write_characteristics(tmp_path, results, PageHead())
    assert {file.suffix for file in files} == {".html", ".csv"}
    assert "openpyxl" in missing_packages() and "ces_observer[workbook]" in missing_packages()


def test_the_page_shows_measured_beside_simulated(results):
    page = format_page(results, PageHead(command="ces characterise dyno --model law"), make_plots(results))
    assert len(page) < 1_500_000
    for text in (
        "Force over current",
        "magnetic hysteresis",
        "Range and ratio",
        "Work per cycle",
        "Response of the valve",
        "law [N]",
    ):
        assert text in page
    assert "0.3 A, law" in page
    assert "ces characterise dyno --model law" in page


def test_a_long_table_shows_conditions_of_every_current(results):
    table = peak_table(results)
    conditions = [(0.0, 200), (0.5, 1), (1.0, 80)]  # current, number of conditions, each in two directions
    rows = [
        replace(table.rows[0], current_A=current, frequency_Hz=1.0 + n)
        for current, count in conditions
        for n in range(count)
        for direction in range(2)
    ]
    chosen = choose_rows(replace(table, rows=rows))
    assert len(chosen.rows) + chosen.left_out == len(rows) and len(chosen.rows) < 1.2 * MAX_ROWS
    assert {row.current_A for row in chosen.rows} == {0.0, 0.5, 1.0}
    shown = [(row.current_A, row.frequency_Hz) for row in chosen.rows]
    assert all(shown.count(one) == 2 for one in shown)


def test_a_simulation_without_a_force_has_dashes_under_its_own_heading(results):
    """Two simulations, the first of them without a force at one condition: its cells are empty, not the other's."""
    lost = results.peak_velocity[0].current_A
    first = tuple(
        replace(r, source="first") for r in results.peak_velocity if r.source == "law" and r.current_A != lost
    )
    two = replace(results, sources=("measured", "first", "law"), peak_velocity=(*results.peak_velocity, *first))
    table = peak_table(two)
    headings = [column.heading for column in table.columns]
    cells = [dict(zip(headings[-4:], [c.text(row) for c in table.columns[-4:]], strict=True)) for row in table.rows]
    for row, own in zip(table.rows, cells, strict=True):
        assert (own["first [N]"] == "–") == (row.current_A == lost)
        assert own["law [N]"] != "–"
    assert "".join(table.to_html().split()).count("<td") == len(headings) * len(table.rows)


def test_the_page_without_cycles_says_so():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 15.0, 1e-3)
    x = 0.01 * np.convolve(rng.standard_normal(len(t)), np.hanning(200) / 8.0, "same")
    results = characterise(recording_of(t, x, 0.5, 1000.0 * np.gradient(x, t), 5.0))
    page = format_page(results, PageHead(), make_plots(results))
    assert "No cycle repeats at a constant current" in page
    assert "cannot know: the current has no steps" in page
    assert "Work per cycle" not in page


@pytest.mark.parametrize(
    ("value", "spread", "text"),
    [(1234.56, 7.891, "1235 ± 8"), (-0.04953, 0.00021, "−0.04953 ± 0.00021"), (3e4, float("nan"), "30000")],
)
def test_values_are_rounded_to_their_spread(value, spread, text):
    assert format_spread(value, spread) == text


@pytest.fixture(scope="module")
def page(results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("page")
    return write_characteristics(folder, results, PageHead(command="ces characterise dyno --model law.py:force"))[0]


@pytest.mark.slow
def test_the_page_is_legible_on_screen_in_print_and_by_keys(page):
    assert find_faults(page) == []
