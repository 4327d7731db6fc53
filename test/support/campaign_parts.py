"""Small recordings and a small campaign for the tests of campaigns."""

import numpy as np

from ces_data.bags.writer import recording_topics, write_bag
from ces_data.recording import Channel, Recording
from ces_observer.signals import Signals

DEFAULT = Signals.from_mapping({}, "defaults")
RATE_HZ = 250.0
RULES = """\
force: {lags: [1]}
speed: {lags: [0, 2], powers: [0.5, 1.0], forms: [signed, magnitude]}
current: {lags: [0], powers: [1.0], forms: [magnitude]}
products: [[], [speed], [speed, current], [force]]
"""
CAMPAIGN = """\
bags:
  one: [one]
  both: [one, two]
validate:
  other: two
structures:
  polynomial: {terms: [2, 4], method: random, candidates: rules.yaml}
  sigmoid: {units: 2}
seed: [1, 2]
limits: {time: 600}
"""


def made(seed, seconds=8.0, name="made"):
    """A recording of a damper whose force depends on the root of speed and on current."""
    random = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    x = 0.01 * np.sin(2 * np.pi * 3 * t) + 0.004 * np.sin(2 * np.pi * 7.3 * t + seed)
    v = np.gradient(x, t)
    i = 0.5 + 0.15 * np.sin(2 * np.pi * 0.7 * t)
    force = np.sign(v) * np.abs(v) ** 0.5 * (400 + 1500 * i) + 100 * v + random.normal(0, 3, len(t))
    stamps = 10**18 + np.rint(t * 1e9).astype(np.int64)
    columns = {"position": (x, "m"), "current": (i, "A"), "force": (force, "N")}
    channels = {key: Channel(key, unit, stamps, values) for key, (values, unit) in columns.items()}
    return Recording(name, channels, sha256=f"made from {seed}")


def furnish(folder, text=CAMPAIGN):
    """Write two bags, candidate rules and a campaign into `folder`; return the campaign's path."""
    for seed, name in enumerate(("one", "two"), start=1):
        write_bag(folder / name, recording_topics(made(seed, name=name), DEFAULT))
    (folder / "rules.yaml").write_text(RULES)
    (folder / "campaign.yaml").write_text(text)
    return folder / "campaign.yaml"
