"""`ces replay`: runs the estimator over a recording as the observer node would, and writes a new bag."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ces_cli.terminal import terminal
from ces_cli.terminal.options import MODEL, ONE_BAG, BagRequest, option
from ces_cli.terminal.outputs import print_document
from ces_data.bags.find import find_bag
from ces_data.bags.writer import TopicData, recording_topics, write_bag
from ces_data.outputs import OUT, require_outputs
from ces_data.recording import Recording
from ces_data.signals_file import load_signals
from ces_identify.prepare.series import hold_current, hold_motion
from ces_identify.validation.evaluate import describe_held, describe_outside, find_outside
from ces_observer.estimator import Estimator
from ces_observer.model import Model, load_model
from ces_observer.reasons import OK
from ces_observer.records import declare
from ces_observer.signals import Signal

ESTIMATE_TOPIC, DELAYED_TOPIC = "/observer/estimate", "/observer/estimate_delayed"
TYPE = "sensor_msgs/msg/JointState"
KEYS = ("position", "velocity", "effort")


@dataclass(frozen=True, kw_only=True)
class ReplayRequest(BagRequest):
    """What `ces replay` is asked for."""

    program = "replay"
    about = (
        "Run the estimator over a recording as the observer node would, and write its inputs and estimates to a bag "
        f"(topic {ESTIMATE_TOPIC}: position, velocity, and the estimated force as effort; {DELAYED_TOPIC}: the same of "
        "a model with a delay; with _band: their bounds, if the model has a band)."
    )
    example = "ces replay model.json bags/road --out out/road_replayed"

    model: Path = declare(MODEL)
    bag: str = declare(ONE_BAG)
    out: Path = option(meaning="bag folder to write", metavar="BAG2")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the program; returns the exit status."""
    request = terminal.read(ReplayRequest, argv)
    path = find_bag(request.bag)
    require_outputs(request.overwrite, bags={OUT: request.out}, inputs=[request.model, path, request.signals])
    signals = load_signals(request.signals)
    model = load_model(request.model)
    recording = terminal.read_one(path, signals)
    with terminal.step(f"replaying {recording.name}"):
        replayed = estimate_forces(model, recording)
        position = signals["position"]
        steps = position.field.steps if isinstance(position, Signal) else ()
        joint = next((element for _, element in steps if isinstance(element, str)), "damper")
        topic = DELAYED_TOPIC if model.sampling.delay_ticks else ESTIMATE_TOPIC
        estimates = {f"{key}[{joint}]": i for i, key in enumerate(KEYS, 1)}
        topics = [*recording_topics(recording, signals), _joint_states(topic, replayed.rows, estimates)]
        if model.band is not None:
            bounds = {f"effort[{joint}_lower]": 4, f"effort[{joint}_upper]": 5}
            topics.append(_joint_states(f"{topic}_band", replayed.rows, bounds))
        write_bag(request.out, topics, overwrite=request.overwrite, notes={"model_sha256": model.digest()})
    samples, reasons = len(recording.channel("position")), dict(replayed.reasons.most_common())
    if request.json:
        force = [float(row[3]) for row in replayed.rows]
        facts = {"recording": recording.name, "bag": request.out, "position_samples": samples}
        facts |= {"delay_s": model.sampling.delay_s, "estimates": len(force), "withheld": reasons}
        print_document("replay", facts | {"force_N": [min(force), max(force)] if force else None})
        return 0
    delay = f" {1e3 * model.sampling.delay_s:g} ms late" if model.sampling.delay_ticks else ""
    print(f"{len(replayed.rows)} forces estimated{delay} from {samples} position samples")
    for reason, count in reasons.items():
        print(f"  withheld {count}: {reason}")
    if len(replayed.rows):
        _warn_outside(model, recording, replayed.rows)
    print(f"bag: {request.out}")
    return 0


@dataclass(frozen=True)
class Replayed:
    """The estimates, and the `reasons` why there is none with their counts.

    `rows` (n, 6) are stamp [ns], position [m], speed [m/s], force [N] and its bounds [N], NaN without a band.
    """

    rows: NDArray[np.float64]
    reasons: Counter[str]


def _warn_outside(model: Model, recording: Recording, rows: NDArray[np.float64]) -> None:
    current = hold_current(recording, rows[:, 0].astype(np.int64), model.sampling.max_current_age_s)
    position, speed = (rows[:, column].astype(np.float64) for column in (1, 2))
    uses = find_outside(model, {"position": position, "speed": speed, "current": current})
    if uses:
        share = max(use.outside_share for use in uses)
        terminal.print_warning(describe_outside(recording.name, share, uses))
    force, seconds = rows[:, 3].astype(np.float64), (rows[:, 0] - recording.channel("position").stamps_ns[0]) * 1e-9
    if text := describe_held(recording.name, model.force_envelope_N, seconds, np.isin(force, model.force_envelope_N)):
        terminal.print_warning(text)


def estimate_forces(model: Model, recording: Recording) -> Replayed:
    """Return the estimates of a recording's position samples."""
    estimator = Estimator(model)
    position = recording.channel("position")
    current = hold_current(recording, position.stamps_ns, model.sampling.max_current_age_s)
    rows = []
    reasons: Counter[str] = Counter()
    motion = hold_motion(recording, position.stamps_ns, model.sampling)
    columns = (position.stamps_ns, position.values, current, motion)
    for stamp, x, c, m in zip(*(column.tolist() for column in columns), strict=True):
        force = estimator.step(stamp, x, c, m)
        if force is not None:
            rows.append(_row(stamp, estimator.position, estimator.speed, force, estimator.half_width()))
        elif estimator.reason != OK:
            reasons[estimator.reason] += 1
        rows += [_row(*late) for late in estimator.late]
    return Replayed(np.array(rows, object).reshape(-1, 6), reasons)


def _row(stamp_ns: int, x: float, v: float, force: float, half_width: float | None) -> tuple[float, ...]:
    width = nan if half_width is None else half_width
    return stamp_ns, x, v, force, force - width, force + width


def _joint_states(topic: str, rows: NDArray[np.float64], columns: Mapping[str, int]) -> TopicData:
    values = {field: rows[:, column].astype(np.float64) for field, column in columns.items()}
    return TopicData(topic, TYPE, rows[:, 0].astype(np.int64), values)
