"""The measured logs, imported into bags as `ces import` does and read as `ces diagnose` reads them."""

from __future__ import annotations

import contextlib
import sys
from dataclasses import dataclass, replace
from pathlib import Path

from ces_cli.bags import import_
from ces_identify.recordings.bag_reader import read_recording
from ces_identify.recordings.recording import Recording
from ces_identify.recordings.signals_file import load_signals

ROOT = Path(__file__).resolve().parents[2]
BRAKES = {
    "0.25 Hz": "0.25Hz30lbtension1amplitude",
    "0.5 Hz": "0.5Hz36lbtension1.5amplitude",
    "1 Hz": "1Hz30lbtension1amplitude",
}
DYKE = "ranran_50"
CURRENTS = ("0.00A", "0.25A", "0.50A", "0.75A", "1.00A")
SLOW, MIDDLE, FAST = "sine_25mm0x5Hz", "sine_10mm2Hz", "sine_5mm4Hz"
SWEEPS = tuple(f"sweep_15Hz_{current}" for current in ("0.0A", "0.5A", "1.0A"))


@dataclass(frozen=True)
class Data:
    """The measured recordings, imported into bags below `bags`."""

    logs: Path
    bags: Path

    def brake(self, name: str) -> Recording:
        """Return a recording of the band brake, by its frequency."""
        return self._import_log(f"brfd_backlash/{BRAKES[name]}.json", "brfd_backlash.yaml")

    def dyke(self) -> Recording:
        return self._import_log(f"dyke_mr/{DYKE}.csv", "dyke_mr.yaml")

    def utfsm(self, name: str) -> Recording:
        """Return a sweep or a sine of UTFSM's damper."""
        return self._import_log(f"utfsm_mr/{name}.csv", "utfsm_mr.yaml")

    def sines(self, stroke: str) -> list[Recording]:
        """Return the five sines of a stroke, by rising current."""
        return [self.utfsm(f"{stroke}_{current}") for current in CURRENTS]

    def _import_log(self, log: str, mapping: str) -> Recording:
        bag = self.bags / Path(log).stem
        if not bag.exists():
            words = [str(self.logs / log), "--mapping", str(ROOT / "config" / "import" / mapping), "--out", str(bag)]
            with contextlib.redirect_stdout(sys.stderr):
                import_.main(words)
        return read_recording(bag, load_signals(ROOT / "config" / "signals.yaml"))


def between(recording: Recording, from_s: float, to_s: float) -> Recording:
    """Return the recording from `from_s` to before `to_s` after the first position."""
    begin = recording.channel("position").stamps_ns[0]
    low, high = (begin + round(1e9 * s) for s in (from_s, to_s))
    channels = {n: c.select((c.stamps_ns >= low) & (c.stamps_ns < high)) for n, c in recording.channels.items()}
    return replace(recording, channels=channels, source="", sha256="")
