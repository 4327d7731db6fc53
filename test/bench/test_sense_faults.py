"""The bench of the sense checks puts in the faults that it counts."""

import numpy as np
import pytest

from bench import sense_faults
from bench.sense_faults import FAULTS, Count, count_findings, delay_rows, format_table
from ces_rig.experiment import find_experiment, load_experiment, run

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def recording():
    return run(load_experiment(find_experiment("noise")))


def test_every_fault_but_none_changes_the_recording(recording):
    for fault in FAULTS:
        changed = fault.change(recording)
        same = all(
            np.array_equal(c.values, changed.channels[n].values)
            and np.array_equal(c.stamps_ns, changed.channels[n].stamps_ns)
            for n, c in recording.channels.items()
        )
        assert same == (fault.name == "none"), fault.name


def test_findings_are_counted(recording, monkeypatch):
    some = [fault for fault in FAULTS if fault.name in ("none", "force in kN", "current in mA")]
    monkeypatch.setattr(sense_faults, "FAULTS", some)
    rows = dict(count_findings([recording]))
    assert rows["none"] == Count(1, 0, 0, 0)
    assert rows["force in kN"] == rows["current in mA"] == Count(1, 1, 1, 0)
    assert "| force in kN | 1 of 1 | 1 | - |" in format_table(list(rows.items()), [])


def test_faults_that_differ_by_a_number_share_a_row():
    rows = [("force 2 ms late", Count(30, 0, 0, 0)), ("force 20 ms late", Count(30, 29, 25, 0))]
    table = format_table(rows, [("force 20 ms late", Count(4, 3, 2, 0))])
    assert "| force 2, 20 ms late | 0, 29 of 30 | 0, 25 | 3 of 4 |" in table


def test_delays_are_compared_with_the_truth(recording):
    (table,) = delay_rows([recording])
    (row,) = (line for line in table.splitlines() if line.startswith("| force -20 ms"))
    assert row.endswith("| 1 of 1 |")
