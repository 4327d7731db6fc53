"""The benches of measured dampers: tables, cases, how a peer's setting is chosen, and the gallery's picture."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from made_recordings import recording_of

from bench import gallery
from bench.measured.__main__ import format_rows, summarise
from bench.measured.cases import CASES, MeasuredCase, data_folder
from bench.measured.regressions import PeerModel
from bench.measured.ticks import prepare_case
from bench.measured.tools import fit_peer
from ces import validate
from ces_identify.scripting.recording import with_methods

TIME = np.arange(0.0, 8.0, 2e-3)


def test_the_least_cost_is_bold_and_the_regret_of_auto_is_said():
    costs = {"rig": {"polynomial": 4.0, "auto": 5.0, "GRU": 3.0}, "other": {"polynomial": 2.0, "auto": 2.0}}
    assert format_rows(costs) == [
        ["case", "polynomial", "auto", "GRU"],
        ["rig", "4.00", "5.00", "**3.00**"],
        ["other", "**2.00**", "**2.00**", "-"],
    ]
    assert summarise(costs).endswith("at most 1.25 (rig). Better than `auto`: rig (GRU).")


def test_a_setting_is_chosen_on_blocks_left_out_and_fitted_again_to_all():
    phase = 2.0 * np.pi * TIME
    made = recording_of(TIME, position=0.02 * np.sin(phase), current=0.0 * phase, force=500.0 * np.cos(phase))
    seen = []

    def fit(estimation, selection, gain):
        seen.append((gain, sum(map(len, estimation)), sum(map(len, selection))))
        return PeerModel(lambda series: gain * series.speed)

    settings = {f"{gain:g}": lambda *data, gain=gain: fit(*data, gain) for gain in (1000.0, 4000.0, 9000.0)}
    simulate, chosen = fit_peer(settings, case := prepare_case(MeasuredCase([made], {"again": made})))
    assert chosen == "4000"
    assert seen[-1] == (4000.0, len(TIME), 0)
    assert case.test_cost(simulate) < 5.0


@pytest.mark.skipif(not data_folder().is_dir(), reason=f"measured recordings are not in {data_folder()} (set CES_DATA)")
@pytest.mark.parametrize("name", ["keio-speed", "racing-soft", "table-between", "pneumatic-1bar", "brake-faster"])
def test_every_damper_takes_energy(name):
    case = CASES[name]()
    for recording in (*case.identification, *case.tests.values()):
        position, force = (recording.channel(signal).values for signal in ("position", "force"))
        assert np.corrcoef(np.gradient(position), force)[0, 1] > 0.5


MODEL = Path(__file__).resolve().parents[2] / "config" / "models" / "sample.json"
TIME = np.arange(0.0, 6.0, 1e-3)


def test_a_damper_has_a_row_for_each_structure_and_a_picture(tmp_path, monkeypatch, capsys):
    (tmp_path / "rig").mkdir()
    damper = gallery.MeasuredDamper("D", "rig", ("a.*",), ("b.*",), {"b": (2, 3)})
    monkeypatch.setattr(gallery, "DAMPERS", {"d": damper})
    for name, hertz in {"a": 2.0, "b": 3.0}.items():
        (tmp_path / "rig" / f"{name}.csv").touch()
        phase = 2.0 * np.pi * hertz * TIME
        made = recording_of(TIME, position=0.02 * np.sin(phase), current=0.5 + 0 * phase, force=900.0 * np.cos(phase))
        for structure in gallery.STRUCTURES:
            fit = tmp_path / f"d_{structure}"
            (fit / "recordings").mkdir(parents=True, exist_ok=True)
            shutil.copy(MODEL, fit / "model.json")
            with_methods(made).save(fit / "recordings" / name)
    gallery.main([str(tmp_path), "--fits", str(tmp_path), "--pictures", str(tmp_path)])
    rows = [row.strip("|").split("|") for row in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == ["polynomial", "auto: polynomial"]
    assert rows[0][4].startswith(f"{validate(MODEL, tmp_path / 'd_auto' / 'recordings' / 'b')[0].cost:.1f} (")
    assert 10_000 < (tmp_path / "gallery_d.png").stat().st_size < 100_000
