"""Hydraulic networks from end to end: the report's sections of a model that learned a teacher's force."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import pytest
from planted import stroked
from planted_dampers import planted_model
from programs import NO_SHORT_FITS, ces

from ces_data.bags.writer import recording_topics, write_bag
from ces_identify.report.page import write_report
from ces_observer.model import load_model
from ces_observer.signals import Signals
from ces_report.shell import PageHead

pytestmark = pytest.mark.slow
NETWORK = ("--structure", "hydraulic", "--kind", "uniflow", "--curves", 2)
XHTML = "{http://www.w3.org/1999/xhtml}"


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """A folder with two bags without a force, and a planted model that teaches."""
    folder = tmp_path_factory.mktemp("physical")
    for seed, name in enumerate(("one", "two"), start=1):
        write_bag(folder / name, recording_topics(stroked(seed, 30.0, name), Signals.from_mapping({}, "defaults")))
    planted_model("uniflow").save(folder / "planted.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(*NO_SHORT_FITS)
        yield folder


@pytest.fixture(scope="module")
def taught(work):
    """The model that learned the planted model's force, and its report."""
    words = ("identify", "one", "--validate", "two", "--teacher", "planted.json", *NETWORK, "--rate", 400, "--no-band")
    assert ces(*words, "--out", "taught.json", "--report", "r.html") == 0
    return load_model(work / "taught.json"), ET.fromstring((work / "r.html").read_text(encoding="utf-8"))


def test_its_report_shows_the_damper_with_intervals_and_curves(taught):
    model, root = taught
    section = next(s for s in root.iter(f"{XHTML}section") if s.get("id") == "damper")
    rows = [["".join(cell.itertext()) for cell in row] for row in section.iter(f"{XHTML}tr")]
    assert rows[0] == ["Quantity", "Value", "Standard error", "95\xa0% interval"]
    stiffness = next(row for row in rows if row[0] == "Stiffness of mounts and rod [kN/mm]")
    low, high = map(float, stiffness[3].split(" to "))
    assert float(stiffness[1]) == pytest.approx(1e-6 / model.body.mount_m_N, abs=0.25 * (high - low))  # in its digits
    assert low < float(stiffness[1]) < high
    svgs = list(section.iter("{http://www.w3.org/2000/svg}svg"))
    assert len(svgs) == 3
    paths = [path.get("class") for path in svgs[0].iter("{http://www.w3.org/2000/svg}path")]
    assert {f"interval c{n} area" for n in range(4)} <= set(paths)
    assert {f"curve c{n}" for n in range(4)} <= set(paths)
    assert "standard_errors" not in "".join(root.itertext())


def test_a_model_without_standard_errors_has_the_section_too(work, taught):
    model, _ = taught
    replace(model, provenance={}).save(work / "bare.json")
    write_report(work / "s.html", PageHead("A model"), load_model(work / "bare.json"), [])
    assert "stored without standard errors" in (work / "s.html").read_text(encoding="utf-8")
