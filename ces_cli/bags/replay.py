"""`ces replay`: runs the estimator over a recording as the observer node would, and writes a new bag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ces_cli.terminal import terminal
from ces_cli.terminal.options import JSON, MODEL, ONE_BAG, OVERWRITE, SIGNALS
from ces_cli.terminal.outputs import print_document, require_outputs
from ces_cli.terminal.recordings import find_bag
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.recording import Recording
from ces_identify.prepare.series import hold_current, hold_motion
from ces_identify.validation.evaluate import describe_outside, find_outside
from ces_observer.estimator import Estimator
from ces_observer.model import Model, load_model
from ces_observer.options import Option
from ces_observer.signals import Signal

ESTIMATE_TOPIC = "/observer/estimate"
BAND_TOPIC = "/observer/estimate_band"
TYPE = "sensor_msgs/msg/JointState"
KEYS = ("position", "velocity", "effort")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    options = make_parser().parse_args(argv)
    path = find_bag(options.bag)
    require_outputs(options.overwrite, bags={"--out": options.out}, inputs=[options.model, path, options.signals])
    signals = terminal.load_described_signals(options)
    model = load_model(options.model)
    recording = terminal.read_one(path, signals)
    with terminal.err.status(f"replaying {recording.name}"):
        rows, reasons = estimate_forces(model, recording)
        position = signals["position"]
        steps = position.field.steps if isinstance(position, Signal) else ()
        joint = next((element for _, element in steps if isinstance(element, str)), "damper")
        topics = [*recording_topics(recording, signals)]
        topics.append(_joint_states(ESTIMATE_TOPIC, rows, {f"{key}[{joint}]": i for i, key in enumerate(KEYS, 1)}))
        if model.band is not None:
            bounds = {f"effort[{joint}_lower]": 4, f"effort[{joint}_upper]": 5}
            topics.append(_joint_states(BAND_TOPIC, rows, bounds))
        write_bag(options.out, topics, overwrite=options.overwrite, notes={"model_sha256": model.digest()})
    samples = len(recording.channel("position"))
    if options.json:
        force = [float(row[3]) for row in rows]
        facts = {"recording": recording.name, "bag": options.out, "position_samples": samples, "estimates": len(rows)}
        facts |= {"withheld": dict(reasons.most_common()), "force_N": [min(force), max(force)] if force else None}
        print_document("replay", facts)
        return 0
    print(f"{len(rows)} forces estimated from {samples} position samples")
    for reason, count in reasons.most_common():
        print(f"  withheld {count}: {reason}")
    if len(rows):
        _warn_outside(model, recording, rows)
    print(f"bag: {options.out}")
    return 0


def _warn_outside(model: Model, recording: Recording, rows: NDArray[np.float64]) -> None:
    current = hold_current(recording, rows[:, 0].astype(np.int64), model.sampling.max_current_age_s)
    position, speed = (rows[:, column].astype(np.float64) for column in (1, 2))
    uses = find_outside(model, {"position": position, "speed": speed, "current": current})
    if uses:
        share = max(use.outside_share for use in uses)
        terminal.print_warning(describe_outside(recording.name, share, uses))


def estimate_forces(model: Model, recording: Recording) -> tuple[NDArray[np.float64], Counter[str]]:
    """Return rows (n, 6) of stamp [ns], position [m], speed [m/s], force [N] and its bounds [N]; reasons where none.

    Without a band, the bounds are NaN.
    """
    estimator = Estimator(model)
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, model.sampling.max_current_age_s)
    rows: list[tuple[int, float, float, float, float, float]] = []
    reasons: Counter[str] = Counter()
    motion = hold_motion(recording, position.stamps_ns, model.sampling)
    columns = (position.stamps_ns, position.values, current, motion)
    for stamp, x, c, m in zip(*(column.tolist() for column in columns), strict=True):
        force = estimator.step(stamp, x, c, m)
        if force is None:
            reasons[estimator.reason] += 1
        else:
            half_width = estimator.half_width()
            width = nan if half_width is None else half_width
            rows.append((stamp, estimator.position, estimator.speed, force, force - width, force + width))
    return np.array(rows, dtype=object).reshape(-1, 6), reasons


def _joint_states(topic: str, rows: NDArray[np.float64], columns: Mapping[str, int]) -> TopicData:
    values = {field: rows[:, column].astype(np.float64) for field, column in columns.items()}
    return TopicData(topic, TYPE, rows[:, 0].astype(np.int64), values)


def make_parser() -> terminal.Parser:
    """Return the parser of the program's options."""
    return terminal.parser(
        "replay",
        "Run the estimator over a recording as the observer node would, and write its inputs and estimates to a bag "
        f"(topic {ESTIMATE_TOPIC}: position, velocity, and the estimated force as effort; {BAND_TOPIC}: its bounds, if "
        "the model has a band).",
        "ces replay model.json bags/road --out out/road_replayed",
        *(MODEL, ONE_BAG, SIGNALS),
        Option("out", meaning="bag folder to write", kind=Path, metavar="BAG2"),
        *(JSON, OVERWRITE),
    )
