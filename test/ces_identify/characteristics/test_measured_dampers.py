"""Measured dampers (recordings outside of the project): what a damper engineer expects of them comes out."""

import os
from pathlib import Path

import pytest

from ces_data.reading import read_log
from ces_identify.characteristics.characterise import characterise

ROOT = Path(__file__).resolve().parents[3]
DATA = Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))
measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"measured recordings are not in {DATA} (set CES_DATA)")
pytestmark = [pytest.mark.slow, measured, pytest.mark.filterwarnings("ignore")]


def read(folder, pattern):
    mapping = ROOT / f"config/import/{folder}.yaml"
    return [read_log(path, mapping=mapping) for path in sorted((DATA / folder).glob(pattern))]


def test_a_magnetorheological_damper_on_sines():
    """Five currents, three strokes: forces and work rise with the current."""
    results = characterise(read("utfsm_mr", "sine_*.csv"))
    assert len(results.work) == 15
    for frequency in (0.5, 2.0, 4.0):
        rows = [r for r in results.work if r.frequency_Hz == pytest.approx(frequency, rel=0.05)]
        assert [r.current_A for r in rows] == pytest.approx([0.0, 0.25, 0.5, 0.75, 1.0], abs=0.01)
        work = [r.work_J for r in rows]
        assert work == sorted(work)
        assert work[-1] > 5.0 * work[0]
        assert all(r.work_sd_J < 0.03 * r.work_J for r in rows)
    compressions = [r for r in results.peak_velocity if r.direction == "compression"]
    assert all(r.force_N > 0.0 for r in compressions)


def test_random_motion_and_voltage_have_quantiles_for_both_levels():
    results = characterise(read("dyke_mr", "*.csv"))
    assert not results.work
    assert not results.responses
    low, high = sorted({(b.current_from_A, b.current_to_A) for b in results.speed_bins})
    assert low[1] < 0.6
    assert high[1] > 2.0

    def force_at(level, speed):
        rows = [b for b in results.speed_bins if (b.current_from_A, b.current_to_A) == level]
        return min(rows, key=lambda b: abs(b.speed_from_m_s - speed)).median_N

    assert force_at(high, 0.05) > 1.5 * force_at(low, 0.05) > 0.0
