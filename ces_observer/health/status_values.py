"""The key-value pairs of a status, as in diagnostic_msgs/msg/KeyValue: names with units, and values as text."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from ces_observer.health.episodes import Episodes
from ces_observer.health.latencies import LatencyFigures
from ces_observer.health.running_cost import RunningCost
from ces_observer.health.stillness import Stillness
from ces_observer.health.streams import StreamFigures
from ces_observer.recorder.black_box import BlackBox

Values = Iterator[tuple[str, str]]
UNKNOWN = "unknown: the middleware does not number the messages"


class Load(NamedTuple):
    """Recent load of the process and of the executor's thread, as shares of one core; None if unknown."""

    process: float | None = None
    executor: float | None = None


def episode_values(episodes: Episodes) -> Values:
    """Yield the values of the ended episodes, newest first."""
    yield "episodes of withholding", str(episodes.total)
    for reason, (count, length_s) in sorted(episodes.by_reason.items()):
        yield f"episodes: {reason}", f"{count}, {length_s:.3f} s in all"
    for number, episode in enumerate(reversed(episodes.last), start=1):
        yield f"last episode {number}", str(episode)


def rest_values(stillness: Stillness) -> Values:
    """Yield number and last length of the rests of the position."""
    yield "position has not changed, times", str(stillness.count)
    if stillness.count:
        yield "position has not changed, last for [s]", f"{stillness.last_s:.3f}"


def latency_values(latency: LatencyFigures) -> Values:
    """Yield the latencies of the window."""
    for name, ns in (("p50", latency.p50_ns), ("p99", latency.p99_ns), ("max", latency.max_ns)):
        yield f"latency from stamp to publish, {name} [ms]", f"{ns * 1e-6:.3f}" if latency.samples else "none"


def load_values(load: Load) -> Values:
    """Yield the processor load."""
    for name, share in (("process", load.process), ("executor", load.executor)):
        if share is not None:
            yield f"{name} load [% of a core]", f"{100.0 * share:.1f}"


def stream_values(name: str, figures: StreamFigures) -> Values:
    """Yield the values of an input once a message has arrived."""
    if not figures.total_samples:
        return
    yield f"{name}: rate [Hz]", f"{figures.rate_Hz:.1f}"
    yield f"{name}: age, mean [ms]", f"{figures.mean_age_s * 1e3:.3f}"
    yield f"{name}: age, max [ms]", f"{figures.max_age_s * 1e3:.3f}"
    yield f"{name}: jitter [ms]", f"{figures.jitter_s * 1e3:.3f}"
    yield f"{name}: longest interval [ms]", f"{figures.longest_s * 1e3:.3f}"
    yield f"{name}: longest burst", str(figures.burst)
    if figures.total_dropped is not None:
        yield f"{name}: dropped", str(figures.total_dropped)
        yield from missing_values(name, figures.total_dropped, figures)
    yield f"{name}: out of order", str(figures.total_out_of_order)
    yield f"{name}: duplicates", str(figures.total_duplicates)
    yield f"{name}: interruptions", str(figures.total_interruptions)


def missing_values(name: str, dropped: int, figures: StreamFigures) -> Values:
    """Yield what became of the samples that are missing in an input's stamps, as far as that is known."""
    lost, overflowed = figures.total_lost, figures.total_overflowed
    yield f"{name}: dropped, in this node's queue", str(overflowed)
    yield f"{name}: dropped, lost on the way", UNKNOWN if lost is None else str(max(0, lost - overflowed))
    yield f"{name}: dropped, not sent", UNKNOWN if lost is None else str(max(0, dropped - lost))


def describe_missing(figures: StreamFigures) -> str:
    """Return what became of the samples that are missing in a window, as the end of a sentence."""
    if figures.overflowed:
        return f"missing, {figures.overflowed} of them dropped by this node's queue: set input_depth higher"
    if figures.lost is None:
        return "missing: lost on the way, or the source paused"
    return f"missing, {figures.lost} of them lost on the way" if figures.lost else "missing: the source paused"


def cost_values(cost: RunningCost, evaluated: bool) -> Values:
    """Yield the running cost; `evaluated` is True if the last window had pairs."""
    yield "running cost J [%]", f"{cost.J:.2f}" if evaluated and cost.J is not None else "none"
    yield "threshold of J [%]", f"{cost.warn_J:.2f}"
    yield "measured force, standard deviation [N]", f"{cost.spread_N:.1f}"
    yield "measured forces not finite", str(cost.ignored)
    yield "measured forces without estimates around", str(cost.unpaired)


def box_values(box: BlackBox) -> Values:
    """Yield the state of the recordings."""
    yield "recorded bag", str(box.saved or "none")
    if box.problem:
        yield "recording", box.problem
