"""A structure that nothing here has heard of: registered once on the vehicle and once offline, and all of it works."""

import json
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from planted import RATE_HZ, SAMPLING, WIDE, planted

from ces_cli.identify.program import select_identify_function
from ces_cli.identify.request import IdentifyProgramRequest
from ces_cli.identify.validate import print_proof
from ces_cli.terminal import terminal
from ces_identify import structures as offline
from ces_identify.numerics.search import SearchResult
from ces_identify.prepare.series import prepare
from ces_identify.report.page import write_report
from ces_identify.simulations.simulate import sample_force, simulate_series
from ces_identify.structures.kit import Fitted, IdentifyOptions, StructureKit
from ces_observer import structures as on_vehicle
from ces_observer.control.inverse_map import steady_force
from ces_observer.errors import ModelError
from ces_observer.estimator import Estimator
from ces_observer.model import Model, load_model, parse_model
from ces_observer.nodes.model_check import require_stable
from ces_observer.options import Option
from ces_observer.proof.certificate import Certificate
from ces_observer.records import bounded
from ces_observer.structures.structure import Structure
from ces_report.shell import PageHead
from ces_report.table import parameter_section


@dataclass(frozen=True)
class Dissipative(Certificate):
    """A proof of another kind than a contraction: it has a bound of its own, and asks for no envelope."""

    viscosity: float
    claim: ClassVar[str] = "force times speed is never negative"
    method: ClassVar[str] = "sign of the viscosity"

    @property
    def holds(self) -> bool:
        return self.viscosity > 0.0

    @property
    def force_N(self) -> float:
        return np.inf

    @property
    def bounds(self) -> Mapping[str, float]:
        return {"viscosity_Ns_m": self.viscosity}

    @property
    def doubt(self) -> str:
        return "it drives the motion"

    @property
    def rows(self) -> tuple[tuple[str, str], ...]:
        return (("viscosity", f"{self.viscosity:g} N s/m"),)


class DashpotRun:
    """The free run: no past at all."""

    def __init__(self, viscosity: float) -> None:
        self.viscosity, self.clamped, self.held = viscosity, False, False

    def reset(self) -> None:
        """Nothing to forget."""

    def tick(self, position: float, speed: float, current: float) -> float:
        return self.viscosity * speed


@dataclass(frozen=True)
class Dashpot(Structure):
    """Force = viscosity times speed."""

    name: ClassVar[str] = "dashpot"
    option: ClassVar[str] = "dashpot"
    unproved: ClassVar[str] = "it is not proved to dissipate"
    viscosity: float = bounded(-1e6, 1e6, key="viscosity_Ns_m")

    @property
    def size(self) -> str:
        return "1 dashpot"

    def make_predictor(self, within):
        return DashpotRun(self.viscosity)

    def certify(self, within):
        return Dissipative(self.viscosity)


def fit(share):
    def fitter(training, sampling, options, listener):
        v, f = (np.concatenate([getattr(s, name) for s in training]) for name in ("speed", "force"))
        model = Model(sampling, Dashpot(share * float(v @ f / (v @ v))), WIDE, (-1e5, 1e5))
        certificate = model.certify().to_mapping() if options.certificate else None
        model = Model(sampling, model.body, WIDE, (-1e5, 1e5), certificate)
        found = SearchResult(np.arange(1), np.array([model.body.viscosity]), 60.0, 1, 1, "solved")
        return Fitted(model, [found], {"method": "least squares"})

    return fitter


def table(body, model, runs, role):
    return parameter_section("A dashpot.", ("Of", "N s/m"), [("it", str(body.viscosity))])


KIT = StructureKit(
    about="a dashpot",
    body=Dashpot,
    sizes=(Option("percent", 100, "share of the least squares", 1, 200),),
    fitter=lambda sizes: fit(0.01 * sizes["percent"]),
    batch_run=lambda body, within, inputs, segments: (body.viscosity * inputs[1], inputs[1] == np.inf),
    table=table,
)


@pytest.fixture(autouse=True)
def registered(monkeypatch):
    monkeypatch.setitem(on_vehicle.STRUCTURES, Dashpot.name, Dashpot)
    monkeypatch.setitem(offline.KITS, KIT.option, KIT)


def model(viscosity=800.0):
    return Model(SAMPLING, Dashpot(viscosity), WIDE, (-1e5, 1e5))


def test_it_goes_through_a_model_file(tmp_path):
    model().save(tmp_path / "m.json")
    assert load_model(tmp_path / "m.json") == model()
    raw = json.loads(model().to_json())
    assert (raw["structure"], raw["viscosity_Ns_m"]) == ("dashpot", 800.0)
    with pytest.raises(ModelError, match="unknown key 'terms'"):
        parse_model(json.dumps({**raw, "terms": []}), "m.json")


def test_it_runs_at_the_desk_and_without_a_tick_in_no_estimator():
    recording = planted(model(), 1)
    series, run = prepare(recording, SAMPLING), model().make_predictor()
    rows = series.inputs.T
    expected = [run.tick(*row) for row in rows.tolist()]
    np.testing.assert_allclose(simulate_series(model(), series).force, expected, rtol=1e-12)
    assert np.isfinite(sample_force(model(), recording)).mean() > 0.9
    with pytest.raises(ModelError, match="structure 'dashpot' has no tick"):
        Estimator(model())


def test_its_own_proof_decides(capsys):
    require_stable(model(), "m.json")
    with pytest.raises(ModelError, match="it is not proved to dissipate; identify it again"):
        require_stable(model(-1.0), "m.json")
    assert print_proof(model(), model().certify(), "m.json") == 0
    assert "proved: force times speed is never negative (sign of the viscosity)" in capsys.readouterr().out
    assert print_proof(model(-1.0), model(-1.0).certify(), "m.json") == 1
    assert "it drives the motion" in capsys.readouterr().out


def test_the_controller_can_invert_it():
    assert steady_force(model(), model().make_predictor(), 0.5, 0.5) == 400.0


@pytest.mark.slow
def test_it_is_identified_by_its_name_and_reported(tmp_path):
    words = shlex.split("--structure dashpot --percent 50")
    assert terminal.read(IdentifyProgramRequest, ["bag"]).model.structure == "polynomial"
    identify = select_identify_function(terminal.read(IdentifyProgramRequest, ["bag", *words]).model)
    found = identify([planted(model(), 1)], [planted(model(), 2)], IdentifyOptions(rate=RATE_HZ))
    assert found.model.body.viscosity == pytest.approx(400.0, rel=0.05)
    assert found.model.certificate["viscosity_Ns_m"] == found.model.body.viscosity
    assert found.model.provenance["selection"]["method"] == "least squares"
    write_report(tmp_path / "r.html", PageHead("Dashpot"), found.model, found.evaluations)
    assert "A dashpot." in (tmp_path / "r.html").read_text(encoding="utf-8")
