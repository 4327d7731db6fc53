"""The motion of a recording on uniform ticks, filtered without delay, for the sense checks.

Position, force and current are interpolated over the longest stretch without a gap. Position and force pass the same
zero-phase low-pass, so that their relation in time stays as logged.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt

from ces_identify.numerics.arrays import F, I
from ces_identify.preparation.position_spectrum import remove_spikes
from ces_identify.recordings.recording import Channel, Recording

RATE_HZ = 500.0  # of the ticks
BAND_HZ = 50.0  # of the low-pass, or 0.4 of the lowest sampling rate
MIN_RATE_HZ = 20.0
MIN_S, MAX_S = 2.0, 60.0  # of the stretch; of a longer one, the part with the fastest motion
GAP_S, GAP_INTERVALS = 0.05, 10.0


@dataclass(frozen=True)
class Motion:
    """Position [m], speed [m/s], force [N] and current [A], each (n,), on ticks of RATE_HZ.

    `sampled_Hz` is the lower rate of position and force. Without a current it is zero. `parts` are the numbers of
    ticks of the recordings that were joined, one after another; empty for a single one.
    """

    position: F
    speed: F
    force: F
    current: F
    sampled_Hz: float
    parts: tuple[int, ...] = ()

    def __len__(self) -> int:
        return len(self.position)

    def inner_ticks(self, before: int, after: int) -> I:
        """Return the indices of ticks that stay in their recording when moved back and ahead by so many ticks."""
        lengths = np.array(self.parts or (len(self),))
        begins = np.cumsum(lengths) - lengths
        ranges = [np.arange(a + before, a + n - after) for a, n in zip(begins, lengths, strict=True)]
        return np.concatenate(ranges)


def join_motions(motions: Sequence[Motion]) -> Motion:
    """Return one motion with the first part of each, about MAX_S seconds together."""
    most = max(round(MAX_S * RATE_HZ) // len(motions), round(MIN_S * RATE_HZ))
    position, speed, force, current = (
        np.concatenate([getattr(motion, name)[:most] for motion in motions])
        for name in ("position", "speed", "force", "current")
    )
    parts = tuple(min(len(motion), most) for motion in motions)
    return Motion(position, speed, force, current, min(motion.sampled_Hz for motion in motions), parts)


def recorded_motion(recording: Recording) -> Motion | None:
    """Return the motion of a recording; None if it lacks position or force, or two seconds without a gap."""
    channels = [_usable(recording, name) for name in ("position", "force")]
    if any(len(channel) < 20 for channel in channels):
        return None
    spans = _common_spans(channels)
    if not len(spans):
        return None
    begin, end = (int(edge) for edge in spans[np.argmax(spans[:, 1] - spans[:, 0])])
    rates = [_rate(channel, begin, end) for channel in channels]
    if (end - begin) * 1e-9 < MIN_S or min(rates) < MIN_RATE_HZ:
        return None
    return _on_ticks(recording, channels, begin, end, min(rates))


def _on_ticks(recording: Recording, channels: list[Channel], begin: int, end: int, sampled_Hz: float) -> Motion:
    finer = max(1, int(sampled_Hz // RATE_HZ))
    rate = RATE_HZ * finer
    time = np.arange(0.0, (end - begin) * 1e-9, 1.0 / rate)
    low_pass = butter(4, min(BAND_HZ, 0.4 * sampled_Hz), fs=rate, output="sos")
    position, force = (np.asarray(sosfiltfilt(low_pass, _at(channel, begin, time))) for channel in channels)
    speed = np.gradient(position) * rate
    current = _usable(recording, "current")
    held = _at(current, begin, time) if len(current) else np.zeros(len(time))
    part = _fastest_part(speed[::finer])
    x, v, f, i = (np.ascontiguousarray(signal[::finer][part]) for signal in (position, speed, force, held))
    return Motion(x, v, f, i, sampled_Hz)


def _usable(recording: Recording, name: str) -> Channel:
    """Return the finite samples in time order, each stamp once; without spikes if it is the position."""
    channel = recording.channels.get(name)
    if channel is None:
        return Channel(name, "", np.empty(0, np.int64), np.empty(0))
    channel = channel.select(np.isfinite(channel.values))
    stamps, first = np.unique(channel.stamps_ns, return_index=True)
    values = channel.values[first]
    if name == "position" and len(values) > 6:
        values = remove_spikes(values)
    return Channel(name, channel.unit, stamps, values)


def _common_spans(channels: list[Channel]) -> I:
    """Return begin and end [ns] (n, 2) of the stretches in which no channel has a gap."""
    begin = max(int(c.stamps_ns[0]) for c in channels)
    end = min(int(c.stamps_ns[-1]) for c in channels)
    if begin >= end:
        return np.empty((0, 2), np.int64)
    edges = [begin, end]
    for stamps in (c.stamps_ns for c in channels):
        steps = np.diff(stamps)
        wide = np.flatnonzero(steps > max(GAP_S * 1e9, GAP_INTERVALS * float(np.median(steps))))
        edges += [*stamps[wide].tolist(), *stamps[wide + 1].tolist()]
    inner = np.unique(np.clip(np.array(edges, np.int64), begin, end))
    spans = np.stack([inner[:-1], inner[1:]], axis=1)
    filled = [all(_has_samples(c, *span) for c in channels) for span in spans]
    return np.asarray(spans[np.array(filled, bool)])


def _has_samples(channel: Channel, begin: int, end: int) -> bool:
    first, last = np.searchsorted(channel.stamps_ns, (begin, end))
    return bool(last - first > 10)


def _rate(channel: Channel, begin: int, end: int) -> float:
    first, last = np.searchsorted(channel.stamps_ns, (begin, end))
    return float(last - first) / max((end - begin) * 1e-9, 1e-9)


def _at(channel: Channel, begin: int, time_s: F) -> F:
    return np.asarray(np.interp(time_s, (channel.stamps_ns - begin) * 1e-9, channel.values))


def _fastest_part(speed: F) -> slice:
    count = round(MAX_S * RATE_HZ)
    if len(speed) <= count:
        return slice(None)
    energy = np.concatenate([[0.0], np.cumsum(speed**2)])
    first = int(np.argmax(energy[count:] - energy[:-count]))
    return slice(first, first + count)
