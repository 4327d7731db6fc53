"""The parameter files that are shipped say what the code takes for granted."""

from __future__ import annotations

from pathlib import Path

from ces_data.signals_file import load_signals
from ces_observer.signals import Signals

CONFIG = Path(__file__).resolve().parent.parent / "config"


def test_shipped_signals_are_the_defaults() -> None:
    defaults = dict(Signals.from_mapping({}, "defaults").by_name)
    for name in ("signals.yaml", "observer.yaml"):
        assert dict(load_signals(CONFIG / name).by_name) == defaults, name
