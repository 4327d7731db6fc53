"""The gallery of measured dampers: its table and pictures, of models that exist already."""

import shutil
from pathlib import Path

import numpy as np
from made_recordings import recording_of

from bench import gallery
from ces import Recording, validate

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
            Recording.of(made).save(fit / "recordings" / name)
    gallery.main([str(tmp_path), "--fits", str(tmp_path), "--pictures", str(tmp_path)])
    rows = [row.strip("|").split("|") for row in capsys.readouterr().out.splitlines()[2:]]
    assert [row[1] for row in rows] == ["polynomial", "auto: polynomial"]
    assert rows[0][4].startswith(f"{validate(MODEL, tmp_path / 'd_auto' / 'recordings' / 'b')[0].cost:.1f} (")
    assert 10_000 < (tmp_path / "gallery_d.png").stat().st_size < 100_000
