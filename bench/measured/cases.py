"""Measured dampers as cases: recordings to identify on, and recordings of the same damper to test on.

The logs lie in the folder that CES_DATA names (default: `shared/data` beside the project), a folder for each rig.
Position and force are positive in compression: where a log has them otherwise, so that the damper would give energy,
the sign of its force is changed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_trapezoid

from ces_data.logs.log_import import import_log
from ces_data.logs.log_mapping import load_dyno_mapping
from ces_data.recording import Channel, Recording
from ces_observer.errors import RecordingError
from ces_observer.signals import UNITS

ROOT = Path(__file__).resolve().parents[2]
SHARE = 0.6  # of a recording to identify on, where its rest is the test
KEIO_SHARE = 0.75  # 1,500 of 2,000 samples


@dataclass(frozen=True)
class MeasuredCase:
    """Recordings to identify on, and recordings to test on, which decide nothing in a fit, by their names."""

    identification: Sequence[Recording]
    tests: Mapping[str, Recording]


def data_folder() -> Path:
    return Path(os.environ.get("CES_DATA", ROOT.parent / "shared" / "data"))


@cache
def read_measured(rig: str, name: str) -> Recording:
    """Return the recording in a file of a rig's folder, by the mapping that is named for the rig."""
    mapping = load_dyno_mapping(ROOT / "config" / "import" / f"{rig}.yaml")
    return dissipative(import_log(data_folder() / rig / name, mapping))


def dissipative(recording: Recording) -> Recording:
    """Return the recording with the sign of the force with which the damper takes energy."""
    position, force = recording.channel("position"), recording.channel("force")
    work = np.trapezoid(force.values - force.values.mean(), position.values)
    turned = replace(force, values=np.sign(work) * force.values)
    return replace(recording, channels={**recording.channels, "force": turned})


def split_each(recordings: Sequence[Recording], share: float = SHARE) -> MeasuredCase:
    """Return the first share of each recording to identify on and its rest to test on."""
    return MeasuredCase(
        [r.share(0.0, share) for r in recordings], {f"{r.name}, rest": r.share(share, 1.0) for r in recordings}
    )


def keio(with_speed: bool) -> MeasuredCase:
    """Return Keio's first 1,500 samples and its last 500, whose stroke is the integral of their speed."""
    log = data_folder() / "keio_mr" / "first_2000.csv"
    if not log.exists():
        raise RecordingError(f"{log}: no such file")
    seconds, speed, force = np.loadtxt(log, delimiter=",", skiprows=1).T
    signals = {"position": cumulative_trapezoid(0.01 * speed, seconds, initial=0.0), "force": -force}
    signals |= {"speed": 0.01 * speed} if with_speed else {}
    stamps = np.rint(1e9 * seconds).astype(np.int64)
    channels = {name: Channel(name, UNITS[name], stamps, values) for name, values in signals.items()}
    return split_each([Recording(log.stem, channels, {"current": 1.25})], KEIO_SHARE)


def rest_of(rig: str, *names: str) -> MeasuredCase:
    """Return the first part of each recording to identify on, its rest to test on."""
    return split_each([read_measured(rig, name) for name in names])


def others(rig: str, identification: Sequence[str], tests: Sequence[str]) -> MeasuredCase:
    """Return whole recordings to identify on and others to test on."""
    read = partial(read_measured, rig)
    return MeasuredCase([read(name) for name in identification], {r.name: r for r in map(read, tests)})


SOFT_SLOW, SOFT_FAST = "t1_1_1_18_18_s1_n10_150psi.csv", "t1_1_1_18_18_s5_n10_150psi.csv"
TABLE = {k: f"ensaio.A.{k}.mat" for k in (1, 2, 4, 6, 8)}  # amplitudes fall with the number
SWEEPS = tuple(f"sweep_15Hz_{current}A.csv" for current in ("0.0", "0.5", "1.0"))
SHORT_SINES = ("10mm2Hz", "5mm4Hz")
SINES = [f"sine_{sine}_{current}A.csv" for sine in SHORT_SINES for current in ("0.00", "0.50", "1.00")]
SINES_BETWEEN = [f"sine_{sine}_{current}A.csv" for sine in SHORT_SINES for current in ("0.25", "0.75")]
BRAKE_SLOW, BRAKE_FAST = "0.25Hz30lbtension1amplitude.json", "1Hz30lbtension1amplitude.json"
BRAKE_TIGHT = "0.5Hz36lbtension1.5amplitude.json"

# By name, the rig first. A stroke, speed or current beyond those identified on is said in the name.
CASES: dict[str, Callable[[], MeasuredCase]] = {
    "keio": partial(keio, False),
    "keio-speed": partial(keio, True),
    "racing-soft": partial(rest_of, "racing_dyno", SOFT_SLOW, SOFT_FAST),
    "racing-soft-slower": partial(others, "racing_dyno", [SOFT_FAST], [SOFT_SLOW]),
    "racing-soft-faster": partial(others, "racing_dyno", [SOFT_SLOW], [SOFT_FAST]),
    "racing-medium": partial(rest_of, "racing_dyno", "t1_2_2_18_18_s5_n10_50psi.csv"),
    "racing-stiff": partial(rest_of, "racing_dyno", "t1_3_3_24_24_s5_n10_100psi.csv"),
    "table-between": partial(others, "shaking_table_mr", [TABLE[1], TABLE[4], TABLE[8]], [TABLE[2], TABLE[6]]),
    "table-larger": partial(others, "shaking_table_mr", [TABLE[4], TABLE[6], TABLE[8]], [TABLE[1], TABLE[2]]),
    "table-smaller": partial(others, "shaking_table_mr", [TABLE[1], TABLE[2], TABLE[4]], [TABLE[6], TABLE[8]]),
    "dyke": partial(rest_of, "dyke_mr", "ranran_50.csv"),
    "utfsm-sweeps": partial(rest_of, "utfsm_mr", *SWEEPS),
    "utfsm-sines": partial(others, "utfsm_mr", SINES, SINES_BETWEEN),
    "utfsm-currents": partial(others, "utfsm_mr", [*SWEEPS, *SINES], SINES_BETWEEN),
    "pneumatic-1bar": partial(rest_of, "pneumatic_friction", "1_O-ring257_1bar.csv"),
    "pneumatic-5bar": partial(rest_of, "pneumatic_friction", "1_O-ring257_5bar.csv"),
    "brake": partial(rest_of, "brfd_backlash", BRAKE_SLOW, BRAKE_FAST),
    "brake-tighter": partial(rest_of, "brfd_backlash", BRAKE_TIGHT),
    "brake-faster": partial(others, "brfd_backlash", [BRAKE_SLOW], [BRAKE_FAST]),
    "brake-slower": partial(others, "brfd_backlash", [BRAKE_FAST], [BRAKE_SLOW]),
}
