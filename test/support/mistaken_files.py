"""A folder with sound bags and a model, and with everything that a user can have wrong."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from samplings import make_sampling
from shared_results import SharedResults
from small_recordings import columns_as_channels, make_columns, write_channels, write_columns

from ces_data.bags.writer import TopicData, write_bag
from ces_observer.model import Envelope, Model
from ces_observer.structures.polynomial import Factor, Polynomial, Term
from ces_rig.loop.rigs import TEMPLATE

RATE = 250.0
LAGS, POWERS = list(range(200)), [0.5, 1.0, 1.5, 2.0]
CAMPAIGN = "bags: {one: one}\nvalidate: {other: two}\nstructures: {polynomial: {terms: [3]}}\n"
MAPPING = "rate: 100\nposition: {column: x, scale: 0.001}\ncurrent: {constant: 0.2}\nforce: {column: F}\n"
TEXTS = {
    "taken": "mine", "taken.c": "mine", "head.h": "mine", "taken.png": "mine", "full/note": "mine", "page.html": "mine",
    "README.md": "our recordings", "broken.fmu": "PK", "law.py": """\
import numpy as np
from ces_gap.effects.effect import Effect
def force(time_s, position_m, current_A): return 1200.0 * np.gradient(position_m, time_s) * (0.5 + current_A)
def turned(time_s, position_m, current_A): return -force(time_s, position_m, current_A)
def raises(time_s, position_m, current_A): raise RuntimeError("no licence")
def nothing(time_s, position_m, current_A): return force(time_s, position_m, current_A) * np.nan
def short(time_s, position_m, current_A): return force(time_s, position_m, current_A)[:-1]
""",
    "front.yaml": "position: {field: 'position[front_damper]'}\n", "still.yaml": "position: {constant: 0.0}\n",
    "load.yaml": "force: {topic: load, type: std_msgs/msg/Float32, field: data, scale: -2.0}\n",
    "explode.yaml": "\n".join(
        f"{name}: {{lags: {LAGS}, powers: {POWERS}, forms: [signed, magnitude]}}"
        for name in ("speed", "current", "position")
    ) + "\nforce: {lags: [1]}\nproducts: [[speed, current, position]]\n",
    "campaign.yaml": CAMPAIGN, "absent.yaml": CAMPAIGN.replace("two", "nowhere"),
    "reversed.yaml": CAMPAIGN.replace("one: one", "one: turned"),
    "twice.yaml": CAMPAIGN.replace("one: one", "one: [one, copy]"),
    "map.yaml": MAPPING, "signals.yaml": "/**:\n  ros__parameters: {position: {topic: x}}\n",
    "a.csv": "x,F\n1,2\n3,oops\n", "b.csv": "x,F\n1,2\n2,3\n", "sub/b.csv": "x,F\n1,2\n2,3\n",
    "i1.yaml": "limits: [1, 2]\nrig: {kind: virtual}\n", "i2.yaml": TEMPLATE.replace("kind: virtual", "kind: cloud"),
    "i3.yaml": TEMPLATE.replace("budget_s: 60", "budget_s: -3"), "i5.yaml": "limits: {",
    "i4.yaml": TEMPLATE.replace("validate: []", "validate: [missing]"), "i6.yaml": TEMPLATE,
}  # fmt: skip
MODELS: dict[str, Callable[[dict[str, Any]], object]] = {
    "no_envelope.json": lambda m: m.pop("force_envelope_N"),
    "old.json": lambda m: m.update(schema="ces-model/0"),
    "nan.json": lambda m: m["terms"][0].update(coefficient=float("nan")),
    "lag.json": lambda m: m["terms"][0].update(factors=[{"signal": "force", "lag": 10**6}]),
}
Columns = dict[str, NDArray[np.float64]]
CHANGES: dict[str, Callable[[Columns], Columns]] = {
    "still": lambda c: {**c, "position": 0.0 * c["position"] + 0.01},
    "spotted": lambda c: {**c, "position": np.where(np.arange(len(c["position"])) % 3 == 0, np.nan, c["position"])},
    "infinite": lambda c: {**c, "force": c["force"] * np.inf},
    "unfed": lambda c: {**c, "current": c["current"] * np.nan},
    "mm": lambda c: {**c, "position": 1e3 * c["position"]},
    "mA": lambda c: {**c, "current": 1e3 * c["current"]},
    "kN": lambda c: {**c, "force": 1e-3 * c["force"]},
    "turned": lambda c: {**c, "force": -c["force"]},
    "mirrored": lambda c: {**c, "position": -c["position"]},
    "clipped": lambda c: {**c, "force": np.clip(c["force"], -300.0, 300.0)},
    "loose": lambda c: {**c, "force": 0.0 * c["force"] + 7.0},
}
SECONDS = {"s06": (0.6, 500.0), "s12": (1.2, 500.0), "s03": (0.3, RATE), "s3": (3.0, RATE), "coarse": (6.0, 40.0)}


def fill_with_mistakes(here: Path, shared_model: SharedResults) -> None:
    """Write everything into an empty folder."""
    for name, text in TEXTS.items():
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).write_text(text)
    for name in ("one", "two"):
        shutil.copytree(shared_model.folder / name, here / name)
    for name in ("model.json", "rules.yaml"):
        shutil.copy(shared_model.folder / name, here / name)
    shutil.copytree(here / "one", here / "copy")
    write_bags(here)
    whole = (here / "one" / "one.mcap").read_bytes()
    shutil.copytree(here / "one", here / "torn_bag")
    for path, content in (("torn_bag/one.mcap", whole[:5000]), ("cut.mcap", whole[:9000]), ("empty.mcap", b"")):
        (here / path).write_bytes(content)
    for name, change in MODELS.items():
        raw = json.loads(shared_model.model.read_text())
        change(raw)
        (here / name).write_text(json.dumps(raw))
    (here / "cut.json").write_text(shared_model.model.read_text()[:200])
    body = Polynomial((Term(1200.0, (Factor("speed", 0),)), Term(1.0, (Factor("current", 0),))))
    narrow = Model(make_sampling(200.0, 0.02), body, Envelope((-0.05, 0.05), (-2.0, 2.0), (1.5, 2.0)), (-3e4, 3e4))
    narrow.save(here / "narrow.json")
    (here / "empty").mkdir()
    for name in ("mine_on_two", "model_on_two", "model_on_one", "model_and_law-force_on_one_and_two"):
        (here / "empty" / f"{name}.html").write_text("mine")
    (here / "taken.csv").write_text("mine")


def write_bags(here: Path) -> None:
    """Write the bags with samples, times and topics that are wrong."""
    t, columns = make_columns(8.0, 2, RATE)
    for name, change in CHANGES.items():
        write_columns(here / name, t, change(columns))
    for name, (seconds, rate) in SECONDS.items():
        write_columns(here / name, *make_columns(seconds, 2, rate))
    sound = columns_as_channels(t, columns)
    current, position = sound["current"], sound["position"]
    early = replace(current, stamps_ns=current.stamps_ns[:1000], values=current.values[:1000])
    back = replace(position, stamps_ns=np.where(t > 3.0, position.stamps_ns - 2 * 10**9, position.stamps_ns))
    slow = replace(position, stamps_ns=position.stamps_ns[::120], values=position.values[::120])
    write_channels(here / "half", {**sound, "current": early})
    write_channels(here / "back", {**sound, "position": back})
    write_channels(here / "rates", {**sound, "position": slow})
    stamps = np.arange(1, 100) * 10**7
    write_bag(here / "other", (TopicData("/other", "std_msgs/msg/Float64", stamps, {"data": stamps * 1e-9}),))
    write_bag(here / "none", ())
